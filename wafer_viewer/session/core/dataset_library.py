"""Datasets of the data folder, and the open one."""

from __future__ import annotations

import datetime
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.session.core.changes import with_change
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.state.snapshot import DatasetEntry, FieldState, OpenDataset, SurfaceInfo

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.lock import Lock
    from wafer_viewer.store.dataset.result import Result

ENDING = ".wafer"
DEFAULT_RESULT = "default"
NOTHING_OPEN = "No dataset is open: open one, import images or start a scan first."


class Library:
    """Datasets of the snapshot; changed on the session's thread only, readable from any."""

    def __init__(self, desk: CommandQueue, folder: Path) -> None:
        self._desk, self._folder = desk, folder
        self._dataset: Dataset | None = None
        self._lock: Lock | None = None
        self._stamps = count(1)
        self.result_name = DEFAULT_RESULT

    @property
    def dataset(self) -> Dataset:
        """Open dataset. Raises DatasetError when there is none."""
        if self._dataset is None:
            raise DatasetError(NOTHING_OPEN)
        return self._dataset

    @property
    def shown(self) -> OpenDataset:
        """Open dataset as in the snapshot. Raises DatasetError when there is none."""
        if (shown := self._desk.now.dataset) is None:
            raise DatasetError(NOTHING_OPEN)
        return shown

    @property
    def result(self) -> Result:
        """Displayed result of the open dataset."""
        return self.dataset.result(self.result_name)

    def refresh(self) -> None:
        """List the data folder again."""
        paths = sorted(self._folder.glob(f"*{ENDING}")) if self._folder.is_dir() else []
        entries = [entry for path in paths if (entry := _entry(path)) is not None]
        self._desk.change(datasets=tuple(sorted(entries, key=lambda e: e.taken, reverse=True)))

    def open(self, path: Path, *, taking: bool = False) -> None:
        """Open a dataset, for writing if no other process holds it. taking: our own rig holds it and writes frames."""
        from wafer_viewer.store.dataset.dataset import Dataset

        dataset = Dataset.open(path)
        self.close()
        self._dataset, self.result_name = dataset, _newest_result(dataset)
        read_only = None if taking else self.hold()
        states = _states(dataset, self.result)
        stamps = {n: next(self._stamps) for n, state in states.items() if state is FieldState.MEASURED}
        record = dataset.scan
        self._desk.change(
            dataset=OpenDataset(
                path=dataset.path,
                name=dataset.name,
                taken=record.taken,
                simulated=dataset.simulated,
                calibration_problem=dataset.calibration_problem(today()),
                read_only=read_only,
                finished=dataset.finished,
                fields=dataset.fields,
                states=states,
                stamps=stamps,
                plan=record.plan,
                job=record.job,
                results=dataset.results(),
                imported=bool(record.imported_from),
            ),
            surface=self._stored_surface(),
        )

    def close(self) -> None:
        """Close the dataset."""
        self.release_lock()
        self._dataset = None
        self._desk.change(dataset=None, surface=None, scan=None)

    def hold(self) -> str | None:
        """Take the dataset's lock; return the reason why it is read-only, or None."""
        from wafer_viewer.store.dataset.lock import Lock

        self.release_lock()
        try:
            self._lock = Lock.take(self.dataset.path)
        except DatasetError as fault:
            return str(fault)
        return None

    def release_lock(self) -> None:
        """Release the lock, so that the rig process can take it."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def scan_ended(self) -> None:
        """Take the lock again after a scan and read the states from the journal."""
        self.dataset.refresh()
        read_only = self.hold()
        fresh = _states(self.dataset, self.result)
        states = {
            n: fresh[n] if s in (FieldState.TO_COME, FieldState.TAKING) else s for n, s in self.shown.states.items()
        }
        self._show(states=states, finished=self.dataset.finished, read_only=read_only)
        self.refresh()

    def set_state(self, field_number: int, state: FieldState) -> None:
        """Set the state of a field; a measured field gets a new stamp."""
        shown = self.shown
        stamps = {**shown.stamps, field_number: next(self._stamps)} if state is FieldState.MEASURED else shown.stamps
        self._show(states={**shown.states, field_number: state}, stamps=stamps)

    def reread_states(self) -> None:
        """Read the state of every field from disk; the stamps do not change."""
        self._show(states=_states(self.dataset, self.result))

    def taking(self, field_number: int) -> None:
        """Mark the field that the rig is scanning now."""
        states = {
            n: FieldState.TO_COME if s is FieldState.TAKING and n != field_number else s
            for n, s in self.shown.states.items()
        }
        if states.get(field_number) is FieldState.TO_COME:
            states[field_number] = FieldState.TAKING
        if states != self.shown.states:
            self._show(states=states)

    def show_result(self, name: str) -> None:
        """Show another result."""
        self.result_name = name
        states = _states(self.dataset, self.result)
        stamps = {n: next(self._stamps) for n, state in states.items() if state is FieldState.MEASURED}
        self._show(states=states, stamps=stamps, results=self.dataset.results())
        self._desk.change(surface=self._stored_surface())

    def show_surface(self, info: SurfaceInfo) -> None:
        """Publish a new or updated stitched surface."""
        self._show(results=self.dataset.results())
        stamped, before = replace(info, stamp=next(self._stamps)), self._desk.now.surface
        if info.changed:
            stamped = with_change(stamped, before, info.changed[-1][1])
        self._desk.change(surface=stamped)

    def _stored_surface(self) -> SurfaceInfo | None:
        from wafer_viewer.session.core.surface_summary import load_summary

        try:
            info = load_summary(self.result) if self.result.has_mosaic and self.result.mosaic() else None
        except DatasetError:  # told when its numbers are asked for
            return None
        return None if info is None else replace(info, stamp=next(self._stamps))

    def _show(self, **changes: Any) -> None:
        self._desk.change(dataset=replace(self.shown, **changes))


def today() -> str:
    """Return today's date, ISO 8601."""
    return datetime.date.today().isoformat()


def free_name(folder: Path, wish: str) -> str:
    """Return the requested name, or the first of ``wish-2``, ``wish-3``, … that no dataset has."""
    names = (wish if n == 1 else f"{wish}-{n}" for n in count(1))
    return next(name for name in names if not (folder / f"{name}{ENDING}").exists())


def _entry(path: Path) -> DatasetEntry | None:
    """Return a list entry; None for a folder that is no dataset, or one that is being created."""
    from wafer_viewer.store.dataset.dataset import Dataset

    try:
        dataset = Dataset.open(path)
    except WaferViewerError:
        return None
    return DatasetEntry(path, dataset.name, dataset.scan.taken, not dataset.finished, dataset.simulated)


def _newest_result(dataset: Dataset) -> str:
    names = dataset.results()
    if not names or DEFAULT_RESULT in names:
        return DEFAULT_RESULT
    return max(names, key=lambda name: dataset.result(name).path.stat().st_mtime)


def _states(dataset: Dataset, result: Result) -> dict[int, FieldState]:
    measured = result.surfaces_done(dataset.fields)
    complete = dataset.complete_fields()
    empty = {shot.field for shot in dataset.missed()}
    known = dict.fromkeys(empty, FieldState.TO_REPEAT)
    known |= dict.fromkeys(complete, FieldState.TAKEN)
    known |= dict.fromkeys(measured, FieldState.MEASURED)
    return {f.number: known.get(f.number, FieldState.TO_COME) for f in dataset.fields}
