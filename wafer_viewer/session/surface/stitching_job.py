"""Mosaic update of a result: places new fields, and draws new or moved ones.

The job is the same from scratch, during a scan, after a repair and at the end; after an interruption it starts again
and gives the same mosaic.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.compute.task_runner import LocalRunner, TaskRunner
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.state.snapshot import Box, SurfaceInfo

if TYPE_CHECKING:
    from wafer_viewer.model.surface.field_poses import HeightOffsets, Poses, Shifts
    from wafer_viewer.reconstruct.blending.mosaic_layout import PixelLattice
    from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic
    from wafer_viewer.reconstruct.pose_graph.lateral_poses import PreviousSolution
    from wafer_viewer.reconstruct.registration.grid_steps import GridSteps
    from wafer_viewer.session.surface.stitching_inputs import StitchingInputs, Window
    from wafer_viewer.store.mosaic.zarr_mosaic import Patch

OVERLAP_SHARE = 0.4
"""Fraction of the progress bar for the overlaps."""
PAIRS_A_TASK = 8


def bring_up_to_date(
    dataset: Path,
    result: str,
    recipe: Recipe,
    final: bool = True,
    *,
    crew: TaskRunner | None = None,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> SurfaceInfo:
    """Stitch the surfaces of a result that its mosaic does not show yet, and return the summary.

    final: solve for the poses of all fields jointly; otherwise place new ones relative to the fixed others. Fields with
    an unreadable surface are omitted and reported. Raises DatasetError when no field has a surface, ComputeError when
    the work is stopped; an incomplete mosaic is drawn again next time. The final surface gets its manifest.
    """
    from wafer_viewer.reconstruct.pose_graph.lateral_poses import freeze_unmoved_fields
    from wafer_viewer.session.surface.stitching_inputs import StitchingInputs
    from wafer_viewer.store.records.manifest import sign_result

    inputs = StitchingInputs.open(dataset.absolute(), result, recipe)
    previous = inputs.previous_solution()
    if (estimated := inputs.with_estimated_steps(previous, final)) is not inputs:
        inputs, previous = estimated, estimated.previous_solution()
    tasks = _Tasks(inputs, crew or LocalRunner(), progress, should_stop)
    tasks.crew.require_sight(inputs.data.path)
    outline = inputs.outlines[0]
    solved = _solve_poses(tasks, previous, final)
    poses, moved = freeze_unmoved_fields(solved, previous, outline.pixel_um, outline.corner_um)
    windows = _windows_to_draw(inputs, previous, poses, moved, final)
    drawn = _draw(tasks, poses, windows)
    info = _summary(inputs, poses)
    if final:
        sign_result(inputs.stored.path)
    return info if drawn is None else replace(info, changed=tuple((0, box) for box in _hull_um(inputs.lattice, drawn)))


@dataclass(frozen=True, slots=True)
class _Tasks:
    """Work of a stitching job that is carried out by a task runner, with its progress and stop condition."""

    inputs: StitchingInputs
    crew: TaskRunner
    progress: Progress
    should_stop: ShouldStop

    def register(self, pairs: NDArray[np.int32]) -> Shifts:
        """Register pairs of fields in x and y."""
        from wafer_viewer.model.surface.field_poses import joined, no_shifts

        search_um = self.inputs.recipe.stitching.search_um
        reach_um = None if search_um == "auto" else search_um
        items = [(*self._names(part), reach_um, self.inputs.steps) for part in _batches(pairs)]
        results = self._each(register_pairs, items, 0.0, 0.7 * OVERLAP_SHARE)
        return _of_fields(joined(results), pairs) if results else no_shifts()

    def refine(self, pairs: NDArray[np.int32], shift_um: NDArray[np.float64]) -> Shifts:
        """Measure shifts of pairs of fields that are known to about two pixels."""
        from wafer_viewer.model.surface.field_poses import joined, no_shifts

        parts = zip(_batches(pairs), _batches(shift_um), strict=True)
        items = [(*self._names(part), shifts, self.inputs.steps) for part, shifts in parts]
        results = self._each(refine_pairs, items, 0.7 * OVERLAP_SHARE, 0.7 * OVERLAP_SHARE)
        return _of_fields(joined(results), pairs) if results else no_shifts()

    def compare(self, pairs: NDArray[np.int32], x_um: NDArray[np.float64], y_um: NDArray[np.float64]) -> HeightOffsets:
        """Compare the heights of pairs of fields, with the centres of all fields given."""
        from wafer_viewer.model.surface.field_poses import joined, no_seams

        items = [(*self._names(part), x_um[np.unique(part)], y_um[np.unique(part)]) for part in _batches(pairs)]
        results = self._each(compare_pairs, items, 0.7 * OVERLAP_SHARE, OVERLAP_SHARE)
        return _of_fields(joined(results), pairs) if results else no_seams()

    def draw(self, windows: Sequence[Window] | None, drawing: Path, canvas: Path) -> None:
        """Draw windows of the mosaic, or all of it; each task writes its own shards, level by level."""
        from wafer_viewer.store.mosaic.zarr_mosaic import patches

        work, n_done = patches(self.inputs.lattice.shape, windows), 0
        for _, level in groupby(work, lambda patch: patch.level):
            items = [(*self.inputs.name, self.inputs.recipe, drawing, canvas, patch) for patch in level]
            begin, end = (OVERLAP_SHARE + (1 - OVERLAP_SHARE) * n / len(work) for n in (n_done, n_done + len(items)))
            self._each(draw_patch, items, begin, end)
            n_done += len(items)

    def _each(self, task: Callable[..., Any], items: Sequence[tuple[Any, ...]], begin: float, end: float) -> list[Any]:
        """Return the values of a task for all items, in their order; the first fault is raised."""
        values: list[Any] = [None] * len(items)
        for n, done in enumerate(self.crew.each(task, items, should_stop=self.should_stop), 1):
            if done.fault is not None:
                raise done.fault
            values[done.index] = done.value
            self.progress(begin + (end - begin) * n / len(items))
        return values

    def _names(self, pairs: NDArray[np.int32]) -> tuple[Path, str, list[int], NDArray[np.int32]]:
        """Return pairs for a worker: the numbers of their fields, and pairs of indices into that list."""
        places, local = np.unique(pairs, return_inverse=True)
        numbers = [self.inputs.numbers[place] for place in places]
        return *self.inputs.name, numbers, local.reshape(pairs.shape).astype(np.int32)


def _batches(pairs: NDArray[Any]) -> list[NDArray[Any]]:
    return [pairs[i : i + PAIRS_A_TASK] for i in range(0, len(pairs), PAIRS_A_TASK)]


def _of_fields(table: Any, pairs: NDArray[np.int32]) -> Any:
    """Return a table of pairs with the indices of the fields in the complete list."""
    return replace(table, first=pairs[:, 0].copy(), second=pairs[:, 1].copy())


# --------------------------------------------------------------------------------------------------------------- poses


def _solve_poses(tasks: _Tasks, previous: PreviousSolution, final: bool) -> Poses:
    from wafer_viewer.reconstruct.overlap_settlement import FieldsToPlace, OverlapObservers
    from wafer_viewer.reconstruct.stitching import find_poses

    inputs, stitching = tasks.inputs, tasks.inputs.recipe.stitching
    fields = FieldsToPlace.of(
        inputs.outlines,
        inputs.numbers,
        inputs.marks,
        stitching,
        previous,
        final=final,
        assumed=inputs.assumed,
        calibration=inputs.data.scan.calibration,
    )
    poses = find_poses(
        fields, OverlapObservers(tasks.register, tasks.refine, tasks.compare, inputs.surfaces.__getitem__)
    )
    return replace(poses, notes=inputs.overlap_notes(poses) + poses.notes)


def register_pairs(
    dataset: Path,
    result: str,
    numbers: list[int],
    pairs: NDArray[np.int32],
    reach_um: float | None,
    steps: GridSteps | None,
) -> Shifts:
    """Register some fields by their overlaps in x and y, as a worker's task."""
    from wafer_viewer.reconstruct.registration.pair_registration import register
    from wafer_viewer.session.surface.stitching_inputs import surfaces_of

    return register(surfaces_of(dataset, result, numbers, steps), pairs, reach_um, threads=1)


