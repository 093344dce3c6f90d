"""Sources of surfaces and frames for the render process, and access to any level of a surface."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.surface.texture_baking import CODES, DRAWN, Floats, point_codes, reduced
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import Box
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.reconstruct.blending.mosaic_layout import FieldTilt, layout
from wafer_viewer.session.rendering.render_request import RefusedCounts, RenderRequest, SurfaceKey

# ------------------------------------------------------------------------------------------------------- render refused


_CODES = 32
EVERYWHERE: Box = (-np.inf, -np.inf, np.inf, np.inf)


@dataclass(frozen=True)
class PlacedField:
    """Field at its position in the surface: stage x and y of its pixel (0, 0), and the subtracted tilt.

    load: reads its height map on first access.
    """

    load: Callable[[], HeightMap]
    shape: tuple[int, int]
    pixel_um: float
    x0_um: float
    y0_um: float
    lean: FieldTilt = FieldTilt()

    @cached_property
    def height_map(self) -> HeightMap:
        """Height map of the field. Raises DatasetError when it is damaged."""
        return self.load()

    def meets(self, box_um: Box) -> bool:
        """Return whether some of its pixels may be inside a box."""
        rows, cols = self.shape
        right, foot = self.x0_um + cols * self.pixel_um, self.y0_um - rows * self.pixel_um
        return self.x0_um < box_um[2] and right >= box_um[0] and foot < box_um[3] and self.y0_um >= box_um[1]


@dataclass(frozen=True, slots=True, eq=False)
class RefusedPoints:
    """Refused points [n]: stage position and height in um, confidence from 0 to 1, and the code of `Origin`."""

    x_um: Floats
    y_um: Floats
    z_um: NDArray[np.float32]
    confidence: NDArray[np.float32]
    reason: NDArray[np.uint8]


def placed_fields(source: SurfaceKey) -> list[PlacedField]:
    """Return the field of a source, or all fields of a stitched surface, at their positions in it.

    A comparison and a surface from a file have none. Raises DatasetError when the dataset cannot be read.
    """
    from wafer_viewer.session.surface.stitching_inputs import FieldOutline
    from wafer_viewer.store.dataset.dataset import Dataset

    dataset = Dataset.open(source.dataset)
    result, by_number = dataset.result(source.result), {field.number: field for field in dataset.fields}
    poses = None
    if source.show:
        numbers = [source.show] if source.show in by_number else []
    else:
        poses = result.poses()
        numbers = sorted(result.surfaces_done(dataset.fields)) if poses is None else poses.numbers.tolist()
    if not numbers:
        return []
    outlines = [FieldOutline.of(dataset, by_number[number]) for number in numbers]
    lattice = layout(outlines, poses)
    return [
        PlacedField(
            partial(result.surface, by_number[number]),
            outline.shape,
            outline.pixel_um,
            lattice.x0_um + place.col * outline.pixel_um,
            lattice.y0_um - place.row * outline.pixel_um,
            place.lean,
        )
        for n, (number, outline) in enumerate(zip(numbers, outlines, strict=True))
        if (place := lattice.place(n)) is not None
    ]


def points_of(field: PlacedField, box_um: Box, datum: Datum | None = None, every: int = 1) -> RefusedPoints | None:
    """Return the refused points of a field in a box [x low, x high) x [y low, y high).

    Parameters
    ----------
    field
        The field, lying where the surface shows it.
    box_um
        x low, y low, x high, y high in um; may be infinite.
    datum
        Zero of the heights; None for that of the stage.
    every
        Take every n-th pixel along rows and columns.

    Returns
    -------
    RefusedPoints or None
        None where its file has none.
    """
    refused = field.height_map.refused
    if refused is None:
        return None
    rows, cols = field.shape
    top, foot = (int(np.clip((field.y0_um - y) / field.pixel_um, -1, rows)) for y in (box_um[3], box_um[1]))
    part = refused.of_rows(top, foot + 2, cols)
    index = refused.at[part].astype(np.int64)
    row, col = np.divmod(index, cols)
    x_um, y_um = field.x0_um + col * field.pixel_um, field.y0_um - row * field.pixel_um
    inside = (x_um >= box_um[0]) & (x_um < box_um[2]) & (y_um >= box_um[1]) & (y_um < box_um[3])
    if every > 1:
        inside &= (row % every == 0) & (col % every == 0)
    selected = np.flatnonzero(inside)
    row, col, x_um, y_um = row[selected], col[selected], x_um[selected], y_um[selected]
    z_um = refused.z_um[part][selected] - field.lean.at((rows - 1) / 2 - row, col - (cols - 1) / 2)
    if datum is not None:
        z_um = z_um - datum.at(x_um, y_um)
    confidence = field.height_map.confidence.ravel()[index[selected]]
    return RefusedPoints(x_um, y_um, z_um.astype(np.float32), confidence, refused.reason[part][selected])


def refused_in(fields: Sequence[PlacedField], request: RenderRequest, box_um: Box) -> Iterator[RefusedPoints]:
    """Yield the refused points of each field in a box, at the density of the request's level."""
    for field in fields:
        if field.meets(box_um):
            points = points_of(field, box_um, request.datum, 2**request.level)
            if points is not None:
                yield points


