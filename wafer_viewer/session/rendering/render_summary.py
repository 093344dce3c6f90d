"""Summary of a surface for the page: statistics, range and histogram of a quantity, heights for picking."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.surface.display_style import Form
from wafer_viewer.draw.surface.hillshade import light_gain, without_gaps
from wafer_viewer.draw.surface.texture_baking import VALUES
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.rendering.render_request import (
    CoarseHeightField,
    ColourScale,
    RenderRequest,
    SurfaceStatistics,
)
from wafer_viewer.session.rendering.surface_source import SurfaceProvider, at_level, coarse, coarse_level, levelled

_BINS = 60
_LEAST_FOR_FORM = 50


def facts(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return `SurfaceStatistics` as msgpack."""
    surface = shelf.surface(request.source)
    level = coarse_level(surface)
    part = levelled(at_level(surface, level), request.datum)
    there = np.isfinite(part.z_um)
    heights = part.z_um[there] if there.any() else np.zeros(1, np.float32)
    low, high = (float(v) for v in np.percentile(heights, [0.5, 99.5]))
    rows, cols = (_extent(np.asarray(there.any(axis=1 - axis)), surface.shape[axis], 2**level) for axis in (0, 1))
    facts = SurfaceStatistics(
        *surface.shape, surface.pixel_um, surface.x0_um, surface.y0_um, *rows, *cols,
        float(heights.min()), float(heights.max()), low, high,
        light_gain(part.z_um, part.pixel_um), _plane(part), _has_overlaps(part), _form(part),
    )  # fmt: skip
    return msgspec.msgpack.encode(facts)


def _has_overlaps(part: HeightMap) -> bool:
    return part.overlap_um is not None and bool(np.isfinite(part.overlap_um).any())


def _extent(there: NDArray[np.bool_], n: int, scale: int) -> tuple[int, int]:
    """Return the range [first, end) of the True values, in pixels of level 0."""
    hits = np.flatnonzero(there)
    return (0, n) if hits.size == 0 else (int(hits[0]) * scale, min(n, (int(hits[-1]) + 1) * scale))


def _plane(part: HeightMap) -> tuple[float, float, float]:
    """Return the robust least-squares plane, through the half of the points nearest to a first plane."""
    rows, cols = np.nonzero(np.isfinite(part.z_um))
    if rows.size < 3:
        return 0.0, 0.0, 0.0
    design = np.stack([part.x_um[cols], part.y_um[rows], np.ones(rows.size)], axis=1)
    plane = _robust_least_squares(design, part.z_um[rows, cols].astype(float))
    return float(plane[0]), float(plane[1]), float(plane[2])


def _form(part: HeightMap) -> Form:
    """Return the robust least-squares form of order 2, fitted like the plane."""
    rows, cols = np.nonzero(np.isfinite(part.z_um[::2, ::2]))
    if rows.size < _LEAST_FOR_FORM:
        return ()
    x, y, z = part.x_um[::2][cols], part.y_um[::2][rows], part.z_um[::2, ::2][rows, cols].astype(float)
    x0, y0 = (x.min() + x.max()) / 2, (y.min() + y.max()) / 2
    half = max(float(np.ptp(x)), float(np.ptp(y)), part.pixel_um) / 2
    u, v = (x - x0) / half, (y - y0) / half
    factors = _robust_least_squares(np.stack([np.ones(rows.size), u, v, u * u, u * v, v * v], axis=1), z)
    return (float(x0), float(y0), half, *factors.tolist())


def _robust_least_squares(design: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit by least squares to all points, then twice to the half of them with the smallest residuals."""
    factors = np.asarray(np.linalg.lstsq(design, z, rcond=None)[0], np.float64)
    for _ in range(2):
        distance = np.abs(z - design @ factors)
        kept = distance <= np.median(distance)
        factors = np.asarray(np.linalg.lstsq(design[kept], z[kept], rcond=None)[0], np.float64)
    return factors


def scale(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a `ColourScale` as msgpack."""
    part = coarse(shelf, request)
    quantity = request.look.colour_by
    values = VALUES[quantity](part, request.light)
    values = values[np.isfinite(values)]
    if values.size == 0:
        values = np.zeros(1, np.float32)
    own_low, p1, p99, own_high = (float(v) for v in np.percentile(values, [0.5, 1, 99, 99.5]))
    low, high = request.range_values or _usual_range(quantity, own_low, own_high)
    counts = np.histogram(values, _BINS, (low, max(high, low + 1e-9)))[0]
    shares = _origin_shares(part) if quantity == "origin" else {}
    counted = tuple(float(c) for c in counts)
    return msgspec.msgpack.encode(ColourScale(quantity, low, high, own_low, own_high, p1, p99, counted, shares))


def _usual_range(quantity: str, low: float, high: float) -> tuple[float, float]:
    """Return the default range of a quantity.

    Fractions have 0 to 1; slopes and overlaps start at 0; signed quantities are symmetric; others have 0.5 to 99.5 %.
    The ends are at least 0.2 apart.
    """
    if quantity in ("confidence", "grey"):
        return 0.0, 1.0
    if quantity == "slope":
        return 0.0, max(high, 1.0)
    if quantity == "overlap":
        return 0.0, max(high, 0.1)
    if quantity in ("deviation", "form", "difference"):
        most = max(abs(low), abs(high), 0.1)
        return -most, most
    middle, half = (low + high) / 2, max((high - low) / 2, 0.1)
    return middle - half, middle + half


def _origin_shares(part: HeightMap) -> dict[int, float]:
    counts = np.bincount(part.origin.ravel(), minlength=1)
    return {code: float(n / part.origin.size) for code, n in enumerate(counts) if n}


def relief(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a `CoarseHeightField` as msgpack."""
    part = coarse(shelf, request)
    heights, there = without_gaps(part.z_um).astype("<f4").tobytes(), np.isfinite(part.z_um).tobytes()
    return msgspec.msgpack.encode(CoarseHeightField(*part.shape, part.pixel_um, part.x0_um, part.y0_um, heights, there))