def refine_pairs(
    dataset: Path,
    result: str,
    numbers: list[int],
    pairs: NDArray[np.int32],
    shift_um: NDArray[np.float64],
    steps: GridSteps | None,
) -> Shifts:
    """Measure known shifts of some fields more precisely, as a worker's task."""
    from wafer_viewer.reconstruct.registration.pair_registration import refine
    from wafer_viewer.session.surface.stitching_inputs import surfaces_of

    return refine(surfaces_of(dataset, result, numbers, steps), pairs, shift_um, threads=1)


def compare_pairs(
    dataset: Path,
    result: str,
    numbers: list[int],
    pairs: NDArray[np.int32],
    x_um: NDArray[np.float64],
    y_um: NDArray[np.float64],
) -> HeightOffsets:
    """Compare the heights of some fields, centred there, in their overlaps, as a worker's task."""
    from wafer_viewer.reconstruct.registration.height_seams import compare
    from wafer_viewer.session.surface.stitching_inputs import surfaces_of

    return compare(surfaces_of(dataset, result, numbers), pairs, x_um, y_um, threads=1)


# ------------------------------------------------------------------------------------------------------------- drawing


def _windows_to_draw(
    inputs: StitchingInputs, previous: PreviousSolution, poses: Poses, moved: NDArray[np.bool_], final: bool
) -> list[Window] | None:
    """Return the windows of the mosaic in which fields moved; None to draw all of it."""
    from wafer_viewer.store.dataset.integrity import is_mosaic_good

    if previous.poses is None:
        return None
    windows = inputs.windows(previous, poses, moved)
    if final and not windows and not is_mosaic_good(inputs.stored.mosaic_path):
        return None
    return windows


