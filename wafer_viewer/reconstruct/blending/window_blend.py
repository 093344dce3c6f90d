"""Blending of one window of a mosaic from its fields, weighted by confidence.

The window is split into pieces that are covered by a constant set of fields: most of them by one, which is read
directly into the output; further fields are blended in one by one. Every pixel is independent of the window in which it
is requested.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.numerics.grids import resampling as shifted_read
from wafer_viewer.numerics.grids import weighted_blend
from wafer_viewer.numerics.grids.resampling import Shift, TiltedField
from wafer_viewer.numerics.grids.weighted_blend import Blended, BlendPiece, Tally
from wafer_viewer.reconstruct.blending.mosaic_layout import FieldPlacement, MosaicLayout, Part
from wafer_viewer.reconstruct.registration.height_seams import MAX_STEP_FRAMES


def pieces(window: Part, parts: Sequence[Part]) -> Iterator[tuple[Part, list[int]]]:
    """Yield the pieces of a window from top to bottom, with the indices of the parts that cover each.

    Together the pieces form the window.
    """
    rows, cols = window
    for band in _cut(rows, (part[0] for part in parts)):
        covering = [n for n, (of_part, _) in enumerate(parts) if _holds(of_part, band)]
        for strip in _cut(cols, (parts[n][1] for n in covering)):
            yield (band, strip), [n for n in covering if _holds(parts[n][1], strip)]


def _cut(full: slice, parts: Iterable[slice]) -> Iterator[slice]:
    """Split a range of pixels wherever a part begins or ends."""
    inside = {end for part in parts for end in (part.start, part.stop) if full.start < end < full.stop}
    ends = [full.start, *sorted(inside), full.stop]
    return (slice(a, b) for a, b in itertools.pairwise(ends))


def _holds(part: slice, run: slice) -> bool:
    return part.start <= run.start and run.stop <= part.stop


LEAST_WEIGHT = 1e-6
"""Minimum weight of a border pixel: negligible against a neighbour, but sufficient where that is unmeasured."""
FADE_SHARE = 0.3
"""Fraction of an overlap used for fading: long enough to hide seams; shorter values give smaller errors."""

Weights = NDArray[np.float64]
Float32s = NDArray[np.float32]


def _linear(share: Weights) -> Weights:
    """Return the ramp of eq. 15: from 0 at the field's own border to 1 at the border of its neighbour."""
    return share


def _smooth(share: Weights) -> Weights:
    """Return a ramp with zero slope at both ends, so that field borders are invisible."""
    return share**2 * (3 - 2 * share)


def _soon_smooth(share: Weights) -> Weights:
    """Return a smooth ramp over a part of the overlap; in the rest both fields count fully and errors average out."""
    return _smooth(np.minimum(share / FADE_SHARE, 1))


@dataclass(frozen=True, slots=True)
class Blend:
    """Blending method: the fading of heights and of grey towards the border.

    judges: True if heights are weighted by confidence, and only the more reliable of grossly different heights counts;
    otherwise heights are averaged whatever they are.
    """

    heights: Callable[[Weights], Weights]
    grey: Callable[[Weights], Weights]
    judges: bool


BLENDS: dict[str, Blend] = {
    "confidence": Blend(_soon_smooth, _smooth, judges=True),
    "ramp": Blend(_linear, _linear, judges=False),
}
"""Blending methods by their name in the recipe."""


@dataclass(frozen=True, slots=True, eq=False)
class Fade:
    """Separable weights of a field: row weights times column weights."""

    rows: Float32s
    cols: Float32s

    def over(self, rows: slice, cols: slice) -> Fade:
        """Return the weights of a part."""
        return Fade(self.rows[rows], self.cols[cols])

    @property
    def weights(self) -> Float32s:
        """All weights, [row, col]."""
        return self.rows[:, None] * self.cols


