"""Incremental reconstruction of a field: frames are measured as they arrive.

The focus volume of the entire field is stored, 2 bytes per pixel and frame, with the silhouettes of its walls and the
measurements by which frames are judged. The map is bit-identical to the one that `reconstruct` makes of the finished
stack.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.auto_tuning import search_of
from wafer_viewer.reconstruct.field_pipeline import PreparedField, prepare_field, reconstruct_from_peaks, search_peaks
from wafer_viewer.reconstruct.focus.focus_measures import focus_kernels
from wafer_viewer.reconstruct.focus.focus_volume import FocusCurves, Volume, on_threads, rows_in
from wafer_viewer.reconstruct.focus.peak import Peaks, PeakScratch
from wafer_viewer.reconstruct.focus.peak_search import (
    WideLevels,
    fill_volume,
    find_peaks,
    include_frames,
    wide_cells,
)
from wafer_viewer.reconstruct.frame_blocks import StackSource, row_parts
from wafer_viewer.reconstruct.gates.silhouettes import DARK_SHARE_OF_WHITE, Silhouette, SilhouetteRows, silhouette_block
from wafer_viewer.reconstruct.preprocess.drift import measure_displacements, measure_sharpness
from wafer_viewer.reconstruct.preprocess.frames import FrameSamples, clipped_from

AHEAD_SHARE = 0.75
"""Share of the frames after which the motion between them is measured: the surface is behind most of them, and while
the others arrive their measurement, which is faster than a camera of 60 frames a second, catches up."""
LIVE_STRIPE_ROWS = 120
"""Rows whose levels lie together, a multiple of `COARSE_PX`: each stripe measures the rows beside it once more."""
WHITE_COUNTS = 255
"""White of 8-bit frames."""


class LiveField:
    """Focus volume of one field, built from frames that arrive in rising or falling order.

    images: the pages of the field, uint8 [k, row, col], memory-mapped while they are written, z rising with k; a page
    is read when `take` names it. recipe: settled, because no parameter can be estimated from frames that have not
    arrived.

    Raises ComputeError for a recipe with `auto`, and for images of another kind.
    """

    def __init__(self, images: Image, z_step_um: float, recipe: Recipe) -> None:
        if recipe.heights_have_auto:
            raise ComputeError("A live field needs a recipe whose automatic values have been chosen.")
        if images.dtype != np.uint8 or not images.flags.c_contiguous:
            raise ComputeError(f"A live field needs whole pages of 8-bit grey, not {images.dtype}: wait for its stack.")
        self._images, self._recipe = np.asarray(images), recipe  # each view of a memmap takes a microsecond more
        self._search = search_of(recipe, len(images), z_step_um)
        self._peaks = Peaks.empty(images.shape[1:], images.dtype, len(images))
        self._peaks.clipped[:] = 0
        cols = images.shape[2]
        self._stripes = [
            (rows, FocusCurves.make(len(images), (rows_in(rows), cols)))
            for rows in row_parts(images.shape[1], LIVE_STRIPE_ROWS)
        ]
        for _, curves in self._stripes:
            curves.best[:] = 0
            curves.peak[:] = 0
        stripe = rows_in(self._stripes[0][0]), cols
        self._best, self._peak, self._clipped = (np.empty(stripe, np.uint16) for _ in range(3))
        kernels = focus_kernels(self._search.measure)
        self._rows = kernels.make_rows(cols, self._search.window, images.dtype)
        self._table = kernels.table(images.dtype)
        self._wide = WideLevels(self._peaks.coarse, wide_cells(self._search.window)) if recipe.compare_windows else None
        looks_for_edges = recipe.edges != "none"
        self._silhouette = Silhouette.empty(images.shape[1:]) if looks_for_edges else None
        self._silhouette_rows = SilhouetteRows.make(cols, images.dtype)
        self._samples = FrameSamples(clipped_from(WHITE_COUNTS))
        self._came = np.zeros(len(images), np.bool_)

    @property
    def came(self) -> NDArray[np.bool_]:
        """Pages that have been measured, bool [k]."""
        return self._came.copy()

    def take_new(self, present: NDArray[np.bool_]) -> None:
        """Measure the available pages, bool [k], that have not been measured yet."""
        new = np.flatnonzero(present & ~self._came)
        for run in np.split(new, np.flatnonzero(np.diff(new) > 1) + 1):
            if run.size:
                self.take(int(run[0]), int(run[-1]) + 1)

    def take(self, first: int, stop: int) -> None:
        """Measure the pages first ... stop - 1, which must be written; each page is measured once."""
        if self._came[first:stop].any():
            raise ComputeError(f"Some of the pages {first} to {stop - 1} were added already: give each page once.")
        slots = np.arange(first, stop)
        for rows, curves in self._stripes:
            source, out, n = self._source(rows, slots), self._peaks.rows(rows), rows_in(rows)
            levels, coarse = curves.levels[first:stop], out.coarse[first:stop]
            volume = Volume(levels, self._best[:n], self._peak[:n], self._clipped[:n], coarse)
            fill_volume(source, self._search, self._rows, volume)
            include_frames(volume.best, volume.peak, volume.clipped, first, curves.best, curves.peak, out.clipped)
        self._add_silhouettes(slots)
        if self._wide is not None:
            self._wide.take(first, stop)
        for slot in slots.tolist():
            self._samples.take(slot, self._images[slot])
            if self._recipe.drift != "none":
                measure_sharpness(self._images[slot], slot, self._samples.motions)
        before = int(self._came.sum())
        self._came[first:stop] = True
        if before < AHEAD_SHARE * len(self._came) <= self._came.sum():
            self._measure_motions()

    def _measure_motions(self) -> None:
        """Measure the motion between the frames that arrived, if none is missing between them."""
        slots = np.flatnonzero(self._came)
        if self._recipe.drift == "none" or np.ptp(slots) >= slots.size:
            return
        arrived: Any = self._images[slots[0] : slots[-1] + 1]
        measure_displacements(
            lambda rows, cols: arrived[:, rows, cols], self._images.shape[1:], slots, self._samples.motions
        )

    def _add_silhouettes(self, slots: NDArray[np.int64]) -> None:
        """Add the silhouettes in some frames."""
        if self._silhouette is None:
            return
        source = self._source(slice(0, self._images.shape[1]), slots)
        dark_counts = DARK_SHARE_OF_WHITE * source.clipped_counts
        silhouette_block(source, int(slots[0]), 1, dark_counts, self._silhouette_rows, self._silhouette)

    def surface(self, stack: FieldStack) -> HeightMap:
        """Return the height map once all frames have arrived; stack: the same pages with their z.

        If the pixels need correction after all, or frames are missing, the complete stack is searched again.
        """
        field = prepare_field(stack, self._recipe, self._samples)
        if not self._is_complete(field):
            return reconstruct_from_peaks(field, search_peaks(field, threads=1)).height_map
        peaks = self._found(field)
        return reconstruct_from_peaks(field, peaks, silhouette=self._silhouette, wide=self._wide).height_map

    def _is_complete(self, field: PreparedField) -> bool:
        """Return whether all frames were measured, unmodified, with the measure, window and camera noise in use."""
        frames, search, used = field.frames, field.tuned.search, self._search
        complete = frames.as_stored and np.array_equal(frames.stored[0].slots, np.arange(len(self._images)))
        same_settings = (search.measure, search.window, search.camera) == (used.measure, used.window, used.camera)
        return bool(self._came.all()) and complete and same_settings

    def _found(self, field: PreparedField) -> Peaks:
        slots, z_um, search = np.arange(len(self._images)), field.frames.z_um, field.tuned.search

        def find(todo: Iterator[tuple[slice, FocusCurves]]) -> None:
            spots = PeakScratch.make(self._images.shape[2], self._table)
            for rows, curves in todo:
                find_peaks(self._source(rows, slots), z_um, search, curves, spots, self._peaks.rows(rows))

        on_threads(find, self._stripes, threads=None)
        return self._peaks

    def _source(self, rows: slice, slots: NDArray[np.int64]) -> StackSource:
        return StackSource.of(self._images, slots, rows.start, 0, clipped_from(WHITE_COUNTS))
