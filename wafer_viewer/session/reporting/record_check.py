"""Check of what people signed and judged: logs of the data folder, verdicts and gauge checks of a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from wafer_viewer.model.audit import AuditEntry
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.gauge import GaugeCheck, GaugeRecord
from wafer_viewer.model.spec import Spec
from wafer_viewer.session.gauge.signed_checks import trusted_checks
from wafer_viewer.session.planning.verdicts import stored_verdict
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.audit_log import AUDIT_LOG
from wafer_viewer.store.records.gauge_records import CALIBRATIONS, GAUGE_LOG, CalibrationChange
from wafer_viewer.store.records.manifest import keys_of
from wafer_viewer.store.records.signed_log import read_log

LOGS: dict[str, type[Spec]] = {
    GAUGE_LOG: GaugeRecord,
    CALIBRATIONS: CalibrationChange,
    AUDIT_LOG: AuditEntry,
}


@dataclass(frozen=True, slots=True)
class RecordReport:
    """One sentence for each log that is as it was signed and each key, and one for each record that was altered."""

    logs: tuple[str, ...]
    faults: tuple[str, ...]


def check_records(data: Dataset) -> RecordReport:
    """Verify the logs of the folder of a dataset, and that its verdicts and gauge checks agree with their numbers."""
    folder = data.path.absolute().parent
    logs, faults = list[str](), list[str]()
    for name, kind in LOGS.items():
        path = folder / name
        _note(faults, lambda path=path, kind=kind: logs.extend(_of_log(path, kind)))
    logs += _of_manifests(data)
    _note(faults, partial(trusted_checks, folder))
    for name in data.results():
        _note(faults, partial(stored_verdict, data, data.result(name)))
        _note(faults, partial(_require_agreement, data, name))
    return RecordReport(tuple(logs), tuple(dict.fromkeys(faults)))


def _note(faults: list[str], look: Callable[[], object]) -> None:
    try:
        look()
    except DatasetError as fault:
        faults.append(str(fault))


def _of_log(path: Path, kind: type[Spec]) -> list[str]:
    """Return a sentence on a log, none if there is no log and never was one."""
    log = read_log(path, kind)
    if (n := len(log.records)) == 0:
        return []
    signed = f"{log.n_signed} signed with the key {', '.join(log.keys)}" if log.n_signed else "none signed"
    return [f"{path}: {n} record{'' if n == 1 else 's'}, {signed}"]


def _of_manifests(data: Dataset) -> list[str]:
    """Return a sentence for each key that manifests of a dataset are signed with."""
    numbers = Counter(keys_of(data.path))
    return [
        f"{data.path}: {n} manifest{'' if n == 1 else 's'} {f'signed with the key {key}' if key else 'not signed'}"
        for key, n in numbers.items()
    ]


def _require_agreement(data: Dataset, name: str) -> None:
    """Raise DatasetError for a gauge check among the results that contradicts its own numbers."""
    from wafer_viewer.measure.gauge.gauge_check import contradiction

    for item in data.result(name).findings().items:
        if isinstance(item, GaugeCheck) and (fault := contradiction(item)) is not None:
            raise DatasetError(f"{item.name} of result {name!r} of {data.path.name} was altered: {fault}. Check again.")