@dataclass(frozen=True, slots=True, eq=False)
class PlacedWindow:
    """A field in the mosaic: covered pixels, sub-pixel shift, tilt and weights."""

    part: Part
    row_part: float
    col_part: float
    leaning: TiltedField
    fade: Fade
    grey_fade: Fade

    @classmethod
    def of(cls, place: FieldPlacement, blend: Blend) -> PlacedWindow:
        """Return a placed field with the weights of a blending method."""
        rows, cols = (np.arange(run.start, run.stop) for run in place.part)
        down, right = rows - place.row, cols - place.col
        return cls(
            place.part,
            float(down[0]),
            float(right[0]),
            _leaning(place, (place.rows - 1) / 2 - down, right - (place.cols - 1) / 2),
            _faded(place, down, right, blend.heights),
            _faded(place, down, right, blend.grey),
        )

    def over(self, piece: Part) -> PlacedWindow:
        """Return the restriction to a piece of the covered pixels."""
        rows, cols = (slice(a.start - b.start, a.stop - b.start) for a, b in zip(piece, self.part, strict=True))
        lean = self.leaning
        return replace(
            self,
            part=(rows, cols),
            leaning=TiltedField(lean.rows[rows], lean.cols[cols], lean.up[rows], lean.right[cols]),
            fade=self.fade.over(rows, cols),
            grey_fade=self.grey_fade.over(rows, cols),
        )

    @property
    def shift(self) -> Shift:
        """Shift from the pixels of the piece to those of the field."""
        return Shift(self.part[0].start, self.part[1].start, self.row_part, self.col_part)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the piece."""
        return self.fade.rows.size, self.fade.cols.size

    def nearest(self, layer: NDArray[Any]) -> NDArray[Any]:
        """Return the layer's pixels nearest to those of the piece, as a view."""
        (row, col), (n_rows, n_cols) = self.nearest_corner, self.shape
        return layer[row : row + n_rows, col : col + n_cols]

    def belief(self, height: HeightMap, blend: Blend) -> Float32s:
        """Return the blending weights of the heights, [row, col]."""
        out = np.ones(self.shape, np.float32)
        if blend.judges:
            limit_um = _max_step_um(height) or np.inf
            weighted_blend.blend_weights(
                fixed(height.z_um), fixed(height.confidence), *self.nearest_corner, limit_um, out
            )
        return out

    @property
    def nearest_corner(self) -> tuple[int, int]:
        """Pixel of the field nearest to the first pixel of the piece."""
        rows, cols = self.part
        return rows.start + int(self.row_part > 0.5), cols.start + int(self.col_part > 0.5)

    def heights(self, layer: Float32s, max_step_um: float, out: Float32s, row: int, col: int) -> None:
        """Read tilt-corrected heights of the piece to (row, col) of `out`."""
        shifted_read.read_heights(fixed(layer), self.shift, self.leaning, max_step_um, out, row, col)

    def grey(self, picture: Image) -> Float32s:
        """Return the grey of the piece."""
        out = np.empty(self.shape, np.float32)
        shifted_read.read_grey(fixed(picture), self.shift, out)
        return out


def blend_layers(
    heights: Sequence[HeightMap], layout: MosaicLayout, rows: slice, cols: slice, blend: Blend
) -> dict[str, Any]:
    """Return the layers of a window [rows, cols] of the mosaic by name; only fields that touch it are read."""
    fields = _placed_fields(heights, layout, rows, cols, blend)
    sources = [height for height, _ in fields] or [heights[0]]
    window = _empty(
        (rows.stop - rows.start, cols.stop - cols.start), _type([height.all_in_focus for height in sources])
    )
    for piece, numbers in pieces((rows, cols), [placed.part for _, placed in fields]):
        covering = [(fields[n][0], fields[n][1].over(piece)) for n in numbers]
        if covering:
            _fill(window, piece[0].start - rows.start, piece[1].start - cols.start, covering, blend)
    return window


def lay_pictures(pictures: Sequence[Image], layout: MosaicLayout, rows: slice, cols: slice, blend: Blend) -> Image:
    """Return the window for one image per field; 0 where there is none."""
    fields = _placed_fields(pictures, layout, rows, cols, blend)
    sources = [picture for picture, _ in fields] or [pictures[0]]
    out = np.zeros((rows.stop - rows.start, cols.stop - cols.start), _type(sources))
    for piece, numbers in pieces((rows, cols), [placed.part for _, placed in fields]):
        covering = [(fields[n][0], fields[n][1].over(piece)) for n in numbers]
        if covering:
            weighted_blend.round_grey(_grey(covering), out, piece[0].start - rows.start, piece[1].start - cols.start)
    return out


