"""Refused points of a surface for the page: their positions, reasons and counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.surface.texture_baking import CODES, DRAWN, Floats, point_codes
from wafer_viewer.model.measurement.levelling import Datum
from wafer_viewer.model.surface.clipping import Box
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.blending.mosaic_layout import FieldTilt, layout
from wafer_viewer.session.rendering.render_request import RefusedCounts, RenderRequest, SurfaceKey

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
        None where the surface was made before refused heights were kept.
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
