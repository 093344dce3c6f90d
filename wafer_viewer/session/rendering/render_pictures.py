"""Pictures for the page: tiles of a surface, frames of a field, and thumbnails of regions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wafer_viewer.draw.colormaps import origin_table
from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface import texture_baking as grounds
from wafer_viewer.draw.surface.display_style import DisplayStyle, Light, eight_bit
from wafer_viewer.draw.surface.mesh import jpeg, painted
from wafer_viewer.draw.surface.texture_baking import (
    CODES,
    DRAWN,
    Picture,
    bake,
    clip_codes,
    grey_image,
    light_gain,
    point_codes,
    reduced,
    without_gaps,
)
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.rendering import render_comparisons, render_statistics
from wafer_viewer.session.rendering.render_request import RenderRequest, pack_points
from wafer_viewer.session.rendering.surface_source import RefusedPoints, SurfaceProvider, at_level, levelled, refused_in

# ------------------------------------------------------------------------------------------------------ render pictures


_BRIDGED_PX = 9
"""Width in pixels of gaps that a wall bridges around a measured pixel."""
_PALE = {False: 226.0, True: 64.0}
_MARGIN_PX = 14
"""Margin in pixels read around a tile, so that shading continues across its edge."""


def _baked(provider: SurfaceProvider, request: RenderRequest) -> tuple[HeightMap, NDArray[np.float32], Picture]:
    """Return the window of a request: its height map, its heights without gaps, its picture."""
    surface = provider.surface(request.source)
    (r0, r1), (c0, c1) = request.rows, request.cols
    margin = tuple(slice(max(0, a - _MARGIN_PX), b + _MARGIN_PX) for a, b in (request.rows, request.cols))
    around = levelled(at_level(surface, request.level, (margin[0], margin[1])), request.datum)
    inner = slice(r0 - margin[0].start, r1 - margin[0].start), slice(c0 - margin[1].start, c1 - margin[1].start)
    heights = without_gaps(around.z_um)
    picture = bake(around, request.look, request.light, heights)[inner]
    return around.crop(*inner), heights[inner], picture


def tile(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a window of the surface as GLB."""
    part, heights, picture = _baked(provider, request)
    return _draped(part, heights, picture, request)


