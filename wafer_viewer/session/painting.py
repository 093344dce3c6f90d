"""How each thing the page asks for is made from a surface. Runs in the painter's process, imports what is heavy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw import mesh
from wafer_viewer.draw.bake import VALUES, Picture, bake
from wafer_viewer.draw.glb import painted
from wafer_viewer.draw.ground import WALL_TONES, sides
from wafer_viewer.draw.look import eight_bit
from wafer_viewer.draw.reduce import reduced
from wafer_viewer.draw.shade import light_gain, without_gaps
from wafer_viewer.model.region import Region
from wafer_viewer.model.stack import FieldStack
from wafer_viewer.model.surface import HeightMap, Mosaic
from wafer_viewer.session.paint_request import Facts, PaintRequest, Relief, Scale, Source, pack_points

Window = tuple[slice, slice]

COARSE_PIXELS = 400_000
"""What facts, ranges and reliefs are taken from: enough for any of them, and read in a moment."""
_MARGIN_PX = 14
"""Read round a tile, so that light and hollows go on across its edge."""
_BINS = 60
_FRAME_SIDE_PX = 1024


class Shelf(Protocol):
    """Where surfaces and frames are found; the painter's is the store, tests have maps in memory."""

    def surface(self, source: Source) -> Mosaic:
        """The surface."""
        ...

    def stacks(self, source: Source) -> list[FieldStack]:
        """The focus stack of the source's field, or those of all fields for the stitched surface."""
        ...


def paint(shelf: Shelf, request: PaintRequest) -> bytes:
    """Make what a request asks for; no bytes when there is nothing to be seen. Raises WaferViewerError."""
    return PAINTERS[request.what](shelf, request)


def coarse_level(surface: Mosaic) -> int:
    """The finest level of at most `COARSE_PIXELS`."""
    rows, cols = surface.shape
    level = 0
    while (rows >> level) * (cols >> level) > COARSE_PIXELS:
        level += 1
    return level


def at_level(surface: Mosaic, level: int, window: Window | None = None) -> HeightMap:
    """A window of a level's lattice; levels that the surface does not keep are made from the coarsest it has."""
    kept = min(level, surface.levels - 1)
    factor = 2 ** (level - kept)
    if window is None:
        return reduced(surface.window(None, kept), factor)
    rows, cols = (slice(w.start * factor, w.stop * factor) for w in window)
    return reduced(surface.window(_region(surface, kept, rows, cols), kept), factor)


def _region(surface: Mosaic, level: int, rows: slice, cols: slice) -> Region:
    """The rectangle through the centres of the outermost pixels of a window."""
    scale = 2**level
    pixel, shift = surface.pixel_um * scale, (scale - 1) / 2 * surface.pixel_um
    x0, y0 = surface.x0_um + shift, surface.y0_um - shift
    return Region.rectangle(
        x0 + cols.start * pixel, y0 - (rows.stop - 1) * pixel, x0 + (cols.stop - 1) * pixel, y0 - rows.start * pixel
    )


# ---------------------------------------------------------------- the surface as a whole


def _facts(shelf: Shelf, request: PaintRequest) -> bytes:
    surface = shelf.surface(request.source)
    level = coarse_level(surface)
    coarse = at_level(surface, level)
    there = np.isfinite(coarse.z_um)
    heights = coarse.z_um[there] if there.any() else np.zeros(1, np.float32)
    low, high = (float(v) for v in np.percentile(heights, [0.5, 99.5]))
    rows, cols = (_extent(np.asarray(there.any(axis=1 - axis)), surface.shape[axis], 2**level) for axis in (0, 1))
    facts = Facts(
        *surface.shape, surface.pixel_um, surface.x0_um, surface.y0_um, *rows, *cols,
        float(heights.min()), float(heights.max()), low, high,
        light_gain(coarse.z_um, coarse.pixel_um), _plane(coarse),
    )  # fmt: skip
    return msgspec.json.encode(facts)


