"""Comparison of two surfaces: opens, subtracts and writes them, as a worker's task and for the command line."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import lru_cache, partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer.model.errors import ComputeError, DatasetError, WaferViewerError
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import Align, Comparison, ComparisonFace, SurfaceName, comparison_of
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Provenance
from wafer_viewer.session.core.commands import command, query
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.state.snapshot import Compared
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.result import COMPARISON, MOSAIC
from wafer_viewer.store.io.atomic_files import atomic_write, remove
from wafer_viewer.store.io.checksums import save_json

if TYPE_CHECKING:
    from wafer_viewer.reconstruct.comparison.compare import Difference, DifferenceStatistics
    from wafer_viewer.session.core.background_work import BackgroundWork
    from wafer_viewer.session.core.command_queue import CommandQueue
    from wafer_viewer.session.core.dataset_library import Library
    from wafer_viewer.session.state.snapshot import Snapshot


# -------------------------------------------------------------------------------------------------- comparison commands


Pair = tuple[SurfaceName, SurfaceName]


class ComparisonController:
    """Controller of the comparisons, ``session.comparing``; commands return futures."""

    def __init__(self, command_queue: CommandQueue, library: Library, background: BackgroundWork) -> None:
        self._command_queue, self._library, self._background = command_queue, library, background
        self._stamps = count(1)
        self._work, self._of = "", Path()

    def open(self) -> None:
        """Show the comparisons of the open dataset; a running one of another dataset is cancelled."""
        now = self._command_queue.now.dataset
        if self._work and (now is None or now.path != self._of):
            self._background.cancel(self._work)
        self._show()

    @query
    def choices(self, show: int = 0) -> tuple[Pair, ...]:
        """Return the surface pairs that can be compared: the stitched surface, or a field, with others.

        Reads the disk.
        """
        now = self._command_queue.snapshot
        if now.dataset is None:
            return ()
        field = max(show, 0)
        first = SurfaceName(path=str(now.dataset.path), result=self._library.result_name, field=field)
        raw, cleaned = (_of(first, heights) for heights in ("raw", "cleaned"))
        others = [
            name for entry in now.datasets for name in _surfaces_of(entry.path, field, entry.path == now.dataset.path)
        ]
        return (*((first, other) for other in others if other != first), (raw, cleaned))

    @command.audited("Surfaces compared")
    def begin(
        self, first: SurfaceName, second: SurfaceName, align: Align = "auto", keep_z: bool = False
    ) -> Future[int]:
        """Subtract two surfaces.

        The future's result is the number of the comparison, which `show_of` maps to its layers.
        """
        shown = self._library.shown
        if shown.read_only is not None:
            raise DatasetError(f"Nothing can be compared: {shown.read_only}")
        if self._work:
            raise DatasetError("Two surfaces are being compared already: wait for them, or cancel it in the job list.")
        dataset, name = self._library.dataset, free_result(self._library.dataset.differences(), second)
        title, ended = f"Compare with {second.words}", self._ended
        running = self._background.run(title, subtract, dataset.path, name, first, second, align, keep_z, ended=ended)
        self._work, self._of = running.id, dataset.path
        return self._command_queue.then(running.done, lambda comparison: comparison.number)

    @command
    def remove(self, number: int) -> None:
        """Delete a comparison. Raises DatasetError when there is none of that number, or it cannot be removed."""
        comparison = next((c for c in self._command_queue.now.comparisons if c.number == number), None)
        if comparison is None:
            raise DatasetError(f"There is no comparison {number}: choose one of the list.")
        if (why := self._library.shown.read_only) is not None:
            raise DatasetError(f"The comparison was not removed: {why}")
        path = self._library.dataset.result(comparison.name).path
        try:
            shutil.rmtree(path)
        except OSError as fault:
            raise DatasetError(f"{path} cannot be removed: {fault.strerror}.") from fault
        self._show()

    def _ended(self, _: Future[Comparison]) -> None:
        self._work = ""
        self._show()

    def _show(self) -> None:
        """Update the list from disk; unchanged comparisons get their earlier stamps."""
        stamps = {(c.name, c.comparison): c.stamp for c in self._command_queue.now.comparisons}
        self._command_queue.change(
            comparisons=tuple(self._comparisons(stamps)) if self._command_queue.now.dataset is not None else ()
        )

    def _comparisons(self, stamps: dict[tuple[str, Comparison], int]) -> list[Compared]:

        dataset, comparisons = self._library.dataset, list[Compared]()
        for name, comparison in comparisons_of(dataset).items():
            stamp = stamps.get((name, comparison)) or next(self._stamps)
            outdated = _outdated(dataset.result(name).path, comparison)
            comparisons.append(Compared(comparison.number, name, comparison, stamp, outdated))
        return comparisons


def surface_of(now: Snapshot, show: int) -> Mosaic:
    """Return the displayed layer of a comparison, on any thread.

    Raises DatasetError when there is no such comparison.
    """
    face = comparison_of(show)
    comparison = next((c for c in now.comparisons if face is not None and c.number == face[0]), None)
    if face is None or comparison is None or now.dataset is None:
        raise DatasetError("This comparison was deleted: choose another surface to look at.")
    return _surface(now.dataset.path, comparison.name, face[1], comparison.stamp)


@lru_cache(maxsize=4)
def _surface(dataset: Path, name: str, face: ComparisonFace, stamp: int) -> Mosaic:

    return comparison_view(dataset, name, face)


def free_result(existing: tuple[str, ...], second: SurfaceName) -> str:
    """Return an unused result name for the difference from a surface."""
    words = re.sub(r"[^\w+-]+", "-", second.words).strip("-")
    names = (f"{PREFIX}{words}" if n == 1 else f"{PREFIX}{words}-{n}" for n in count(1))
    return next(name for name in names if name not in existing)


def _of(name: SurfaceName, heights: Any) -> SurfaceName:
    return SurfaceName(path=name.path, result=name.result, field=name.field, heights=heights)


def _surfaces_of(path: Path, field: int, same: bool) -> list[SurfaceName]:
    """Return the comparable surfaces of a dataset: stitched ones; in the same dataset, a field's in all results."""
    from wafer_viewer.store.dataset.dataset import Dataset

    try:
        dataset = Dataset.open(path)
    except WaferViewerError:
        return []
    if same and field:
        names = [
            name for name in dataset.results() if field in dataset.result(name).surfaces_done([dataset.field(field)])
        ]
        return [SurfaceName(path=str(path), result=name, field=field) for name in names]
    return [SurfaceName(path=str(path), result=name) for name in dataset.results() if dataset.result(name).has_mosaic]