def flat(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return the same picture as a flat tile at height 0."""
    part, heights, picture = _baked(provider, request)
    return _draped(part, np.full_like(heights, request.z0_um), picture, request)


def _draped(part: HeightMap, heights: NDArray[np.float32], picture: Picture, request: RenderRequest) -> bytes:
    visible = picture[..., 3] > 0
    if not visible.any():
        return b""
    x_mm, y_mm = (part.x_um * 1e-3).astype(np.float32), (part.y_um * 1e-3).astype(np.float32)
    return painted(mesh.surface(heights, visible, x_mm, y_mm, request.z0_um, request.step, request.skirts), picture)


def points(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a point for each pixel with a height, and on request for each refused one, inside the clip."""
    part, heights, picture = _baked(provider, request)
    codes = clip_codes(part, request.clip)
    slab = request.clip.slab
    pale = codes == CODES["slab"] if slab is not None and slab.before == "pale" else np.zeros(part.shape, bool)
    rows, cols = np.nonzero(np.isfinite(part.z_um) & ((codes == DRAWN) | pale))
    x_um, y_um = part.x_um - part.x_um.mean(), part.y_um - part.y_um.mean()
    xyz = np.stack([x_um[cols], y_um[rows], heights[rows, cols] - request.z0_um], axis=1)
    colours = np.where(pale[rows, cols, None], _pale(picture[rows, cols, :3], request.dark), picture[rows, cols, :3])
    if request.refused:
        middle = float(part.x_um.mean()), float(part.y_um.mean()), request.z0_um
        more = [_refused(points, middle, request) for points in _refused_in_tile(provider, request, part)]
        xyz = np.concatenate([xyz, *(places for places, _ in more)])
        colours = np.concatenate([colours, *(tones for _, tones in more)])
    return pack_points((xyz * 1e-3).astype(np.float16), colours.astype(np.uint8))


def _refused_in_tile(provider: SurfaceProvider, request: RenderRequest, part: HeightMap) -> Iterator[RefusedPoints]:
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
    return refused_in(provider.fields(request.source), request, box_um)


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


def walls(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return walls from the four edges of a window down to `z0_um`; they are grey, because they show no data."""
    surface = provider.surface(request.source)
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


_FRAME_SIDE_PX = 1024
_SLICE_PIXELS = 1_500_000
_STRIP_ROWS = 512


def frame(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return frame k of a field as a flat picture at height 0."""
    stack = provider.stacks(request.source)[0]
    if not stack.present[request.k]:
        return b""
    step = -(-max(stack.images.shape[1:]) // _FRAME_SIDE_PX)
    image = eight_bit(stack.images[request.k][::step, ::step])
    half_x, half_y = (n * stack.pixel_um / 2 for n in (stack.images.shape[2], stack.images.shape[1]))
    x, y = stack.field.x_um, stack.field.y_um
    lying = mesh.flat((x - half_x) * 1e-3, (y - half_y) * 1e-3, (x + half_x) * 1e-3, (y + half_y) * 1e-3)
    return painted(lying, _grey(image))


def stitched(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return the image of all fields at one z, each from its nearest frame, blended like the surfaces."""
    from wafer_viewer.reconstruct.blending.mosaic_layout import layout
    from wafer_viewer.reconstruct.blending.stitched_mosaic import StackOutline, stitched_picture

    stacks = provider.stacks(request.source)
    if not stacks:
        return b""
    lattice = layout([StackOutline.of(s) for s in stacks])
    step = max(1, round((lattice.shape[0] * lattice.shape[1] / _SLICE_PIXELS) ** 0.5))
    height = _STRIP_ROWS // step * step
    strips = [
        eight_bit(
            stitched_picture(stacks, request.z_um, slice(r, min(r + height, lattice.shape[0])))[0][::step, ::step]
        )
        for r in range(0, lattice.shape[0], height)
    ]
    x0, y1 = lattice.x0_um - lattice.pixel_um / 2, lattice.y0_um + lattice.pixel_um / 2
    x1, y0 = x0 + lattice.shape[1] * lattice.pixel_um, y1 - lattice.shape[0] * lattice.pixel_um
    lying = mesh.flat(x0 * 1e-3, y0 * 1e-3, x1 * 1e-3, y1 * 1e-3)
    return painted(lying, _grey(np.concatenate(strips)))


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(image[..., None], 3, axis=2)


SIDE_PX = 96
"""Maximum length in pixels of the longer side of a picture, unless the request specifies it."""
_QUALITY = 80
_UNMEASURED = np.array([200, 208, 216], np.uint8)


def picture(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return the box of a request as JPEG, over its own range of heights; no bytes if nothing of it is measured.

    Coloured by ``grey`` it is the all-in-focus image.
    """
    if request.box_um is None:
        return b""
    surface = provider.surface(request.source)
    x0, y0, x1, y1 = request.box_um
    pixels = max(x1 - x0, y1 - y0) / surface.pixel_um
    level = max(0, math.ceil(math.log2(max(1.0, pixels / (request.side_px or SIDE_PX)))))
    stored_level = min(level, surface.levels - 1)
    part = levelled(
        reduced(surface.window(Region.rectangle(*request.box_um), stored_level), 2 ** (level - stored_level)),
        request.datum,
    )
    measured = np.isfinite(part.z_um)
    if 0 in part.shape or not measured.any():
        return b""
    grey = request.look.colour_by == "grey"
    low, high = (float(v) for v in np.percentile(grey_image(part)[measured] if grey else part.z_um[measured], [1, 99]))
    span = max(high - low, 1e-3)
    heights = DisplayStyle(low=low, high=low + span, hillshade=0.6)
    look = replace(heights, colour_by="grey", colours="grey", hillshade=0.0) if grey else heights
    baked = bake(part, look, Light(light_gain(part.z_um, part.pixel_um), span))
    return jpeg(np.where(baked[..., 3:] > 0, baked[..., :3], _UNMEASURED), _QUALITY)


# ------------------------------------------------------------------------------------------------------ render dispatch


PAINTERS: dict[str, Callable[[SurfaceProvider, RenderRequest], bytes]] = {
    "facts": render_statistics.facts,
    "scale": render_statistics.scale,
    "relief": render_statistics.relief,
    "tile": tile,
    "flat": flat,
    "points": points,
    "walls": walls,
    "frame": frame,
    "slice": stitched,
    "picture": picture,
    "beside": render_comparisons.comparison,
    "die": render_comparisons.die,
    "statistics": render_statistics.statistics,
}


def paint(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Execute a render request; no bytes when nothing is visible. Raises WaferViewerError."""
    return PAINTERS[request.what](provider, request)
