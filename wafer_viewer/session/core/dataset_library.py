"""Datasets of the data folder, the open one, the summary of its surface and its changed areas."""

from __future__ import annotations

import datetime
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError, WaferViewerError, parser_errors_as
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.job import WaferVerdict
from wafer_viewer.model.retention import RetentionRule
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, UNMEASURED_FROM, HeightMap, Mosaic, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.numerics.normal_statistics import HALF_NORMAL_MEDIAN
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import observer_command
from wafer_viewer.session.state.snapshot import Box, DatasetEntry, FieldState, FrameStorage, OpenDataset, SurfaceInfo
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.dataset.retention import read_rule
from wafer_viewer.store.io.checksums import sealed_text, verified_text
from wafer_viewer.store.mosaic.statistics import MosaicStatistics, compute_statistics
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic
from wafer_viewer.store.mosaic.zarr_shards import SURFACE
from wafer_viewer.store.records.manifest import load_record, require_as_saved, save_record_text

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.lock import Lock
    from wafer_viewer.store.dataset.scan_record import RetentionLine


KEPT = 32
"""Maximum number of separate changes; older ones are merged."""


def with_change(now: SurfaceInfo, before: SurfaceInfo | None, box_um: Box) -> SurfaceInfo:
    """Return the summary of a surface that differs from `before` only inside a box.

    The surface is new everywhere if there is no `before`, or if its pixel lattice differs.
    """
    if before is None or _lattice(now) != _lattice(before):
        return replace(now, changed=())
    earlier = before.changed or ((before.stamp, _whole(before)),)
    changed = (*earlier, (now.stamp, box_um))
    while len(changed) > KEPT:
        (_, first), (stamp, second), *rest = changed
        changed = ((stamp, _both(first, second)), *rest)
    return replace(now, changed=changed)


def stamp_of(info: SurfaceInfo, box_um: Box) -> int:
    """Return the stamp of the last change of a part of a surface."""
    return max((stamp for stamp, box in info.changed if _meet(box, box_um)), default=info.stamp)


def _lattice(info: SurfaceInfo) -> tuple[object, ...]:
    return info.result, info.rows, info.cols, info.pixel_um, info.x0_um, info.y0_um


def _whole(info: SurfaceInfo) -> Box:
    """Return the box of all pixels, enlarged by one pixel on each side."""
    x0, y1 = info.x0_um - info.pixel_um, info.y0_um + info.pixel_um
    return x0, y1 - (info.rows + 1) * info.pixel_um, x0 + (info.cols + 1) * info.pixel_um, y1


def _both(a: Box, b: Box) -> Box:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _meet(a: Box, b: Box) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


DEFAULT_RESULT = "default"
VERDICT = "verdict.json"
ACCEPTED, REMOVED = "pass", "frames removed"
"""Verdict of datasets whose frames may be removed, and what is said when they were."""
NOTHING_OPEN = "No dataset is open: open one, import images or start a scan first."


class Library:
    """Datasets of the snapshot; changed on the session's thread only, readable from any."""

    def __init__(self, command_queue: CommandQueue, folder: Path) -> None:
        self._command_queue, self._folder = command_queue, folder
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
        if (shown := self._command_queue.now.dataset) is None:
            raise DatasetError(NOTHING_OPEN)
        return shown

    @property
    def result(self) -> Result:
        """Displayed result of the open dataset."""
        return self.dataset.result(self.result_name)

    @observer_command
    def refresh(self) -> None:
        """List the data folder again."""
        self._command_queue.change(datasets=datasets_in(self._folder))

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
        self._command_queue.change(
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
                storage=_storage(dataset),
                held=held_by(dataset),
            ),
            surface=self._stored_surface(),
        )

    def is_open(self, path: Path) -> bool:
        """Return whether the open dataset is the one at this path."""
        return self._dataset is not None and self._dataset.path == path

    def close(self) -> None:
        """Close the dataset."""
        self.release_lock()
        self._dataset = None
        self._command_queue.change(dataset=None, surface=None, scan=None)

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
        plan = self.dataset.scan.plan
        self._show(
            states=states, finished=self.dataset.finished, read_only=read_only, plan=plan, fields=self.dataset.fields
        )
        self.refresh.run()

    def compressed(self) -> None:
        """Take the lock again after another process changed the compression of the frames, and read their size."""
        from wafer_viewer.store.dataset.dataset import Dataset

        self._dataset = Dataset.open(self.dataset.path)
        self._show(read_only=self.hold(), storage=_storage(self._dataset))

    def append(self, line: RetentionLine) -> None:
        """Append a line on how long the frames of the open dataset are kept; on the session's thread only.

        Raises DatasetError when the dataset can only be read, or something else writes to it.
        """
        from wafer_viewer.store.dataset.retention import append_line

        shown = self.shown
        if shown.read_only is not None:
            raise DatasetError(shown.read_only)
        if self._lock is None:  # the rig has it for a scan, or a worker for the compression
            raise DatasetError(f"{shown.path.name} is being written: wait until that is over.")
        append_line(self.dataset, line)
        self._show(held=held_by(self.dataset))
        self.refresh.run()

    def show_damage(self, damaged: tuple[Shot, ...]) -> None:
        """Show which frames of the open dataset are damaged."""
        self._show(damaged=damaged)

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
        self._command_queue.change(surface=self._stored_surface())

    def show_surface(self, info: SurfaceInfo) -> None:
        """Publish a new or updated stitched surface."""
        self._show(results=self.dataset.results())
        stamped, before = replace(info, stamp=next(self._stamps)), self._command_queue.now.surface
        if info.changed:
            stamped = with_change(stamped, before, info.changed[-1][1])
        self._command_queue.change(surface=stamped)

    def _stored_surface(self) -> SurfaceInfo | None:

        try:
            info = load_summary(self.result) if self.result.has_mosaic and self.result.mosaic() else None
        except DatasetError:  # reported when its statistics are requested
            return None
        return None if info is None else replace(info, stamp=next(self._stamps))

    def _show(self, **changes: Any) -> None:
        self._command_queue.change(dataset=replace(self.shown, **changes))


