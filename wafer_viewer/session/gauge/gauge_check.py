"""Gauge-block checks of datasets, for the session and the command line alike: repeats, signing, records."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge.gauge_check import Certificate, GaugeCheck, GaugeRecord, GaugeRepeat, GaugeTerms
from wafer_viewer.model.gauge.run_chart import Capability
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.state.gauge_state import Faces


@dataclass(frozen=True, slots=True, eq=False)
class GaugeSource:
    """A surface that a repeat is measured on: show 0 the stitched one, else the field of that number.

    problem: why its lengths are uncalibrated, or None; taken: ISO 8601.
    """

    surface: Mosaic
    name: str
    taken: str = ""
    problem: str | None = None
    show: int = 0

    @property
    def day(self) -> str:
        """Of the measurement; today where that is not known."""
        return self.taken[:10] or today()

    @property
    def calibration(self) -> Calibration | None:
        """What its heights were made with."""
        return self.surface.provenance.calibration


def source_of(src: Path, field_number: int, result: str) -> GaugeSource:
    """The surface of a dataset (0: the mosaic) or of a file. Raises DatasetError when it cannot be read."""
    from wafer_viewer.session.surface.headless import is_dataset, measured_surface
    from wafer_viewer.store.dataset.dataset import Dataset

    surface, calibrated = measured_surface(src, field_number, result)
    if is_dataset(src):
        data = Dataset.open(src)
        return GaugeSource(surface, data.name, data.scan.taken, data.calibration_problem(today()), field_number)
    return GaugeSource(surface, src.stem, problem=None if calibrated else "the file has none that holds")


def find_faces(surface: Mosaic) -> Faces:
    """The faces of two blocks, found by themselves. Raises MeasureError where there are none."""
    from wafer_viewer.measure.gauge.find_faces import find_faces

    found = find_faces(surface)
    return found.upper, found.lower


def repeat_of(source: GaugeSource, certificate: Certificate, faces: Faces | None = None) -> GaugeRepeat:
    """The step in one scan; faces are found by themselves where none are given.

    Raises MeasureError where there is no check of this scan against the certificate, or the step cannot be measured.
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
    """What repeats come to, with the scatter that signed checks of these blocks found before in other scans."""
    from wafer_viewer.measure.gauge.gauge_check import gauge_check
    from wafer_viewer.measure.gauge.run_chart import pooled_scatter

    return gauge_check(repeats, certificate, terms, known=pooled_scatter(_others(records, repeats)))


def signed(check: GaugeCheck, operator: str, records: Sequence[GaugeRecord]) -> GaugeCheck:
    """The check with who signed it and when. Raises MeasureError without a name, or where a scan counts already."""
    if not operator.strip():
        raise MeasureError("A check is signed with a name: say who made it.")
    for before in (record.check for record in records):
        if (scan := _in_common(before, check.repeats)) is not None:
            raise MeasureError(
                f"{scan} is in the check that {before.signed_by} signed on {before.at[:10]}: check new scans."
            )
    return replace(check, signed_by=operator.strip(), at=now())


def record_of(check: GaugeCheck, rig: str, result: str) -> GaugeRecord:
    """What the log keeps of a signed check."""
    from wafer_viewer._version import __version__

    return GaugeRecord(check=check, rig=rig, result=result, software_version=__version__)


def _others(records: Sequence[GaugeRecord], repeats: Sequence[GaugeRepeat]) -> list[GaugeRecord]:
    """The records of checks that have no scan in common with some repeats."""
    return [record for record in records if _in_common(record.check, repeats) is None]


def _in_common(check: GaugeCheck, repeats: Sequence[GaugeRepeat]) -> str | None:
    """The first scan that a check has with some repeats."""
    return next((new.dataset for new in repeats if any(old.is_scan_of(new) for old in check.repeats)), None)


def capability_of(
    records: Sequence[GaugeRecord], tolerance_um: float | None, latest: GaugeCheck | None = None
) -> Capability | None:
    """Cg and Cgk over every scan of signed checks and of the latest, signed or not; None without a tolerance."""
    from wafer_viewer.measure.gauge.capability import capability
    from wafer_viewer.measure.gauge.run_chart import errors_of_scans, same_scale

    if tolerance_um is None:
        return None
    if latest is not None:
        records = [*_others(records, latest.repeats), GaugeRecord(check=replace(latest, at=now()))]
    return capability(errors_of_scans(same_scale(records)), tolerance_um)


def now() -> str:
    """This moment, ISO 8601 with the time zone."""
    return datetime.datetime.now().astimezone().isoformat(timespec="milliseconds")
