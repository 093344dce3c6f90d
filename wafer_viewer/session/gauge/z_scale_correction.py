"""Correction of a rig's z scale by a signed check: calculation, and application as a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import CalibrationResult, Characteristic
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeRecord, ScaleCorrection
from wafer_viewer.session.core.calibration_acceptance import CalibratedRigFacts, accept
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.gauge.gauge_check import trusted_checks
from wafer_viewer.store.records.gauge_records import calibration_in_force


def offered(record: GaugeRecord, in_force: Calibration) -> ScaleCorrection:
    """Return the correction that a signed check offers. Raises MeasureError if it offers none."""
    from wafer_viewer.calibrate.z_scale import scale_correction

    return scale_correction(record.check, in_force, today())


def correct(folder: Path, record: GaugeRecord, in_force: Calibration, by: str, why: str = "") -> ScaleCorrection:
    """Apply the correction of a check to the rig's next scans into a data folder, and record it as a calibration.

    Raises MeasureError without a name, or if the check offers none or its correction was already made.
    """
    if not by.strip():
        raise MeasureError("The z scale is corrected under a name: say who does it.")
    correction = offered(record, in_force)
    signed = f"Check signed by {record.check.signed_by} on {record.check.at[:10]}: {correction.advice}"
    facts = CalibratedRigFacts(record.rig, record.check.simulated, in_force)
    accept(folder, facts, z_scale_result([record], in_force), by, why.strip() or signed)
    return correction


def z_scale_result(records: Sequence[GaugeRecord], in_force: Calibration) -> CalibrationResult:
    """Return the z scale by the newest signed check.

    Raises MeasureError if it cannot set the scale, or its correction was already made.
    """
    check = records[-1].check
    correction = offered(records[-1], in_force)
    after = correction.calibration
    if after.z_scale == in_force.z_scale:
        raise MeasureError("The z scale was corrected by this check already: check it with other blocks.")
    scale = Characteristic(
        name="z scale",
        value=after.z_scale,
        unit="1",
        expanded=2 * after.u_z_scale * after.z_scale,
        before=in_force.z_scale,
    )
    return CalibrationResult(
        kind="z",
        characteristics=(scale,),
        sets={"z_scale": after.z_scale, "u_z_scale": after.u_z_scale, "z_against": after.z_against},
        interval_days=check.terms.interval_days,
        notes=(
            f"Mean of {check.n} repeats of a step of {check.reference.value_um:.2f} um, blocks "
            f"{' and '.join(check.certificate.serials)}, signed by {check.signed_by} on {check.at[:10]}.",
            correction.advice,
        ),
    )


def last_check(folder: Path, serials: Sequence[str]) -> GaugeRecord:
    """Return the newest signed check of a data folder, of some blocks or of any.

    Raises MeasureError if there is none.
    """
    records = trusted_checks(folder, serials)
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
