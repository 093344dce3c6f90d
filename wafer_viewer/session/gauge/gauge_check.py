"""Gauge-block checks of datasets, for the session and the command line: repeats, signing, records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import CalibrationResult, Characteristic
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.gauge import (
    Capability,
    Certificate,
    GaugeCheck,
    GaugeRecord,
    GaugeRepeat,
    GaugeTerms,
    ScaleCorrection,
)
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.core.calibration_acceptance import CalibratedRigFacts, accept
from wafer_viewer.session.core.dataset_library import now, today
from wafer_viewer.session.state.inspection_state import Faces
from wafer_viewer.store.records.calibration_records import calibration_in_force

# ---------------------------------------------------------------------------------------------------------- gauge check


@dataclass(frozen=True, slots=True, eq=False)
class GaugeSource:
    """Surface of one repeat: show 0 is the stitched one, else the field of that number.

    problem: why its lengths are uncalibrated, or None; taken: ISO 8601.
    """

    surface: Mosaic
    name: str
    taken: str = ""
    problem: str | None = None
    show: int = 0

    @property
    def day(self) -> str:
        """Date of the measurement; today if it is unknown."""
        return self.taken[:10] or today()

    @property
    def calibration(self) -> Calibration | None:
        """Calibration that the heights were made with."""
        return self.surface.provenance.calibration


def source_of(src: Path, field_number: int, result: str) -> GaugeSource:
    """Return the surface of a dataset (0: the mosaic) or of a file. Raises DatasetError when it cannot be read."""
    from wafer_viewer.session.surface.headless import is_dataset, measured_surface
    from wafer_viewer.store.dataset.dataset import Dataset

    surface, calibrated = measured_surface(src, field_number, result)
    if is_dataset(src):
        data = Dataset.open(src)
        return GaugeSource(surface, data.name, data.scan.taken, data.calibration_problem(today()), field_number)
    return GaugeSource(surface, src.stem, problem=None if calibrated else "the file has none that holds")


def find_faces(surface: Mosaic) -> Faces:
    """Return the automatically detected faces of two blocks. Raises MeasureError if there are none."""
    from wafer_viewer.measure.gauge.find_faces import find_faces

    faces = find_faces(surface)
    return faces.upper, faces.lower


def measure_repeat(source: GaugeSource, certificate: Certificate, faces: Faces | None = None) -> GaugeRepeat:
    """Return the step in one scan; the faces are detected unless they are given.

    Raises MeasureError if this scan cannot be checked against the certificate or the step cannot be measured.
    """
    from wafer_viewer.measure.gauge.gauge_check import gauge_repeat, refusal

    why = refusal(certificate, source.calibration, source.problem, source.day)
    if why is not None:
        raise MeasureError(why)
    upper, lower = faces or find_faces(source.surface)
    return gauge_repeat(source.surface, upper, lower, dataset=source.name, taken=source.taken, show=source.show)


def check_of(
    repeats: Sequence[GaugeRepeat], certificate: Certificate, terms: GaugeTerms, records: Sequence[GaugeRecord]
) -> GaugeCheck:
    """Return the check of some repeats, with the pooled scatter of earlier signed checks of these blocks."""
    from wafer_viewer.measure.gauge.gauge_check import gauge_check
    from wafer_viewer.measure.gauge.gauge_studies import pooled_scatter

    return gauge_check(repeats, certificate, terms, known=pooled_scatter(_others(records, repeats)))


def signed(check: GaugeCheck, operator: str, records: Sequence[GaugeRecord]) -> GaugeCheck:
    """Return the check with signer and time.

    Raises MeasureError without a name, or if a scan is in an earlier check.
    """
    if not operator.strip():
        raise MeasureError("A check is signed with a name: say who made it.")
    for before in (record.check for record in records):
        if (scan := _shared_scan(before, check.repeats)) is not None:
            raise MeasureError(
                f"{scan} is in the check that {before.signed_by} signed on {before.at[:10]}: check new scans."
            )
    return replace(check, signed_by=operator.strip(), at=now())


def record_of(check: GaugeCheck, rig: str, result: str) -> GaugeRecord:
    """Return the log record of a signed check."""
    from wafer_viewer._version import __version__

    return GaugeRecord(check=check, rig=rig, result=result, software_version=__version__)


def _others(records: Sequence[GaugeRecord], repeats: Sequence[GaugeRepeat]) -> list[GaugeRecord]:
    """Return the records of checks that share no scan with some repeats."""
    return [record for record in records if _shared_scan(record.check, repeats) is None]


def _shared_scan(check: GaugeCheck, repeats: Sequence[GaugeRepeat]) -> str | None:
    """Return the first scan that a check shares with some repeats; None if there is none."""
    return next((new.dataset for new in repeats if any(old.is_scan_of(new) for old in check.repeats)), None)


def capability_of(
    records: Sequence[GaugeRecord], tolerance_um: float | None, latest: GaugeCheck | None = None
) -> Capability | None:
    """Return Cg and Cgk over every scan of signed checks and of the latest, signed or not; None without a tolerance."""
    from wafer_viewer.measure.gauge.gauge_studies import capability, errors_of_scans, same_scale

    if tolerance_um is None:
        return None
    if latest is not None:
        records = [*_others(records, latest.repeats), GaugeRecord(check=replace(latest, at=now()))]
    return capability(errors_of_scans(same_scale(records)), tolerance_um)


def trusted_checks(folder: Path, serials: Iterable[str] = ()) -> tuple[GaugeRecord, ...]:
    """Return the signed checks of a data folder, oldest first, optionally for one set of serial numbers.

    Raises DatasetError when the log is damaged or was altered, or a check contradicts its own numbers.
    """
    from wafer_viewer.measure.gauge.gauge_check import contradiction
    from wafer_viewer.store.records.calibration_records import GAUGE_LOG, signed_checks

    records = signed_checks(folder, serials)
    for record in records:
        if (fault := contradiction(record.check)) is not None:
            which = f"the check of {record.check.at} by {record.check.signed_by}"
            raise DatasetError(f"{folder / GAUGE_LOG}: {which} was altered: {fault}. Restore the log from a copy.")
    return records


# --------------------------------------------------------------------------------------------------- z scale correction


def offered(record: GaugeRecord, in_force: Calibration) -> ScaleCorrection:
    """Return the correction that a signed check offers. Raises MeasureError if it offers none."""
    from wafer_viewer.calibrate.topography import scale_correction

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