def _extent(there: NDArray[np.bool_], n: int, scale: int) -> tuple[int, int]:
    """[first, end) of what is there, in pixels of level 0."""
    hits = np.flatnonzero(there)
    return (0, n) if hits.size == 0 else (int(hits[0]) * scale, min(n, (int(hits[-1]) + 1) * scale))


def _plane(coarse: HeightMap) -> tuple[float, float, float]:
    """The least-squares plane through the middle heights: half of the points, those nearest to a first plane."""
    rows, cols = np.nonzero(np.isfinite(coarse.z_um))
    if rows.size < 3:
        return 0.0, 0.0, 0.0
    z = coarse.z_um[rows, cols].astype(float)
    design = np.stack([coarse.x_um[cols], coarse.y_um[rows], np.ones(rows.size)], axis=1)
    plane = np.linalg.lstsq(design, z, rcond=None)[0]
    for _ in range(2):
        distance = np.abs(z - design @ plane)
        kept = distance <= np.median(distance)
        plane = np.linalg.lstsq(design[kept], z[kept], rcond=None)[0]
    return float(plane[0]), float(plane[1]), float(plane[2])


def _scale(shelf: Shelf, request: PaintRequest) -> bytes:
    surface = shelf.surface(request.source)
    coarse = at_level(surface, coarse_level(surface))
    quantity = request.look.colour_by
    values = VALUES[quantity](coarse, request.light.plane)
    values = values[np.isfinite(values)]
    if values.size == 0:
        values = np.zeros(1, np.float32)
    own_low, p1, p99, own_high = (float(v) for v in np.percentile(values, [0.5, 1, 99, 99.5]))
    low, high = request.range_values or _usual_range(quantity, own_low, own_high)
    counts = np.histogram(values, _BINS, (low, max(high, low + 1e-9)))[0]
    shares = _origin_shares(coarse) if quantity == "origin" else {}
    counted = tuple(float(c) for c in counts)
    return msgspec.json.encode(Scale(quantity, low, high, own_low, own_high, p1, p99, counted, shares))


def _usual_range(quantity: str, low: float, high: float) -> tuple[float, float]:
    """Shares run from 0 to 1, slopes from 0, a deviation is symmetric; else 0.5 to 99.5 %, at least 0.2 apart."""
    if quantity in ("confidence", "grey"):
        return 0.0, 1.0
    if quantity == "slope":
        return 0.0, max(high, 1.0)
    if quantity == "deviation":
        most = max(abs(low), abs(high), 0.1)
        return -most, most
    middle, half = (low + high) / 2, max((high - low) / 2, 0.1)
    return middle - half, middle + half


def _origin_shares(coarse: HeightMap) -> dict[int, float]:
    counts = np.bincount(coarse.origin.ravel(), minlength=1)
    return {code: float(n / coarse.origin.size) for code, n in enumerate(counts) if n}


def _relief(shelf: Shelf, request: PaintRequest) -> bytes:
    surface = shelf.surface(request.source)
    coarse = at_level(surface, coarse_level(surface))
    heights, there = without_gaps(coarse.z_um).astype("<f4").tobytes(), np.isfinite(coarse.z_um).tobytes()
    return msgspec.msgpack.encode(Relief(*coarse.shape, coarse.pixel_um, coarse.x0_um, coarse.y0_um, heights, there))


# ---------------------------------------------------------------- parts of it


def _baked(shelf: Shelf, request: PaintRequest) -> tuple[HeightMap, NDArray[np.float32], Picture]:
    """The window of a request: its map, its heights without gaps, its picture."""
    surface = shelf.surface(request.source)
    (r0, r1), (c0, c1) = request.rows, request.cols
    margin = tuple(slice(max(0, a - _MARGIN_PX), b + _MARGIN_PX) for a, b in (request.rows, request.cols))
    around = at_level(surface, request.level, (margin[0], margin[1]))
    inner = slice(r0 - margin[0].start, r1 - margin[0].start), slice(c0 - margin[1].start, c1 - margin[1].start)
    picture = bake(around, request.look, request.light)[inner]
    return around.crop(*inner), without_gaps(around.z_um)[inner], picture