def _outdated(folder: Path, comparison: Comparison) -> bool:
    from wafer_viewer.store.dataset.result import COMPARISON

    made = (folder / COMPARISON).stat().st_mtime
    try:
        return max(made_at(comparison.first), made_at(comparison.second)) > made
    except WaferViewerError:
        return True


# ------------------------------------------------------------------------------------------------------- comparison job


PREFIX = "difference-"
ALIGN_SHARE = 0.15
"""Fraction of the progress bar for the alignment, during a comparison."""
THREADS = 2


def open_surface(name: SurfaceName) -> Mosaic:
    """Return the surface of a name. Raises DatasetError when it does not exist."""
    from wafer_viewer.reconstruct.comparison.compare import read_as
    from wafer_viewer.store.formats.conversion import read_surface

    path = Path(name.path)
    if path.suffix != DATASET_ENDING:
        return read_as(read_surface(path), name.heights)
    data = Dataset.open(path)
    stored = data.result(name.result)
    return read_as(stored.surface(data.field(name.field)) if name.field else stored.mosaic(), name.heights)


def made_at(name: SurfaceName) -> float:
    """Return the time when the surface of a name was written, s since the epoch; 0 if it does not exist."""
    path = Path(name.path)
    if path.suffix == DATASET_ENDING:
        data = Dataset.open(path)
        stored = data.result(name.result)
        if name.field:
            return stored.field_stamp(data.field(name.field)) * 1e-9
        path = stored.mosaic_path / "zarr.json"
    return path.stat().st_mtime if path.exists() else 0.0


def comparison_view(dataset: Path, result: str, face: ComparisonFace) -> Mosaic:
    """Return a layer of a comparison. Raises DatasetError when it, or one of its surfaces, does not exist."""
    from wafer_viewer.reconstruct.comparison.compare import as_pyramid
    from wafer_viewer.reconstruct.comparison.resampled_surface import ResampledMosaic, SideBySideMosaic

    stored = Dataset.open(dataset).result(result)
    if face is ComparisonFace.DIFFERENCE:
        return stored.mosaic()
    comparison = stored.comparison()
    first = as_pyramid(open_surface(comparison.first))
    if face is ComparisonFace.FIRST:
        return first
    resampled = ResampledMosaic(first, as_pyramid(open_surface(comparison.second)), comparison.registration)
    return resampled if face is ComparisonFace.SECOND else SideBySideMosaic(resampled)


def comparisons_of(data: Dataset) -> dict[str, Comparison]:
    """Return the comparisons of a dataset by the names of their results; unreadable ones are omitted."""
    comparisons: dict[str, Comparison] = {}
    for name in data.differences():
        with suppress(DatasetError):
            comparisons[name] = data.result(name).comparison()
    return comparisons


