"""Mosaic update of a result: places new fields, and draws new or moved ones.

The job is the same from scratch, during a scan, after a repair and at the end; after an interruption it starts again
and gives the same mosaic.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.compute.task_runner import LocalRunner, TaskRunner
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.session.state.snapshot import Box, SurfaceInfo

if TYPE_CHECKING:
    from wafer_viewer.model.surface.field_poses import HeightOffsets, Poses, Shifts
    from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic
    from wafer_viewer.reconstruct.pose_graph.incremental import PreviousSolution
    from wafer_viewer.session.surface.stitching_inputs import StitchingInputs, Window
    from wafer_viewer.store.mosaic.zarr_mosaic import Patch

LOOK_SHARE = 0.4
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
    the work is stopped; an incomplete mosaic is drawn again next time.
    """
    from wafer_viewer.reconstruct.pose_graph.incremental import freeze_unmoved_fields
    from wafer_viewer.session.surface.stitching_inputs import StitchingInputs

    sheets = StitchingInputs.open(dataset.absolute(), result, recipe.stitching)
    hands = _Hands(sheets, crew or LocalRunner(), progress, should_stop)
    hands.crew.require_sight(sheets.data.path)
    known = sheets.known()
    outline = sheets.outlines[0]
    found = _find_poses(sheets, recipe, known, final, hands)
    poses, moved = freeze_unmoved_fields(found, known, outline.pixel_um, outline.corner_um)
    windows = None if known.poses is None else sheets.windows(known, poses, moved)
    if final and windows is not None and not windows and not sheets.mosaic_is_good():
        windows = None
    try:
        _draw(sheets, poses, recipe, windows, hands)
    except DatasetError:
        if windows is None:
            raise
        windows = None  # what is to be drawn over is damaged
        _draw(sheets, poses, recipe, windows, hands)
    return _summary(sheets, poses, recipe, windows)


@dataclass(frozen=True, slots=True)
class _Hands:
    """Runner of a stitching job, with its surfaces, progress callback and stop condition."""

    sheets: StitchingInputs
    crew: TaskRunner
    progress: Progress
    should_stop: ShouldStop

    def each(self, task: Callable[..., Any], items: Sequence[tuple[Any, ...]], begin: float, end: float) -> list[Any]:
        """Return the values of a task for all items, in their order; the first fault is raised."""
        values: list[Any] = [None] * len(items)
        for n, done in enumerate(self.crew.each(task, items, should_stop=self.should_stop), 1):
            if done.fault is not None:
                raise done.fault
            values[done.index] = done.value
            self.progress(begin + (end - begin) * n / len(items))
        return values


# ------------------------------------------------------------------------------------------------ looking at overlaps


def _find_poses(sheets: StitchingInputs, recipe: Recipe, known: PreviousSolution, final: bool, hands: _Hands) -> Poses:
    from wafer_viewer.reconstruct.stitching import FieldsToPlace, OverlapObservers, find_poses

    fields = FieldsToPlace.of(sheets.outlines, sheets.numbers, sheets.marks, recipe.stitching, known, final=final)
    observers = OverlapObservers(
        partial(_register, hands, recipe.stitching), partial(_compare, hands), sheets.surfaces.__getitem__
    )
    return find_poses(fields, observers)


def _register(hands: _Hands, stitching: Stitching, pairs: NDArray[np.int32]) -> Shifts:
    from wafer_viewer.model.surface.field_poses import joined, no_shifts

    reach_um = None if stitching.search_um == "auto" else stitching.search_um
    items = [(*_names(hands, part), reach_um) for part in _batches(pairs)]
    found = hands.each(register_pairs, items, 0.0, 0.7 * LOOK_SHARE)
    return _of_fields(joined(found), pairs) if found else no_shifts()


def _compare(
    hands: _Hands, pairs: NDArray[np.int32], x_um: NDArray[np.float64], y_um: NDArray[np.float64]
) -> HeightOffsets:
    from wafer_viewer.model.surface.field_poses import joined, no_seams

    items = [(*_names(hands, part), x_um[np.unique(part)], y_um[np.unique(part)]) for part in _batches(pairs)]
    found = hands.each(compare_pairs, items, 0.7 * LOOK_SHARE, LOOK_SHARE)
    return _of_fields(joined(found), pairs) if found else no_seams()


