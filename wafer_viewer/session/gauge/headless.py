"""Gauge-block checks from the command line, of datasets and surface files, without a session."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.gauge import Capability, Certificate, GaugeCheck, GaugeRecord, GaugeTerms, RunChart
from wafer_viewer.model.spec import Spec, replace
from wafer_viewer.session.core.audit_trail import record
from wafer_viewer.session.gauge import gauge_check as work
from wafer_viewer.session.gauge.gauge_check import trusted_checks
from wafer_viewer.session.state.inspection_state import Faces
from wafer_viewer.session.surface.headless import is_dataset
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.records.calibration_records import sign


class History(Spec, frozen=True, kw_only=True):
    """Signed checks of one pair of blocks on one rig, their run chart and, with a tolerance, their capability."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    rig: str
    serial_numbers: tuple[str, ...]
    chart: RunChart
    capability: Capability | None = None


def check_sources(
    src: Sequence[Path],
    certificate: Certificate,
    terms: GaugeTerms,
    faces: Faces | None,
    log: Path | None,
    field_number: int,
    result: str,
) -> tuple[GaugeCheck, Capability | None]:
    """Return the check of some scans as repeats, and Cg, Cgk including the earlier checks.

    Raises MeasureError if one of them cannot be checked, or if they are of several rigs.
    """
    rigs = dict.fromkeys(_rig(path) for path in src)
    if len(rigs) > 1:
        raise MeasureError(f"The scans are of several rigs ({', '.join(rigs)}): check one at a time.")
    records = _records(src, certificate, log)
    sources = [work.source_of(path, field_number, result) for path in src]
    repeats = [work.measure_repeat(source, certificate, faces) for source in sources]
    check = work.check_of(repeats, certificate, terms, records)
    return check, work.capability_of(records, terms.tolerance_um, check)


def sign_sources(check: GaugeCheck, src: Sequence[Path], operator: str, log: Path | None, result: str) -> GaugeCheck:
    """Sign a check and store it in the log, and in the results of the last scan if that is a dataset."""
    folder = log or src[0].parent
    signed = work.signed(check, operator, _records(src, check.certificate, log))
    line = work.record_of(signed, _rig(src[0]), result)
    if not is_dataset(src[-1]):
        _sign(folder, line, operator)
        return signed
    lock = Lock.take(src[-1])
    try:
        _sign(folder, line, operator)
        return _keep(Dataset.open(src[-1]), result, signed)
    finally:
        lock.release()


def _sign(folder: Path, line: GaugeRecord, operator: str) -> None:
    sign(folder, line)
    record(folder, "Gauge check signed", ", ".join(line.check.certificate.serials), by=operator)


def history(folder: Path, serials: Sequence[str], rig: str | None, tolerance_um: float | None) -> History:
    """Return the signed checks of a folder. Raises MeasureError if there are none, or of several pairs of blocks."""
    from wafer_viewer.measure.gauge.gauge_studies import run_chart

    records = trusted_checks(folder, serials)
    records = records if rig is None else _of_rig(records, rig)
    pairs = dict.fromkeys((record.rig, record.check.certificate.serials) for record in records)
    if len(pairs) > 1:
        names = "; ".join(f"{' '.join(blocks)} on {name or 'no rig'}" for name, blocks in pairs)
        raise MeasureError(f"{folder} has checks of several blocks or rigs ({names}): choose by --serial and --rig.")
    if (chart := run_chart(records)) is None:
        raise MeasureError(f"{folder} has no signed checks of these blocks: sign one with measure gauge … --sign NAME.")
    (name, blocks), *_ = pairs
    return History(rig=name, serial_numbers=blocks, chart=chart, capability=work.capability_of(records, tolerance_um))


def _keep(data: Dataset, name: str, check: GaugeCheck) -> GaugeCheck:
    """Store a check with a number and a name among the results of a dataset, and return it."""
    result = data.result(name)
    items = result.findings().items
    number = max((result.highest_thumbnail(), *(item.number for item in items))) + 1
    nth = 1 + sum(isinstance(item, GaugeCheck) for item in items)
    numbered = replace(check, number=number, name=f"Gauge check {nth}")
    result.save_findings(MeasurementResults(items=(*items, numbered)))
    return numbered


def _records(src: Sequence[Path], certificate: Certificate, log: Path | None) -> tuple[GaugeRecord, ...]:
    """Return the signed checks of the same blocks on the same rig."""
    return _of_rig(trusted_checks(log or src[0].parent, certificate.serials), _rig(src[0]))


def _rig(src: Path) -> str:
    return Dataset.open(src).scan.rig if is_dataset(src) else ""


def _of_rig(records: Sequence[GaugeRecord], rig: str) -> tuple[GaugeRecord, ...]:
    return tuple(record for record in records if record.rig == rig)
