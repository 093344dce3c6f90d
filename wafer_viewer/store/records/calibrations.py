"""``calibrations.jsonl`` in the data folder: every correction of a rig's calibration, who made it and why.

The newest of a rig is what its next scans are calibrated by, unless the rig itself came with a newer one.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Spec
from wafer_viewer.store.io.jsonl_log import append_line, read_lines

CALIBRATIONS = "calibrations.jsonl"


class CalibrationChange(Spec, frozen=True, kw_only=True):
    """One line: a rig's calibration before and after; at: ISO 8601."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    rig: str
    at: str
    by: str
    why: str
    before: Calibration
    after: Calibration


def record_change(folder: Path, change: CalibrationChange) -> None:
    """Put a calibration in force for the rig's next scans."""
    append_line(folder / CALIBRATIONS, change)


def calibration_changes(folder: Path, rig: str) -> tuple[CalibrationChange, ...]:
    """What was changed of a rig's calibration, oldest first. Raises DatasetError when a line is damaged."""
    return tuple(change for change in read_lines(folder / CALIBRATIONS, CalibrationChange) if change.rig == rig)


def calibration_in_force(folder: Path, rig: str, own: Calibration | None) -> Calibration | None:
    """What the next scan of a rig into a data folder is calibrated by; own: what the rig came with."""
    if own is None:
        return None
    fit = [c.after for c in calibration_changes(folder, rig) if c.after.setup == own.setup and c.after.made >= own.made]
    return fit[-1] if fit else own