def _batches(pairs: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    return [pairs[i : i + PAIRS_A_TASK] for i in range(0, len(pairs), PAIRS_A_TASK)]


def _names(hands: _Hands, pairs: NDArray[np.int32]) -> tuple[Path, str, list[int], NDArray[np.int32]]:
    """Return pairs for a worker: the numbers of their fields, and pairs of indices into that list."""
    places, local = np.unique(pairs, return_inverse=True)
    numbers = [hands.sheets.numbers[place] for place in places]
    return hands.sheets.data.path, hands.sheets.kept.name, numbers, local.reshape(pairs.shape).astype(np.int32)


def _of_fields(table: Any, pairs: NDArray[np.int32]) -> Any:
    """Return a table of pairs with the indices of the fields in the complete list."""
    return replace(table, first=pairs[:, 0].copy(), second=pairs[:, 1].copy())


def register_pairs(
    dataset: Path, result: str, numbers: list[int], pairs: NDArray[np.int32], reach_um: float | None
) -> Shifts:
    """Register some fields by their overlaps in x and y, as a worker's task."""
    from wafer_viewer.reconstruct.registration.pair_registration import register
    from wafer_viewer.session.surface.stitching_inputs import surfaces_of

    return register(surfaces_of(dataset, result, numbers), pairs, reach_um, threads=1)


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


# ------------------------------------------------------------------------------------------------ drawing


def _draw(
    sheets: StitchingInputs, poses: Poses, recipe: Recipe, windows: Sequence[Window] | None, hands: _Hands
) -> None:
    """Draw windows of the mosaic, or a new one next to the existing one; each task writes its own shards."""
    from wafer_viewer.store.mosaic.zarr_mosaic import patches

    drawing = sheets.kept.begin_mosaic_update(poses)
    with _canvas(sheets, poses, recipe, fresh=windows is None) as canvas:
        work = patches(sheets.lattice.shape, windows)
        n_done = 0
        for _, level in groupby(work, lambda patch: patch.level):
            items = [(sheets.data.path, sheets.kept.name, recipe, drawing, canvas, patch) for patch in level]
            begin, end = (LOOK_SHARE + (1 - LOOK_SHARE) * n / len(work) for n in (n_done, n_done + len(items)))
            hands.each(draw_patch, items, begin, end)
            n_done += len(items)
    sheets.kept.commit_mosaic_update()


@contextmanager
def _canvas(sheets: StitchingInputs, poses: Poses, recipe: Recipe, *, fresh: bool) -> Generator[Path]:
    """Provide the mosaic to draw on; a new one has a temporary name until it is complete."""
    from wafer_viewer.store.io.atomic_files import atomic_write
    from wafer_viewer.store.mosaic.zarr_mosaic import lay_out, rewrite_header

    source = sheets.source(poses, sheets.provenance(poses, recipe))
    if not fresh:
        yield sheets.kept.mosaic_path
        rewrite_header(sheets.kept.mosaic_path, source)
        return
    with atomic_write(sheets.kept.mosaic_path) as beside:
        lay_out(beside, source)
        yield beside


def draw_patch(dataset: Path, result: str, recipe: Recipe, drawing: Path, canvas: Path, patch: Patch) -> None:
    """Blend and write one patch of the mosaic, as a worker's task."""
    from wafer_viewer.store.mosaic.zarr_mosaic import write_patch

    write_patch(canvas, _source(dataset, result, recipe, drawing, drawing.stat().st_mtime_ns), patch)


@lru_cache(maxsize=2)
def _source(dataset: Path, result: str, recipe: Recipe, drawing: Path, mark: int) -> StitchedMosaic:
    """Return the mosaic to be drawn, cached from patch to patch; `mark` identifies the drawing."""
    from wafer_viewer.model.surface.height_map import Provenance
    from wafer_viewer.session.surface.stitching_inputs import StitchingInputs
    from wafer_viewer.store.mosaic.poses_file import read_poses

    poses = read_poses(drawing)
    return StitchingInputs.drawn(dataset, result, recipe.stitching, poses).source(poses, Provenance(recipe=recipe))


# ------------------------------------------------------------------------------------------------ saying how it looks


def describe_mosaic(
    dataset: Path, result: str, *, progress: Progress = silent, should_stop: ShouldStop = never
) -> SurfaceInfo:
    """Compute the summary of an existing mosaic, as a worker's task."""
    from wafer_viewer.session.core.dataset_library import save_summary, summarise
    from wafer_viewer.session.surface.stitching_inputs import StitchingInputs
    from wafer_viewer.store.dataset.dataset import Dataset

    data = Dataset.open(dataset)
    kept = data.result(result)
    mosaic, recipe = kept.mosaic(), kept.recipe()
    if not data.fields:  # a surface of a file
        info = summarise(mosaic, 0, result, recipe)
        save_summary(kept, info)
        return info
    sheets = StitchingInputs.open(dataset, result, recipe.stitching)
    return _described(sheets, sheets.kept.poses(), recipe)


def _summary(sheets: StitchingInputs, poses: Poses, recipe: Recipe, windows: Sequence[Window] | None) -> SurfaceInfo:
    info = _described(sheets, poses, recipe)
    return info if windows is None else replace(info, changed=tuple((0, box) for box in _hull_um(sheets, windows)))


def _described(sheets: StitchingInputs, poses: Poses | None, recipe: Recipe) -> SurfaceInfo:
    """Compute and store the summary of the mosaic."""
    from wafer_viewer.session.core.dataset_library import save_summary, summarise
    from wafer_viewer.session.surface.focus_evidence import stitching_info

    info = summarise(sheets.kept.mosaic(), len(sheets.fields), sheets.kept.name, recipe)
    info = replace(info, stitching=None if poses is None else stitching_info(poses))
    save_summary(sheets.kept, info)
    return info


def _hull_um(sheets: StitchingInputs, windows: Sequence[Window]) -> list[Box]:
    """Return the box around all windows; empty without windows."""
    if not windows:
        return []
    lattice, pixel_um = sheets.lattice, sheets.lattice.pixel_um
    rows, cols = zip(*windows, strict=True)
    top, bottom = min(r.start for r in rows), max(r.stop for r in rows)
    left, right = min(c.start for c in cols), max(c.stop for c in cols)
    x0_um, y0_um = lattice.x0_um, lattice.y0_um
    return [(x0_um + left * pixel_um, y0_um - bottom * pixel_um, x0_um + right * pixel_um, y0_um - top * pixel_um)]
