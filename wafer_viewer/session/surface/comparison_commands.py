"""Comparisons of the open dataset: stored ones, new ones computed by a worker, and their displayed layers."""

from __future__ import annotations

import re
import shutil
from concurrent.futures import Future
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.surface.comparison import Align, Comparison, ComparisonFace, SurfaceName, comparison_of
from wafer_viewer.session.core.commands import command, query
from wafer_viewer.session.state.snapshot import Compared

if TYPE_CHECKING:
    from wafer_viewer.model.surface.height_map import Mosaic
    from wafer_viewer.session.core.background_work import BackgroundWork
    from wafer_viewer.session.core.command_queue import CommandQueue
    from wafer_viewer.session.core.dataset_library import Library
    from wafer_viewer.session.state.snapshot import Snapshot

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
        from wafer_viewer.session.surface.comparison_job import subtract

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
        from wafer_viewer.session.surface.comparison_job import comparisons_of

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
    from wafer_viewer.session.surface.comparison_job import comparison_view

    return comparison_view(dataset, name, face)


def free_result(existing: tuple[str, ...], second: SurfaceName) -> str:
    """Return an unused result name for the difference from a surface."""
    from wafer_viewer.session.surface.comparison_job import PREFIX

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
    from wafer_viewer.session.surface.comparison_job import made_at
    from wafer_viewer.store.dataset.result import COMPARISON

    made = (folder / COMPARISON).stat().st_mtime
    try:
        return max(made_at(comparison.first), made_at(comparison.second)) > made
    except WaferViewerError:
        return True