def now() -> str:
    """Return the current time, ISO 8601 with the time zone."""
    return datetime.datetime.now().astimezone().isoformat(timespec="milliseconds")


def today() -> str:
    """Return today's date, ISO 8601."""
    return datetime.date.today().isoformat()


def free_name(folder: Path, wish: str) -> str:
    """Return the requested name, or the first of ``wish-2``, ``wish-3``, … that no dataset has."""
    names = (wish if n == 1 else f"{wish}-{n}" for n in count(1))
    return next(name for name in names if not (folder / f"{name}{DATASET_ENDING}").exists())


def datasets_in(folder: Path, words: str = "") -> tuple[DatasetEntry, ...]:
    """Return the datasets of a folder that match all words, the newest first."""
    paths = sorted(folder.glob(f"*{DATASET_ENDING}")) if folder.is_dir() else []
    rule = read_rule(folder)
    entries = [entry for path in paths if (entry := _entry(path, rule)) is not None and entry.matches(words)]
    return tuple(sorted(entries, key=lambda e: e.taken, reverse=True))


def _entry(path: Path, rule: RetentionRule) -> DatasetEntry | None:
    """Return a list entry; None for a folder that is no dataset, or one that is being created."""
    from wafer_viewer.store.dataset.dataset import Dataset

    try:
        dataset = Dataset.open(path)
    except WaferViewerError:
        return None
    job = dataset.scan.job
    return DatasetEntry(
        path,
        dataset.name,
        dataset.scan.taken,
        not dataset.finished,
        dataset.simulated,
        lot=job.sample.lot,
        wafer_id=job.sample.wafer_id,
        product=job.product,
        verdict=(verdict := verdict_word(dataset)),
        frames=_kept(dataset, verdict, rule),
    )


def held_by(dataset: Dataset) -> str:
    """Return who holds the frames of a dataset, and why; an empty text without a hold."""
    return "" if dataset.held is None else f"{dataset.held.by}: {dataset.held.why}"


def _kept(dataset: Dataset, verdict: str, rule: RetentionRule) -> str:
    """Return how long the frames of a dataset are kept, in a few words; empty where no rule says so."""
    if dataset.removed is not None:
        return REMOVED
    if dataset.held is not None:
        return "held"
    until = rule.until(dataset.scan.taken) if verdict == ACCEPTED and dataset.finished else None
    return "" if until is None else f"frames kept until {until}"


def verdict_word(dataset: Dataset) -> str:
    """Return the word of the stored verdict on the newest result; empty without one, and for one that was altered."""
    path = dataset.result(_newest_result(dataset)).path / VERDICT
    try:
        return load_record(path, WaferVerdict, trusted=True).word if path.exists() else ""
    except WaferViewerError:
        return ""


def _newest_result(dataset: Dataset) -> str:
    names = dataset.results()
    if not names or DEFAULT_RESULT in names:
        return DEFAULT_RESULT
    return max(names, key=lambda name: dataset.result(name).path.stat().st_mtime)


def _storage(dataset: Dataset) -> FrameStorage | None:
    """Return the size of frames that may be compressed; None for others."""
    if not dataset.scan.is_compressed:
        return None
    return FrameStorage(dataset.frame_bytes(), sum(dataset.scan.pages(field).file_bytes for field in dataset.fields))


