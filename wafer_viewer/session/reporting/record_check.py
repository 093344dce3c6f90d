"""Check of what people signed and judged: logs of the data folder, verdicts and gauge checks of a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.gauge import GaugeCheck, GaugeRecord
from wafer_viewer.model.roles import AuditEntry
from wafer_viewer.model.spec import Spec
from wafer_viewer.session.gauge.gauge_check import trusted_checks
from wafer_viewer.session.planning.verdicts import stored_verdict
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.calibration_records import CALIBRATIONS, GAUGE_LOG, CalibrationChange
from wafer_viewer.store.records.manifest import keys_of, least_log_lengths
from wafer_viewer.store.records.signed_log import AUDIT_LOG, read_log

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
    logs, faults, least = list[str](), list[str](), least_log_lengths(data.path)
    for name, kind in LOGS.items():
        path, n_least = folder / name, least.get(name, 0)
        _note(faults, lambda path=path, kind=kind, n_least=n_least: logs.extend(_of_log(path, kind, n_least, data)))
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


def _of_log(path: Path, kind: type[Spec], n_least: int, data: Dataset) -> list[str]:
    """Return a sentence on a log, none if there is no log and never was one.

    Raises DatasetError when it was altered, or has fewer records than the manifests of the dataset say.
    """
    log = read_log(path, kind)
    if (n := len(log.records)) < n_least:
        was = f"it has {n} record{'' if n == 1 else 's'}, and had {n_least} when {data.path.name} was signed"
        raise DatasetError(f"{path} was removed or replaced together with its head: {was}: restore both from a copy.")
    if n == 0:
        return []
    return [f"{path}: {n} record{'' if n == 1 else 's'}, {n} signed with the key {', '.join(log.keys)}"]


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