def count_refused(fields: Sequence[PlacedField], request: RenderRequest) -> RefusedCounts:
    """Count all refused points in the requested part of a surface."""
    box_um = EVERYWHERE if request.box_um is None else request.box_um
    by_code, by_reason = np.zeros(len(CODES) + 1, np.int64), np.zeros(_CODES, np.int64)
    without, low, high = 0, np.inf, -np.inf
    for field in (field for field in fields if field.meets(box_um)):
        points = points_of(field, box_um, request.datum)
        if points is None:
            without += 1
            continue
        if points.z_um.size:
            low, high = min(low, float(points.z_um.min())), max(high, float(points.z_um.max()))
        codes = point_codes(points.x_um, points.y_um, points.z_um, points.confidence, request.clip)
        by_code += np.bincount(codes, minlength=len(CODES) + 1)
        by_reason += np.bincount(points.reason[codes == DRAWN], minlength=_CODES)[:_CODES]
    return RefusedCounts(
        n_heights=int(by_code.sum()),
        n_points=int(by_code[DRAWN]),
        left_out={why: int(by_code[code]) for why, code in CODES.items()},
        by_reason={int(code): int(by_reason[code]) for code in np.flatnonzero(by_reason)},
        n_fields=len(fields),
        n_fields_without=without,
        span_um=(low, high) if by_code.any() else (0.0, 0.0),
    )


# ------------------------------------------------------------------------------------------------------- surface source


Window = tuple[slice, slice]

COARSE_PIXELS = 400_000
"""Pixel count of the level for statistics, ranges and reliefs: detailed enough for each, and fast to read."""


class SurfaceProvider(Protocol):
    """Source of surfaces and frames; the render process uses the store, tests use maps in memory."""

    def surface(self, source: SurfaceKey) -> Mosaic:
        """Return the surface."""
        ...

    def stacks(self, source: SurfaceKey) -> list[FieldStack]:
        """Return the focus stack of the source's field, or those of all fields for the stitched surface."""
        ...

    def fields(self, source: SurfaceKey) -> Sequence[PlacedField]:
        """Return the fields of the surface, at their positions in it; empty for a surface without fields."""
        ...


def coarse_level(surface: Mosaic) -> int:
    """Return the finest level with at most `COARSE_PIXELS` pixels."""
    rows, cols = surface.shape
    level = 0
    while (rows >> level) * (cols >> level) > COARSE_PIXELS:
        level += 1
    return level


def at_level(surface: Mosaic, level: int, window: Window | None = None) -> HeightMap:
    """Return a window of a level's lattice; missing levels are computed from the coarsest stored one."""
    stored_level = min(level, surface.levels - 1)
    factor = 2 ** (level - stored_level)
    if window is None:
        return reduced(surface.window(None, stored_level), factor)
    rows, cols = (slice(w.start * factor, w.stop * factor) for w in window)
    return reduced(surface.window(_region(surface, stored_level, rows, cols), stored_level), factor)


def levelled(part: HeightMap, datum: Datum | None) -> HeightMap:
    """Return heights above a datum; without one, relative to the stage's zero."""
    if datum is None:
        return part
    zero = datum.at(part.x_um[None, :], part.y_um[:, None]).astype(np.float32)
    return dataclasses.replace(part, z_um=part.z_um - zero, z_raw_um=part.z_raw_um - zero)


def _region(surface: Mosaic, level: int, rows: slice, cols: slice) -> Region:
    """Return the rectangle through the centres of the outermost pixels of a window."""
    scale = 2**level
    pixel, shift = surface.pixel_um * scale, (scale - 1) / 2 * surface.pixel_um
    x0, y0 = surface.x0_um + shift, surface.y0_um - shift
    return Region.rectangle(
        x0 + cols.start * pixel, y0 - (rows.stop - 1) * pixel, x0 + (cols.stop - 1) * pixel, y0 - rows.start * pixel
    )


def coarse(provider: SurfaceProvider, request: RenderRequest) -> HeightMap:
    """Return the surface of a request above its datum: its window, or without one the complete coarse level."""
    surface = provider.surface(request.source)
    if request.rows[1]:
        return levelled(at_level(surface, request.level, (slice(*request.rows), slice(*request.cols))), request.datum)
    return levelled(at_level(surface, coarse_level(surface)), request.datum)