def subtract(
    dataset: Path,
    result: str,
    first: SurfaceName,
    second: SurfaceName,
    align: Align,
    keep_z: bool,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Comparison:
    """Subtract two surfaces and store the difference as a result of a dataset, atomically.

    Raises MeasureError when they cannot be compared, ComputeError when the work is stopped, DatasetError when it cannot
    be written.
    """
    from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic
    from wafer_viewer.store.records.manifest import sign_result

    data = Dataset.open(dataset)
    target, number = data.result(result), 1 + max((c.number for c in comparisons_of(data).values()), default=0)
    _sweep(target.path.parent)
    difference = _compared(first, second, align, keep_z)
    progress(ALIGN_SHARE)
    if should_stop():
        raise ComputeError("The comparison was stopped. Nothing was kept of it.")
    tallied = StreamingStatistics(difference)
    with atomic_write(target.path) as temporary:
        temporary.mkdir(parents=True)
        write_mosaic(temporary / MOSAIC, tallied, partial(_later, progress), should_stop, THREADS)
        comparison = replace(tallied.comparison(first, second), number=number)
        save_json(temporary / COMPARISON, comparison)
    sign_result(target.path, fresh=True)
    return comparison


def keep_difference(
    path: Path, name: str, first: SurfaceName, second: SurfaceName, align: Align, keep_z: bool, tell: Progress
) -> Comparison:
    """Subtract two surfaces and store the difference with a dataset, which is locked meanwhile."""
    data = Dataset.open(path)
    lock = Lock.take(data.path)
    try:
        return subtract(data.path, f"{PREFIX}{name.removeprefix(PREFIX)}", first, second, align, keep_z, progress=tell)
    finally:
        lock.release()


def compare_files(
    first: SurfaceName, second: SurfaceName, align: Align, keep_z: bool
) -> tuple[Mosaic, Callable[[], Comparison]]:
    """Return the difference of two surfaces without writing it, and a function that returns its statistics."""
    tallied = StreamingStatistics(_compared(first, second, align, keep_z))
    return tallied.difference, lambda: tallied.comparison(first, second)


def _compared(first: SurfaceName, second: SurfaceName, align: Align, keep_z: bool) -> Difference:
    from wafer_viewer.reconstruct.comparison.compare import compare

    if first == second:
        raise DatasetError(f"{first.words} was to be compared with itself: choose another surface.")
    difference = compare(open_surface(first), open_surface(second), align, keep_z)
    notes = (f"{second.words} minus {first.words}.", *difference.provenance.notes[1:])
    return dataclasses.replace(difference, provenance=replace(difference.provenance, notes=notes))


def _later(progress: Progress, done: float) -> None:
    progress(ALIGN_SHARE + (1 - ALIGN_SHARE) * done)


def _sweep(folder: Path) -> None:
    """Remove files of comparisons whose process was killed; only one comparison runs at a time."""
    for leftover in folder.glob(f".{PREFIX}*.part"):
        pid = leftover.name.removesuffix(".part").rpartition(".")[2].partition("-")[0]
        if pid != str(os.getpid()):
            remove(leftover)


@dataclasses.dataclass(eq=False)
class StreamingStatistics:
    """Difference that accumulates statistics over its computed windows, each window once."""

    difference: Difference
    _sums: dict[tuple[float, float], DifferenceStatistics] = dataclasses.field(
        default_factory=dict[tuple[float, float], "DifferenceStatistics"]
    )

    @property
    def pixel_um(self) -> float:
        """Pixel size in um."""
        return self.difference.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0)."""
        return self.difference.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0)."""
        return self.difference.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.difference.shape

    @property
    def levels(self) -> int:
        """Number of levels, which is one."""
        return 1

    @property
    def provenance(self) -> Provenance:
        """Provenance of the difference."""
        return self.difference.provenance

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return a window of the difference.

        The single pixel read for a header has the same origin as the first window, which replaces it in the sums.
        """
        part = self.difference.window(region, level)
        self._sums[part.x0_um, part.y0_um] = self.difference.sums(part)
        return part

    def comparison(self, first: SurfaceName, second: SurfaceName) -> Comparison:
        """Return the comparison with its statistics over the computed windows.

        Without any window, the statistics cover the full difference.
        """
        from wafer_viewer.reconstruct.comparison.compare import DifferenceStatistics

        total = sum(self._sums.values(), DifferenceStatistics()) if self._sums else None
        provenance = self.provenance
        calibration = provenance.calibration
        return Comparison(
            first=first,
            second=second,
            registration=self.difference.registration,
            change=self.difference.change(total),
            simulated=provenance.simulated,
            calibrated=calibration is not None and calibration.problem(calibration.setup, today()) is None,
            notes=provenance.notes,
        )
