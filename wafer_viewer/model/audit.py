"""Entries of the audit log of a data folder: who did what, when and through what."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Spec

Through = Literal["page", "command line", "Python"]
Action = Literal[
    "Scan started",
    "Scan continued",
    "Scan stopped",
    "Scan made",
    "Surface made",
    "Surfaces compared",
    "Surface imported",
    "Images imported",
    "Plan saved",
    "Job released",
    "Gauge check signed",
    "Scale of z corrected",
    "Calibration accepted",
    "Result kept",
    "Result deleted",
    "Change of results undone",
    "Change of results redone",
    "Finding judged",
    "Judgement of findings undone",
    "Judgement of findings redone",
    "Defects judged",
    "Defect limits changed",
    "Change of defects undone",
    "Change of defects redone",
    "Defect recipe saved",
    "Defect recipe deleted",
    "Golden die kept",
    "Frames held",
    "Hold ended",
    "Frames removed",
    "Person added",
    "Person removed",
]
"""Everything that the audit log holds; an action is entered here and with the command that carries it out."""


class AuditEntry(Spec, frozen=True, kw_only=True):
    """One action that changed something.

    at: UTC, ISO 8601; by: name of the browser, or of the account; through: where it was done; action: what was done;
    subject: dataset, job or file that it was done to; detail: what was given with it; sha256: digest, hex, of the file
    that it wrote.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    at: str
    by: str
    through: Through
    action: str
    subject: str = ""
    detail: str = ""
    sha256: str = ""
