"""Correction of a rig's z scale by a signed check: calculation, application and log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeRecord, ScaleCorrection
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.gauge.gauge_check import now
from wafer_viewer.store.records.gauge_records import (
    CalibrationChange,
    calibration_in_force,
    record_change,
    signed_checks,
)


def offered(record: GaugeRecord, in_force: Calibration) -> ScaleCorrection:
    """Return the correction that a signed check offers. Raises MeasureError if it offers none."""
    from wafer_viewer.calibrate.z_scale import scale_correction

    return scale_correction(record.check, in_force, today())


def correct(folder: Path, record: GaugeRecord, in_force: Calibration, by: str, why: str = "") -> ScaleCorrection:
    """Apply the correction of a check to the rig's next scans into a data folder, and log it.

    Raises MeasureError without a name, or if the check offers none or its correction was already made.
    """
    if not by.strip():
        raise MeasureError("The z scale is corrected under a name: say who does it.")
    correction = offered(record, in_force)
    if correction.calibration.z_scale == in_force.z_scale:
        raise MeasureError("The z scale was corrected by this check already: check it with other blocks.")
    record_change(
        folder,
        CalibrationChange(
            rig=record.rig,
            at=now(),
            by=by.strip(),
            why=why.strip()
            or f"Check signed by {record.check.signed_by} on {record.check.at[:10]}: {correction.advice}",
            before=in_force,
            after=correction.calibration,
        ),
    )
    return correction


def last_check(folder: Path, serials: Sequence[str]) -> GaugeRecord:
    """Return the newest signed check of a data folder, of some blocks or of any.

    Raises MeasureError if there is none.
    """
    records = signed_checks(folder, serials)
    if not records:
        blocks = f" of block{'' if len(serials) == 1 else 's'} {' and '.join(serials)}" if serials else ""
        raise MeasureError(f"{folder} has no signed check{blocks}: sign one with measure gauge … --sign NAME.")
    return records[-1]


def in_force(folder: Path, record: GaugeRecord) -> Calibration:
    """Return the current calibration of a check's rig, by the log of its corrections.

    Raises MeasureError if there is none.
    """
    used = record.check.repeats[0].calibration
    calibration = calibration_in_force(folder, record.rig, used)
    if calibration is None:
        raise MeasureError("The check was made without a calibration: there is no scale to correct.")
    return calibration