def _tile(shelf: Shelf, request: PaintRequest) -> bytes:
    part, heights, picture = _baked(shelf, request)
    return _draped(part, heights, picture, request)


def _flat(shelf: Shelf, request: PaintRequest) -> bytes:
    part, heights, picture = _baked(shelf, request)
    return _draped(part, np.full_like(heights, request.z0_um), picture, request)


def _draped(part: HeightMap, heights: NDArray[np.float32], picture: Picture, request: PaintRequest) -> bytes:
    there = picture[..., 3] > 0
    if not there.any():
        return b""
    x_mm, y_mm = (part.x_um * 1e-3).astype(np.float32), (part.y_um * 1e-3).astype(np.float32)
    return painted(mesh.surface(heights, there, x_mm, y_mm, request.z0_um, request.step), picture)


def _points(shelf: Shelf, request: PaintRequest) -> bytes:
    part, heights, picture = _baked(shelf, request)
    rows, cols = np.nonzero(np.isfinite(part.z_um))
    xyz = np.stack([
        (part.x_um - part.x_um.mean())[cols], (part.y_um - part.y_um.mean())[rows], heights[rows, cols] - request.z0_um
    ], axis=1)  # fmt: skip
    colours = picture[rows, cols, :3]
    return pack_points((xyz * 1e-3).astype(np.float16), colours)


def _walls(shelf: Shelf, request: PaintRequest) -> bytes:
    """From the four edges of a window down to `z0_um`; grey, because a wall is drawing, not data."""
    surface = shelf.surface(request.source)
    (r0, r1), (c0, c1) = request.rows, request.cols
    lines = (
        (slice(r1 - 1, r1), slice(c0, c1)), (slice(r0, r0 + 1), slice(c0, c1)),
        (slice(r0, r1), slice(c0, c0 + 1)), (slice(r0, r1), slice(c1 - 1, c1)),
    )  # fmt: skip
    edges = [_edge(at_level(surface, request.level, line), request) for line in lines]
    walls = mesh.walls(edges, 0.0)
    return painted(walls, sides(*WALL_TONES[request.dark])) if walls.triangles.size else b""


def _edge(
    line: HeightMap, request: PaintRequest
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """A line of pixels as x, y, z in mm; small gaps are bridged, large ones have no wall."""
    z = line.z_um.ravel()
    near = np.convolve(np.isfinite(z), np.ones(9), "same") > 0
    z = np.where(near, without_gaps(z[None])[0], np.nan) if near.any() else z
    x, y = np.broadcast_arrays(line.x_um[None, :], line.y_um[:, None])
    places = mesh.picked(z.size, request.step)
    x_mm, y_mm, z_mm = x.ravel() * 1e-3, y.ravel() * 1e-3, (z - request.z0_um) * 1e-3
    return x_mm[places].astype(np.float32), y_mm[places].astype(np.float32), z_mm[places].astype(np.float32)


# ---------------------------------------------------------------- frames


def _frame(shelf: Shelf, request: PaintRequest) -> bytes:
    """Frame k of a field as a picture lying at 0."""
    stack = shelf.stacks(request.source)[0]
    if not stack.present[request.k]:
        return b""
    step = -(-max(stack.images.shape[1:]) // _FRAME_SIDE_PX)
    image = eight_bit(stack.images[request.k][::step, ::step])
    half_x, half_y = (n * stack.pixel_um / 2 for n in (stack.images.shape[2], stack.images.shape[1]))
    x, y = stack.field.x_um, stack.field.y_um
    lying = mesh.flat((x - half_x) * 1e-3, (y - half_y) * 1e-3, (x + half_x) * 1e-3, (y + half_y) * 1e-3)
    return painted(lying, np.repeat(image[..., None], 3, axis=2))


PAINTERS: dict[str, Callable[[Shelf, PaintRequest], bytes]] = {
    "facts": _facts,
    "scale": _scale,
    "relief": _relief,
    "tile": _tile,
    "flat": _flat,
    "points": _points,
    "walls": _walls,
    "frame": _frame,
}