def _draw(tasks: _Tasks, poses: Poses, windows: list[Window] | None) -> list[Window] | None:
    """Draw windows of the mosaic, or all of it if there are none or it is damaged; return what was drawn."""
    if windows is not None:
        try:
            _draw_windows(tasks, poses, windows)
        except DatasetError:
            windows = None  # the mosaic to be updated is damaged
    if windows is None:
        _draw_windows(tasks, poses, None)
    return windows


def _draw_windows(tasks: _Tasks, poses: Poses, windows: Sequence[Window] | None) -> None:
    """Draw windows of the mosaic on disk, or a new one next to it that replaces it when complete."""
    drawing = tasks.inputs.stored.begin_mosaic_update(poses)
    with _canvas(tasks.inputs, poses, fresh=windows is None) as canvas:
        tasks.draw(windows, drawing, canvas)
    tasks.inputs.stored.commit_mosaic_update()


@contextmanager
def _canvas(inputs: StitchingInputs, poses: Poses, *, fresh: bool) -> Generator[Path]:
    """Provide the mosaic to draw on; a new one has a temporary name until it is complete."""
    from wafer_viewer.store.io.atomic_files import atomic_write
    from wafer_viewer.store.mosaic.zarr_mosaic import lay_out, rewrite_header

    path, mosaic = inputs.stored.mosaic_path, inputs.mosaic(poses, inputs.provenance(poses))
    if not fresh:
        yield path
        rewrite_header(path, mosaic)
        return
    with atomic_write(path) as temporary:
        lay_out(temporary, mosaic)
        yield temporary


def draw_patch(dataset: Path, result: str, recipe: Recipe, drawing: Path, canvas: Path, patch: Patch) -> None:
    """Blend and write one patch of the mosaic, as a worker's task."""
    from wafer_viewer.store.mosaic.zarr_mosaic import write_patch

    write_patch(canvas, _mosaic(dataset, result, recipe, drawing, drawing.stat().st_mtime_ns), patch)


@lru_cache(maxsize=2)
def _mosaic(dataset: Path, result: str, recipe: Recipe, drawing: Path, mark: int) -> StitchedMosaic:
    """Return the mosaic to be drawn, cached from patch to patch; `mark` identifies the drawing."""
    from wafer_viewer.model.surface.height_map import Provenance
    from wafer_viewer.session.surface.stitching_inputs import StitchingInputs
    from wafer_viewer.store.mosaic.poses_file import read_poses

    poses = read_poses(drawing)
    return StitchingInputs.drawn(dataset, result, recipe, poses).mosaic(poses, Provenance(recipe=recipe))


# ------------------------------------------------------------------------------------------------------------- summary


def describe_mosaic(
    dataset: Path, result: str, *, progress: Progress = silent, should_stop: ShouldStop = never
) -> SurfaceInfo:
    """Compute the summary of an existing mosaic, as a worker's task."""
    from wafer_viewer.session.core.dataset_library import save_summary, summarise
    from wafer_viewer.session.surface.stitching_inputs import StitchingInputs
    from wafer_viewer.store.dataset.dataset import Dataset

    data = Dataset.open(dataset)
    stored = data.result(result)
    mosaic, recipe = stored.mosaic(), stored.recipe()
    if not data.fields:  # a surface of a file
        info = summarise(mosaic, 0, result, recipe)
        save_summary(stored, info)
        return info
    return _summary(StitchingInputs.open(dataset, result, recipe), stored.poses())


def _summary(inputs: StitchingInputs, poses: Poses | None) -> SurfaceInfo:
    """Compute and store the summary of the mosaic."""
    from wafer_viewer.session.core.dataset_library import save_summary, summarise
    from wafer_viewer.session.surface.focus_evidence import stitching_info

    info = summarise(inputs.stored.mosaic(), len(inputs.fields), inputs.stored.name, inputs.recipe)
    info = replace(info, stitching=None if poses is None else stitching_info(poses))
    save_summary(inputs.stored, info)
    return info


def _hull_um(lattice: PixelLattice, windows: Sequence[Window]) -> list[Box]:
    """Return the box around all windows; empty without windows."""
    if not windows:
        return []
    rows, cols = zip(*windows, strict=True)
    top, bottom = min(r.start for r in rows), max(r.stop for r in rows)
    left, right = min(c.start for c in cols), max(c.stop for c in cols)
    x0_um, y0_um, pixel_um = lattice.x0_um, lattice.y0_um, lattice.pixel_um
    return [(x0_um + left * pixel_um, y0_um - bottom * pixel_um, x0_um + right * pixel_um, y0_um - top * pixel_um)]
