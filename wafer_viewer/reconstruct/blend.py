"""Many height maps as one surface: linear ramps over the overlaps, X then Y (eq. 15 and 16), a window at a time.

Blending along X and then along Y is the same as one weight for each field, the product of its ramps; where a
neighbour is missing or saw nothing, the weights of what was measured add up to one again.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer import __version__
from wafer_viewer.model.errors import ComputeError, MeasureError
from wafer_viewer.model.plan import Field
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.stack import Image
from wafer_viewer.model.surface import HeightMap, Origin, Provenance, pixel_window
from wafer_viewer.numerics.overlay import Shift, Sums, add_heights, add_picture
from wafer_viewer.reconstruct.place import Layout, Place, layout
from wafer_viewer.reconstruct.pyramid import halved, joined

MAX_STEP_FRAMES = 2.0
_COARSEST_PX = 512
_BAND_PX = 4_000_000


@dataclass(frozen=True, slots=True, eq=False)
class StitchedMosaic:
    """A mosaic that is blended when a window of it is asked for; level 1 and up are 2 x 2 means."""

    heights: Sequence[HeightMap]
    layout: Layout
    provenance: Provenance

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.layout.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of the centre of pixel (0, 0) of level 0."""
        return self.layout.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of the centre of pixel (0, 0) of level 0."""
        return self.layout.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.layout.shape

    @property
    def levels(self) -> int:
        """Levels until the longer side is at most 512 pixels."""
        return 1 + max(0, math.ceil(math.log2(max(self.shape) / _COARSEST_PX)))

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """The part of a level that holds a region; all of it without one.

        Raises MeasureError when the region lies outside or the level is not there.
        """
        if not 0 <= level < self.levels:
            raise MeasureError(f"The mosaic has the levels 0 to {self.levels - 1}, level {level} was asked for.")
        scale = 2**level
        rows, cols = (slice(0, -(-n // scale)) for n in self.shape)
        if region is not None:
            rows, cols = pixel_window(self, region, level)
        band = max(1, _BAND_PX // ((cols.stop - cols.start) * scale * scale))
        starts = range(rows.start, rows.stop, band)
        return joined([self._band(slice(r, min(r + band, rows.stop)), cols, level) for r in starts])

    def _band(self, rows: slice, cols: slice, level: int) -> HeightMap:
        scale = 2**level
        fine_rows, fine_cols = (
            slice(part.start * scale, min(part.stop * scale, n))
            for part, n in zip((rows, cols), self.shape, strict=True)
        )
        height = blend_window(self.heights, fine_rows, fine_cols, self.layout, self.provenance)
        for _ in range(level):
            height = halved(height)
        return height


def stitch(
    heights: Sequence[HeightMap], fields: Sequence[Field] | None = None, recipe: Recipe = Recipe()
) -> StitchedMosaic:
    """One surface from height maps at their stage positions, or at those of `fields` (centres, in the same order).

    Raises ComputeError without heights, for differing pixel sizes, and when fields and heights differ in number.
    """
    placed = heights if fields is None else moved_to(heights, fields)
    lattice = layout(placed)
    return StitchedMosaic(placed, lattice, mosaic_provenance([h.provenance for h in placed], recipe))


def moved_to(heights: Sequence[HeightMap], fields: Sequence[Field]) -> list[HeightMap]:
    """The height maps centred on the positions of fields."""
    if len(heights) != len(fields):
        raise ComputeError(
            f"There are {len(heights)} height maps and {len(fields)} fields: give one field for each map."
        )
    return [
        dataclasses.replace(
            height,
            x0_um=field.x_um - (height.shape[1] - 1) / 2 * height.pixel_um,
            y0_um=field.y_um + (height.shape[0] - 1) / 2 * height.pixel_um,
        )
        for height, field in zip(heights, fields, strict=True)
    ]


def blend_window(
    heights: Sequence[HeightMap],
    rows: slice,
    cols: slice,
    lattice: Layout | None = None,
    provenance: Provenance | None = None,
) -> HeightMap:
    """The pixels [rows, cols] of the mosaic of some height maps; only the maps that touch them are looked at.

    Memory is that of the window, however many fields there are.
    """
    lattice = lattice or layout(heights)
    touching = [(lattice.places[n], heights[n]) for n in lattice.touching(rows, cols)]
    sums, picture = _empty_sums(rows, cols), _Picture.empty(rows, cols)
    for place, height in touching:
        spot = _spot(place, rows, cols)
        if spot is not None:
            _add_heights(height, spot, sums)
            picture.add(height.all_in_focus, spot)
    return HeightMap(
        z_um=_mean(sums.z, sums.weight),
        z_raw_um=_mean(sums.raw, sums.weight),
        confidence=_mean(sums.confidence, sums.weight, 0.0),
        all_in_focus=picture.grey([h.all_in_focus for _, h in touching]),
        origin=sums.origin,
        pixel_um=lattice.pixel_um,
        x0_um=lattice.x0_um + cols.start * lattice.pixel_um,
        y0_um=lattice.y0_um - rows.start * lattice.pixel_um,
        provenance=provenance or mosaic_provenance([h.provenance for _, h in touching], Recipe()),
    )


def blend_pictures(pictures: Sequence[Image], lattice: Layout, rows: slice, cols: slice) -> Image:
    """The pixels [rows, cols] of the mosaic of one picture a field, with the ramps of the heights; 0 where none is."""
    picture = _Picture.empty(rows, cols)
    for n in lattice.touching(rows, cols):
        spot = _spot(lattice.places[n], rows, cols)
        if spot is not None:
            picture.add(pictures[n], spot)
    return picture.grey(pictures)


def mosaic_provenance(parts: Sequence[Provenance], recipe: Recipe) -> Provenance:
    """Where a mosaic comes from: what its fields have in common, simulated when any field is."""
    if not parts:
        return Provenance(software_version=__version__)
    first = parts[0]
    joint = hashlib.sha256("".join(p.input_checksum for p in parts).encode()).hexdigest()
    return replace(
        first,
        recipe=replace(first.recipe, stitching=recipe.stitching),
        calibration=first.calibration if all(p.calibration == first.calibration for p in parts) else None,
        software_version=__version__,
        input_checksum=first.input_checksum if len(parts) == 1 else joint,
        simulated=any(p.simulated for p in parts),
        notes=tuple(dict.fromkeys(note for p in parts for note in p.notes)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Spot:
    """The part of a window that a field covers, the way from there to the field's pixels, and the field's weights."""

    part: tuple[slice, slice]
    shift: Shift
    row_weights: NDArray[np.float32]
    col_weights: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """Grey that is being added up over a window."""

    total: NDArray[np.float32]
    weight: NDArray[np.float32]

    @classmethod
    def empty(cls, rows: slice, cols: slice) -> _Picture:
        shape = rows.stop - rows.start, cols.stop - cols.start
        return cls(np.zeros(shape, np.float32), np.zeros(shape, np.float32))

    def add(self, picture: Image, spot: _Spot) -> None:
        total, weight = self.total[spot.part], self.weight[spot.part]
        add_picture(_fixed(picture), spot.shift, spot.row_weights, spot.col_weights, total, weight)

    def grey(self, like: Sequence[Image]) -> Image:
        """The mean grey, in the numbers of the pictures it is from; 0 where there was none."""
        dtype = np.result_type(*{p.dtype for p in like}) if like else np.dtype(np.uint8)
        return np.rint(_mean(self.total, self.weight, 0.0)).astype(dtype)


def _empty_sums(rows: slice, cols: slice) -> Sums:
    shape = rows.stop - rows.start, cols.stop - cols.start
    z, raw, confidence, weight = (np.zeros(shape, np.float32) for _ in range(4))
    return Sums(z, raw, confidence, weight, np.full(shape, Origin.NOT_COVERED, np.uint8))


def _add_heights(height: HeightMap, spot: _Spot, sums: Sums) -> None:
    z, raw, confidence, origin = map(_fixed, (height.z_um, height.z_raw_um, height.confidence, height.origin))
    max_step = np.float32(MAX_STEP_FRAMES * height.provenance.z_step_um)
    part = Sums(*(layer[spot.part] for layer in sums))  # pyright: ignore[reportArgumentType]
    add_heights(z, raw, confidence, origin, spot.shift, spot.row_weights, spot.col_weights, max_step, part)


def _spot(place: Place, rows: slice, cols: slice) -> _Spot | None:
    """Where a field lies in a window; None when it covers no pixel of it."""
    top, bottom = max(rows.start, math.ceil(place.row)), min(rows.stop, math.floor(place.last_row) + 1)
    left, right = max(cols.start, math.ceil(place.col)), min(cols.stop, math.floor(place.last_col) + 1)
    if bottom <= top or right <= left:
        return None
    row_part, row = math.modf(top - place.row)
    col_part, col = math.modf(left - place.col)
    return _Spot(
        (slice(top - rows.start, bottom - rows.start), slice(left - cols.start, right - cols.start)),
        Shift(int(row), int(col), row_part, col_part),
        place.row_weights(np.arange(top, bottom, dtype=np.float64)),
        place.col_weights(np.arange(left, right, dtype=np.float64)),
    )


def _fixed(layer: NDArray[Any]) -> NDArray[Any]:
    """A read-only view: kernels compile once for maps in memory and for those in a file."""
    view = layer.view()
    view.flags.writeable = False
    return view if view.flags.c_contiguous else _fixed(np.ascontiguousarray(layer))


def _mean(total: NDArray[np.float32], weight: NDArray[np.float32], without: float = np.nan) -> NDArray[np.float32]:
    return np.divide(total, weight, out=np.full(total.shape, without, np.float32), where=weight > 0)
