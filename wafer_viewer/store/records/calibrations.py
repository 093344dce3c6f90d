"""``calibrations.jsonl`` in the data folder: all changes of rig calibrations, with author and reason.

The newest change applies to the rig's next scans, unless the rig itself has a newer calibration.
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
    """One line: calibration of a rig before and after a change; at: ISO 8601."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    rig: str
    at: str
    by: str
    why: str
    before: Calibration
    after: Calibration


def record_change(folder: Path, change: CalibrationChange) -> None:
    """Append a calibration that applies to the rig's next scans."""
    append_line(folder / CALIBRATIONS, change)


def calibration_changes(folder: Path, rig: str) -> tuple[CalibrationChange, ...]:
    """Return the calibration changes of a rig, oldest first. Raises DatasetError for a damaged line."""
    return tuple(change for change in read_lines(folder / CALIBRATIONS, CalibrationChange) if change.rig == rig)


def calibration_in_force(folder: Path, rig: str, own: Calibration | None) -> Calibration | None:
    """Return the calibration for the next scan of a rig into a data folder; own: that of the rig itself."""
    if own is None:
        return None
    fit = [c.after for c in calibration_changes(folder, rig) if c.after.setup == own.setup and c.after.made >= own.made]
    return fit[-1] if fit else own