def _states(dataset: Dataset, result: Result) -> dict[int, FieldState]:
    measured = result.surfaces_done(dataset.fields)
    complete = dataset.complete_fields()
    empty = {shot.field for shot in dataset.missed()}
    state_of = dict.fromkeys(empty, FieldState.TO_REPEAT)
    state_of |= dict.fromkeys(complete, FieldState.TAKEN)
    state_of |= dict.fromkeys(measured, FieldState.MEASURED)
    return {f.number: state_of.get(f.number, FieldState.TO_COME) for f in dataset.fields}


SUMMARY = "surface.json"
COLOUR_RANGE_PERCENT = (0.5, 99.5)
OUTLIERS_BEYOND = 3.0
"""Robust deviations beyond which an overlap difference counts as a false height, not as a misfit of fields."""


def summarise(mosaic: Mosaic, n_fields: int, result: str, asked: Recipe | None = None) -> SurfaceInfo:
    """Return the summary of a mosaic of `n_fields` fields made with the recipe `asked`.

    The statistics stored with the mosaic are used; for a surface in memory they are computed. Fractions refer to the
    pixels covered by fields, so the area outside a round wafer does not count.
    """
    rows, cols = mosaic.shape
    facts = mosaic.facts() if isinstance(mosaic, ZarrMosaic) else _facts_of(mosaic.window())
    covered = max(1, int(facts.counts.sum() - facts.counts[Origin.NOT_COVERED]))
    low_um, high_um = _colour_range(facts.heights_um)
    return SurfaceInfo(
        result=result,
        stamp=0,
        rows=rows,
        cols=cols,
        pixel_um=mosaic.pixel_um,
        x0_um=mosaic.x0_um,
        y0_um=mosaic.y0_um,
        levels=mosaic.levels,
        n_fields=n_fields,
        highest_um=facts.highest_um if facts.has_heights else 0.0,
        lowest_um=facts.lowest_um if facts.has_heights else 0.0,
        measured_fraction=float(facts.counts[Origin.MEASURED]) / covered,
        filled_fraction=float(facts.counts[Origin.FILLED]) / covered,
        unmeasured=unmeasured_reasons(facts.counts, covered),
        overlap_rms_um=_rms_um(facts.overlaps_um),
        low_um=low_um,
        high_um=high_um,
        recipe_notes=mosaic.provenance.notes,
        asked=asked,
        settled=mosaic.provenance.recipe,
    )


def save_summary(result: Result, info: SurfaceInfo) -> None:
    """Write a summary next to its mosaic."""
    text = msgspec.json.format(msgspec.json.encode(info), indent=2).decode()
    save_record_text(result.path / SUMMARY, sealed_text(text))


def load_summary(result: Result) -> SurfaceInfo | None:
    """Return the stored summary; None if it is missing, damaged or of another version."""
    with suppress(DatasetError), parser_errors_as(lambda _: DatasetError(f"{SUMMARY} cannot be read.")):
        require_as_saved(result.path / SUMMARY)
        return msgspec.json.decode(verified_text(result.path / SUMMARY), type=SurfaceInfo)
    return None


def _facts_of(surface: HeightMap) -> MosaicStatistics:
    layers = {name: getattr(surface, name) for name in SURFACE if getattr(surface, name) is not None}
    return compute_statistics(layers)


def _rms_um(differences_um: NDArray[np.float32]) -> float | None:
    """Return the rms difference of neighbours in their overlaps, um; None without overlaps.

    Differences above the outlier limit, three robust deviations of normal errors, are excluded; the differences are
    never negative.
    """
    if not differences_um.size:
        return None
    limit_um = OUTLIERS_BEYOND * float(np.median(differences_um)) / HALF_NORMAL_MEDIAN
    near = differences_um[differences_um <= limit_um + 1e-6]
    return float(np.sqrt(np.mean(near**2)))


def _colour_range(heights_um: NDArray[np.float32]) -> tuple[float, float]:
    if not heights_um.size:
        return 0.0, 1.0
    low_um, high_um = np.percentile(heights_um, COLOUR_RANGE_PERCENT)
    return float(low_um), float(high_um)


def unmeasured_reasons(counts: NDArray[np.int64], covered: int) -> tuple[tuple[str, float], ...]:
    """Return the reasons for unmeasured covered pixels and their fractions, the most frequent first."""
    codes = [o for o in Origin if o >= UNMEASURED_FROM and o != Origin.NOT_COVERED and counts[o] > 0]
    return tuple((ORIGIN_TITLES[o], float(counts[o]) / covered) for o in sorted(codes, key=lambda o: -int(counts[o])))
