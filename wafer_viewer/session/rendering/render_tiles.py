"""Geometry of a surface for the page: tiles in three forms, and the surrounding walls."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wafer_viewer.draw.colormaps import origin_table
from wafer_viewer.draw.surface import ground_plane as grounds
from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.clipping import CODES, DRAWN, clip_codes, point_codes
from wafer_viewer.draw.surface.glb import painted
from wafer_viewer.draw.surface.hillshade import without_gaps
from wafer_viewer.draw.surface.texture_baking import Picture, bake
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.rendering.render_refused import RefusedPoints, refused_in
from wafer_viewer.session.rendering.render_request import RenderRequest, pack_points
from wafer_viewer.session.rendering.surface_source import SurfaceProvider, at_level, levelled

_BRIDGED_PX = 9
"""Width in pixels of gaps that a wall bridges around a measured pixel."""
_PALE = {False: 226.0, True: 64.0}
_MARGIN_PX = 14
"""Margin in pixels read around a tile, so that shading continues across its edge."""


def _baked(shelf: SurfaceProvider, request: RenderRequest) -> tuple[HeightMap, NDArray[np.float32], Picture]:
    """Return the window of a request: its height map, its heights without gaps, its picture."""
    surface = shelf.surface(request.source)
    (r0, r1), (c0, c1) = request.rows, request.cols
    margin = tuple(slice(max(0, a - _MARGIN_PX), b + _MARGIN_PX) for a, b in (request.rows, request.cols))
    around = levelled(at_level(surface, request.level, (margin[0], margin[1])), request.datum)
    inner = slice(r0 - margin[0].start, r1 - margin[0].start), slice(c0 - margin[1].start, c1 - margin[1].start)
    heights = without_gaps(around.z_um)
    picture = bake(around, request.look, request.light, heights)[inner]
    return around.crop(*inner), heights[inner], picture


def tile(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a window of the surface as GLB."""
    part, heights, picture = _baked(shelf, request)
    return _draped(part, heights, picture, request)


def flat(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return the same picture as a flat tile at height 0."""
    part, heights, picture = _baked(shelf, request)
    return _draped(part, np.full_like(heights, request.z0_um), picture, request)


def _draped(part: HeightMap, heights: NDArray[np.float32], picture: Picture, request: RenderRequest) -> bytes:
    there = picture[..., 3] > 0
    if not there.any():
        return b""
    x_mm, y_mm = (part.x_um * 1e-3).astype(np.float32), (part.y_um * 1e-3).astype(np.float32)
    return painted(mesh.surface(heights, there, x_mm, y_mm, request.z0_um, request.step, request.skirts), picture)


def points(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a point for each pixel with a height, and on request for each refused one, inside the clip."""
    part, heights, picture = _baked(shelf, request)
    codes = clip_codes(part, request.clip)
    slab = request.clip.slab
    pale = codes == CODES["slab"] if slab is not None and slab.before == "pale" else np.zeros(part.shape, bool)
    rows, cols = np.nonzero(np.isfinite(part.z_um) & ((codes == DRAWN) | pale))
    x_um, y_um = part.x_um - part.x_um.mean(), part.y_um - part.y_um.mean()
    xyz = np.stack([x_um[cols], y_um[rows], heights[rows, cols] - request.z0_um], axis=1)
    colours = np.where(pale[rows, cols, None], _pale(picture[rows, cols, :3], request.dark), picture[rows, cols, :3])
    if request.refused:
        middle = float(part.x_um.mean()), float(part.y_um.mean()), request.z0_um
        more = [_refused(points, middle, request) for points in _refused_in_tile(shelf, request, part)]
        xyz = np.concatenate([xyz, *(places for places, _ in more)])
        colours = np.concatenate([colours, *(tones for _, tones in more)])
    return pack_points((xyz * 1e-3).astype(np.float16), colours.astype(np.uint8))


def _refused_in_tile(shelf: SurfaceProvider, request: RenderRequest, part: HeightMap) -> Iterator[RefusedPoints]:
    """Yield the refused points of a tile; a tile at the border of the measured area includes those beyond it."""
    x0, y0, x1, y1 = part.bounds_um
    half = part.pixel_um / 2
    foot, top, left, right = request.skirts
    box_um = (
        x0 - half if left else -np.inf,
        y0 - half if foot else -np.inf,
        x1 + half if right else np.inf,
        y1 + half if top else np.inf,
    )
    return refused_in(shelf.fields(request.source), request, box_um)


def _refused(
    points: RefusedPoints, middle_um: tuple[float, float, float], request: RenderRequest
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions relative to a centre in um, [n, 3], and colours by reason, [n, 3], of the shown points."""
    clip = request.clip
    codes = point_codes(points.x_um, points.y_um, points.z_um, points.confidence, clip)
    pale = (codes == CODES["slab"]) & (clip.slab is not None and clip.slab.before == "pale")
    shown = np.flatnonzero((codes == DRAWN) | pale)
    xyz = np.stack([points.x_um, points.y_um, points.z_um.astype(np.float64)], axis=1)[shown] - middle_um
    colours = origin_table()[points.reason[shown]]
    return xyz, np.where(pale[shown, None], _pale(colours, request.dark), colours)


def _pale(colours: NDArray[np.uint8], dark: bool) -> NDArray[np.float32]:
    """Return the colours of clipped points: grey, close to the background colour, with a trace of their shade."""
    shade = colours.mean(axis=1, keepdims=True, dtype=np.float32) / np.float32(255)
    return np.broadcast_to(np.float32(_PALE[dark]) * (np.float32(0.8) + np.float32(0.2) * shade), colours.shape)


def walls(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return walls from the four edges of a window down to `z0_um`; they are grey, because they show no data."""
    surface = shelf.surface(request.source)
    (r0, r1), (c0, c1) = request.rows, request.cols
    lines = (
        (slice(r1 - 1, r1), slice(c0, c1)), (slice(r0, r0 + 1), slice(c0, c1)),
        (slice(r0, r1), slice(c0, c0 + 1)), (slice(r0, r1), slice(c1 - 1, c1)),
    )  # fmt: skip
    sides = range(len(lines)) if request.side is None else (request.side,)
    edges = {k: _edge(levelled(at_level(surface, request.level, lines[k]), request.datum), request) for k in sides}
    # They reach a little into the plinth below: edges that only met would show cracks between their vertices.
    upright = mesh.walls(edges, -2e-3 * surface.pixel_um * 2**request.level)
    return painted(upright, grounds.sides(*grounds.WALL_TONES[request.dark])) if upright.triangles.size else b""


def _edge(
    line: HeightMap, request: RenderRequest
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return a line of pixels as x, y, z in mm; small gaps are bridged, large ones have no wall."""
    z = line.z_um.ravel()
    near = ndimage.maximum_filter1d(np.isfinite(z), _BRIDGED_PX)
    z = np.where(near, without_gaps(z[None])[0], np.nan) if near.any() else z
    x, y = np.broadcast_arrays(line.x_um[None, :], line.y_um[:, None])
    places = mesh.picked(z.size, request.step)
    x_mm, y_mm, z_mm = x.ravel() * 1e-3, y.ravel() * 1e-3, (z - request.z0_um) * 1e-3
    return x_mm[places].astype(np.float32), y_mm[places].astype(np.float32), z_mm[places].astype(np.float32)