def fixed(layer: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view, so that kernels compile once for maps in memory and memory-mapped maps."""
    view = layer.view()
    view.flags.writeable = False
    return view if view.flags.c_contiguous else fixed(np.ascontiguousarray(layer))


def _placed_fields(
    items: Sequence[Any], layout: MosaicLayout, rows: slice, cols: slice, blend: Blend
) -> list[tuple[Any, PlacedWindow]]:
    """Return the items that touch a window, with their placements; fields between two pixel lines are omitted."""
    touching = ((n, layout.place(n)) for n in layout.touching(rows, cols))
    return [
        (items[n], PlacedWindow.of(place, blend)) for n, place in touching if place is not None and place.covers_any
    ]


def _leaning(place: FieldPlacement, up: Weights, right: Weights) -> TiltedField:
    """Return the height correction at `up` and `right` of the field's centre, in pixels."""
    lean = place.lean
    u, v = right / lean.so_far_px[0], up / lean.so_far_px[1]
    a, b, c = lean.sag_um
    of_rows, of_cols = lean.z_um + lean.up_um_px * up + c * v**2, lean.right_um_px * right + a * u**2
    return TiltedField(*(term.astype(np.float32) for term in (of_rows, of_cols, b * v, u)))


def _faded(place: FieldPlacement, down: Weights, right: Weights, fade: Callable[[Weights], Weights]) -> Fade:
    """Return the weights at `down` and `right` of the field's first pixel."""
    top_px, bottom_px, left_px, right_px = place.ramps_px
    rows = fade(_within_ramps(down, place.rows - 1 - down, top_px, bottom_px))
    cols = fade(_within_ramps(right, place.cols - 1 - right, left_px, right_px))
    return Fade(*(np.maximum(weights, LEAST_WEIGHT).astype(np.float32) for weights in (rows, cols)))


def _within_ramps(from_start: Weights, to_end: Weights, start_px: float, end_px: float) -> Weights:
    """Return the relative position within the ramps, 1 beyond them."""
    share = np.ones(from_start.shape)
    for distance, ramp_px in ((from_start, start_px), (to_end, end_px)):
        if ramp_px > 0:
            share = np.minimum(share, distance / ramp_px)
    return share


def _empty(shape: tuple[int, int], grey: np.dtype[Any]) -> dict[str, Any]:
    """Return the layers of a window without fields."""
    z, raw, overlap, u = (np.full(shape, np.nan, np.float32) for _ in range(4))
    return {
        "z_um": z,
        "z_raw_um": raw,
        "confidence": np.zeros(shape, np.float32),
        "all_in_focus": np.zeros(shape, grey),
        "origin": np.full(shape, Origin.NOT_COVERED, np.uint8),
        "overlap_um": overlap,
        "u_um": u,
    }


def _type(pictures: Sequence[Image]) -> np.dtype[Any]:
    """Return the common dtype of the images of a mosaic."""
    return np.result_type(*{picture.dtype for picture in pictures})


def _fill(
    window: dict[str, Any], row: int, col: int, fields: Sequence[tuple[HeightMap, PlacedWindow]], blend: Blend
) -> None:
    """Fill a piece of a window from (row, col) on: copy the first field, then blend in the others."""
    first, placed = fields[0]
    area = slice(row, row + placed.shape[0]), slice(col, col + placed.shape[1])
    placed.heights(first.z_um, _max_step_um(first), window["z_um"], row, col)
    placed.heights(first.z_raw_um, _max_step_um(first), window["z_raw_um"], row, col)
    window["confidence"][area] = placed.nearest(first.confidence)
    window["origin"][area] = placed.nearest(first.origin)
    window["u_um"][area] = placed.nearest(_u_um(first))
    if len(fields) > 1:
        _blend_in(window, area, fields, blend)
    weighted_blend.round_grey(
        _grey([(height.all_in_focus, placed) for height, placed in fields]), window["all_in_focus"], row, col
    )
    window["u_um"][area][np.isnan(window["z_raw_um"][area])] = np.nan


def _blend_in(
    window: dict[str, Any], area: Part, fields: Sequence[tuple[HeightMap, PlacedWindow]], blend: Blend
) -> None:
    """Blend the other fields into a piece that holds the first."""
    blended = Blended(*(window[name] for name in ("z_um", "z_raw_um", "confidence", "origin", "overlap_um", "u_um")))
    first, placed = fields[0]
    raw = blended.raw[area]
    tally = Tally(placed.fade.weights * placed.belief(first, blend), raw.copy(), raw.copy())
    limit_um = max(_max_step_um(height) for height, _ in fields) if blend.judges else 0.0
    scratch = np.empty((2, area[1].stop - area[1].start), np.float32)
    for height, placed in fields[1:]:
        piece = _read(height, placed, blend)
        weighted_blend.accumulate(piece, limit_um or np.inf, tally, scratch, blended, area[0].start, area[1].start)


def _read(height: HeightMap, placed: PlacedWindow, blend: Blend) -> BlendPiece:
    """Return the layers of a field over a piece."""
    z, raw = (np.empty(placed.shape, np.float32) for _ in range(2))
    placed.heights(height.z_um, _max_step_um(height), z, 0, 0)
    placed.heights(height.z_raw_um, _max_step_um(height), raw, 0, 0)
    confidence, origin, u = (
        fixed(placed.nearest(layer)) for layer in (height.confidence, height.origin, _u_um(height))
    )
    return BlendPiece(z, raw, confidence, origin, u, placed.belief(height, blend), placed.fade.rows, placed.fade.cols)


def _u_um(height: HeightMap) -> Float32s:
    """Return the standard uncertainty of each height, NaN where it is not known."""
    unknown = np.broadcast_to(np.float32(np.nan), height.shape)
    return unknown if height.u_um is None else height.u_um


def _grey(fields: Sequence[tuple[Image, PlacedWindow]]) -> Float32s:
    """Return the blended grey of a piece, from all images that cover it."""
    total = fields[0][1].grey(fields[0][0])
    if len(fields) > 1:
        weight = fields[0][1].grey_fade.weights
        for picture, placed in fields[1:]:
            weighted_blend.blend_grey(placed.grey(picture), placed.grey_fade.rows, placed.grey_fade.cols, weight, total)
    return total


def _max_step_um(height: HeightMap) -> float:
    return MAX_STEP_FRAMES * height.provenance.z_step_um
