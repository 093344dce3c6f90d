"""Statistics of the displayed surface: of all or a part of it, of the drawn points, and its histogram."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wafer_viewer.draw.surface.display_style import Form
from wafer_viewer.draw.surface.texture_baking import CODES, DRAWN, VALUES, clip_codes, light_gain, without_gaps
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import Clip, Span
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin, pixel_window
from wafer_viewer.session.core.dataset_library import unmeasured_reasons
from wafer_viewer.session.rendering.render_request import (
    Brushed,
    CoarseHeightField,
    ColourScale,
    RenderRequest,
    Statistics,
    SurfaceStatistics,
)
from wafer_viewer.session.rendering.surface_source import (
    SurfaceProvider,
    Window,
    at_level,
    coarse,
    coarse_level,
    count_refused,
    levelled,
)
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic

MOST_POINTS = 8_000_000
"""Number of points above which block means are read, because the render process has tiles to render as well."""
_STRIP_ROWS = 512
_BINS = 96
_END_PERCENT, _SPARE = 0.02, 0.03
"""Percentile at which the histogram starts, its counterpart being the end, and the margin on both sides."""
_SAMPLES = 400_000
_CODES = 32
MOST_PLACES = 200


def statistics(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return `Statistics` as msgpack. Raises MeasureError if the requested part is outside of the surface."""
    surface = provider.surface(request.source)
    rows, cols = _window(surface, request)
    n_rows, n_cols = rows.stop - rows.start, cols.stop - cols.start
    level = max(0, math.ceil(math.log2(max(1.0, n_rows * n_cols / MOST_POINTS)) / 2))
    strips = [
        levelled(at_level(surface, level, strip), request.datum) for strip in _strips(rows, cols, level, _STRIP_ROWS)
    ]
    sums = _Sums(_ends(strips), request.clip, request.brush_um)
    for strip in strips:
        sums.add(strip)
    block = 2**level
    result = Statistics(
        rows=n_rows,
        cols=n_cols,
        pixel_um=surface.pixel_um,
        n_heights=int(sums.by_code.sum()) * block**2,
        n_points=int(sums.by_code[DRAWN]) * block**2,
        left_out={why: int(sums.by_code[code]) * block**2 for why, code in CODES.items()},
        lowest_um=sums.drawn.lowest_um,
        highest_um=sums.drawn.highest_um,
        mean_um=sums.drawn.mean_um,
        spread_um=sums.drawn.spread_um,
        ends_um=sums.ends_um,
        counts=tuple(int(n) * block**2 for n in sums.counts),
        span_um=(sums.low_um, sums.high_um) if sums.by_code.any() else (0.0, 0.0),
        block_px=block,
        brushed=None if request.brush_um is None else _brushed(strips, sums, block, request.brush_um, request.clip),
        refused=count_refused(provider.fields(request.source), request) if request.refused else None,
        **_shares(sums.origins)._asdict(),
    )
    if request.box_um is None and isinstance(surface, ZarrMosaic):
        result = _with_stored_statistics(result, surface, request)
    return msgspec.msgpack.encode(result)


def _with_stored_statistics(result: Statistics, surface: ZarrMosaic, request: RenderRequest) -> Statistics:
    """Replace values by the stored statistics of all points of the mosaic, as far as they answer the request."""
    stored = surface.facts()
    result = msgspec.structs.replace(result, **_shares(stored.counts)._asdict())
    if request.datum is not None or not stored.has_heights:
        return result
    result = msgspec.structs.replace(result, span_um=(stored.lowest_um, stored.highest_um))
    if request.clip.clips:
        return result
    return msgspec.structs.replace(result, lowest_um=stored.lowest_um, highest_um=stored.highest_um)


def _window(surface: Mosaic, request: RenderRequest) -> Window:
    """Return the counted rows and columns of level 0."""
    if request.box_um is None:
        return slice(0, surface.shape[0]), slice(0, surface.shape[1])
    return pixel_window(surface, Region.rectangle(*request.box_um))


def _strips(rows: slice, cols: slice, level: int, height: int) -> Iterator[Window]:
    """Yield a window of level 0 as strips on a coarser level's lattice."""
    first, end = rows.start >> level, max((rows.start >> level) + 1, -(-rows.stop >> level))
    left, right = cols.start >> level, max((cols.start >> level) + 1, -(-cols.stop >> level))
    for row in range(first, end, height):
        yield slice(row, min(row + height, end)), slice(left, right)


def _ends(strips: list[HeightMap]) -> Span:
    """Return the range of the histogram, which contains nearly all heights."""
    step = max(1, round(math.sqrt(sum(strip.z_um.size for strip in strips) / _SAMPLES)))
    some = np.concatenate([strip.z_um[::step, ::step].ravel() for strip in strips])
    some = some[np.isfinite(some)]
    if some.size == 0:
        return 0.0, 0.0
    low, high = (float(v) for v in np.percentile(some, [_END_PERCENT, 100 - _END_PERCENT]))
    spare = max(_SPARE * (high - low), 1e-3)
    return low - spare, high + spare


@dataclass(slots=True)
class _Moments:
    """Moments of some heights: count, sums of the heights and their squares about `about_um`, minimum and maximum."""

    about_um: float
    n: int = 0
    total: float = 0.0
    squares: float = 0.0
    low: float = math.inf
    high: float = -math.inf

    def add(self, z_um: NDArray[np.float32]) -> None:
        """Add heights, none of them NaN."""
        if z_um.size:
            away = z_um.astype(np.float64) - self.about_um
            self.n += z_um.size
            self.total += float(away.sum())
            self.squares += float(away @ away)
            self.low, self.high = min(self.low, float(z_um.min())), max(self.high, float(z_um.max()))

    @property
    def lowest_um(self) -> float | None:
        return self.low if self.n else None

    @property
    def highest_um(self) -> float | None:
        return self.high if self.n else None

    @property
    def mean_um(self) -> float | None:
        return self.about_um + self.total / self.n if self.n else None

    @property
    def spread_um(self) -> float | None:
        return math.sqrt(max(0.0, self.squares - self.total**2 / self.n) / (self.n - 1)) if self.n > 1 else None


@dataclass(slots=True)
class _Sums:
    """Sums over strips of a surface."""

    ends_um: Span
    clip: Clip
    brush_um: Span | None
    origins: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_CODES, np.int64))
    by_code: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(CODES) + 1, np.int64))
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_BINS, np.int64))
    low_um: float = math.inf
    high_um: float = -math.inf
    drawn: _Moments = field(init=False)
    brushed: _Moments = field(init=False)

    def __post_init__(self) -> None:
        middle = sum(self.ends_um) / 2
        self.drawn, self.brushed = _Moments(middle), _Moments(middle)

    def add(self, strip: HeightMap) -> None:
        """Add a strip."""
        measured = np.isfinite(strip.z_um)
        codes = clip_codes(strip, self.clip)[measured]
        z = strip.z_um[measured]
        self.origins += np.bincount(strip.origin.ravel(), minlength=_CODES)[:_CODES]
        self.by_code += np.bincount(codes, minlength=len(CODES) + 1)
        if self.ends_um[1] > self.ends_um[0]:
            self.counts += np.histogram(np.clip(z, *self.ends_um), _BINS, self.ends_um)[0]
        if z.size:
            self.low_um, self.high_um = min(self.low_um, float(z.min())), max(self.high_um, float(z.max()))
        z = z[codes == DRAWN]
        self.drawn.add(z)
        if self.brush_um is not None:
            self.brushed.add(z[(z >= self.brush_um[0]) & (z <= self.brush_um[1])])


def _brushed(strips: list[HeightMap], sums: _Sums, block: int, brush_um: Span, clip: Clip) -> Brushed:
    mask = np.concatenate([
        (strip.z_um >= brush_um[0]) & (strip.z_um <= brush_um[1]) & (clip_codes(strip, clip) == DRAWN)
        for strip in strips
    ])  # fmt: skip
    labels = np.empty(mask.shape, np.int32)
    n_places = int(np.asarray(ndimage.label(mask, np.ones((3, 3), int), labels)))
    sizes = np.bincount(labels.ravel(), minlength=n_places + 1)[1:]
    boxes = ndimage.find_objects(labels)
    largest = np.argsort(-sizes, kind="stable")[:MOST_PLACES]
    lattice = strips[0]
    return Brushed(
        n_points=sums.brushed.n * block**2,
        fraction=sums.brushed.n / max(1, sums.drawn.n),
        mean_um=sums.brushed.mean_um,
        spread_um=sums.brushed.spread_um,
        n_places=n_places,
        places=tuple(_box_um(lattice, *boxes[k]) for k in largest.tolist()),
    )


def _box_um(lattice: HeightMap, rows: slice, cols: slice) -> tuple[float, float, float, float]:
    """Return the stage rectangle of some pixels, edge to edge."""
    pixel, half = lattice.pixel_um, lattice.pixel_um / 2
    x, y = lattice.x0_um, lattice.y0_um
    low, high = y - (rows.stop - 1) * pixel - half, y - rows.start * pixel + half
    return x + cols.start * pixel - half, low, x + (cols.stop - 1) * pixel + half, high


class _Shares(NamedTuple):
    """Fractions of the points covered by fields, by origin."""

    measured_fraction: float
    filled_fraction: float
    unmeasured: tuple[tuple[str, float], ...]


def _shares(counts: NDArray[np.int64]) -> _Shares:
    covered = max(1, int(counts.sum() - counts[Origin.NOT_COVERED]))
    measured, filled = (float(counts[origin]) / covered for origin in (Origin.MEASURED, Origin.FILLED))
    return _Shares(measured, filled, unmeasured_reasons(counts, covered))


_SUMMARY_BINS = 60
_LEAST_FOR_FORM = 50
_PATCHES, _PATCH_PX = 5, 256
"""Patches along each axis of a surface, and their size, from which probabilities are counted."""


def facts(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return `SurfaceStatistics` as msgpack."""
    surface = provider.surface(request.source)
    level = coarse_level(surface)
    part = levelled(at_level(surface, level), request.datum)
    measured = np.isfinite(part.z_um)
    heights = part.z_um[measured] if measured.any() else np.zeros(1, np.float32)
    low, high = (float(v) for v in np.percentile(heights, [0.5, 99.5]))
    rows, cols = (_extent(np.asarray(measured.any(axis=1 - axis)), surface.shape[axis], 2**level) for axis in (0, 1))
    facts = SurfaceStatistics(
        *surface.shape, surface.pixel_um, surface.x0_um, surface.y0_um, *rows, *cols,
        float(heights.min()), float(heights.max()), low, high,
        light_gain(part.z_um, part.pixel_um), _plane(part), _has(part.overlap_um), _form(part), _has(part.u_um),
        _by_probability(surface),
    )  # fmt: skip
    return msgspec.msgpack.encode(facts)


def _by_probability(surface: Mosaic) -> tuple[int, ...]:
    """Return the number of covered pixels by the probability of their heights, in patches spread over the surface."""
    recipe = surface.provenance.recipe
    if recipe.least_probability == "auto" or not recipe.weighs_evidence:  # auto: of no heights that were weighed
        return ()
    counts = np.zeros(100, np.int64)
    for rows, cols in product(*map(_patches, surface.shape)):
        x_um = [surface.x0_um + col * surface.pixel_um for col in (cols.start, cols.stop - 1)]
        y_um = [surface.y0_um - row * surface.pixel_um for row in (rows.stop - 1, rows.start)]
        part = surface.window(Region.rectangle(x_um[0], y_um[0], x_um[1], y_um[1]))
        probable = part.confidence[part.origin != Origin.NOT_COVERED]
        counts += np.bincount(np.clip(100 * probable, 0, 99).astype(np.intp), minlength=100)
    return tuple(counts.tolist())


def _patches(n: int) -> list[slice]:
    """Return ranges of pixels spread over an axis."""
    ends = [n * k // _PATCHES for k in range(_PATCHES + 1)]
    return [slice(low, min(high, low + _PATCH_PX)) for low, high in pairwise(ends) if high > low]


def _has(layer: NDArray[np.float32] | None) -> bool:
    return layer is not None and bool(np.isfinite(layer).any())


def _extent(measured: NDArray[np.bool_], n: int, scale: int) -> tuple[int, int]:
    """Return the range [first, end) of the True values, in pixels of level 0."""
    hits = np.flatnonzero(measured)
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
        inliers = distance <= np.median(distance)
        factors = np.asarray(np.linalg.lstsq(design[inliers], z[inliers], rcond=None)[0], np.float64)
    return factors


def scale(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a `ColourScale` as msgpack."""
    part = coarse(provider, request)
    quantity = request.look.colour_by
    values = VALUES[quantity](part, request.light)
    values = values[np.isfinite(values)]
    if values.size == 0:
        values = np.zeros(1, np.float32)
    own_low, p1, p99, own_high = (float(v) for v in np.percentile(values, [0.5, 1, 99, 99.5]))
    low, high = request.range_values or _usual_range(quantity, own_low, own_high)
    counts = np.histogram(values, _SUMMARY_BINS, (low, max(high, low + 1e-9)))[0]
    shares = _origin_shares(part) if quantity == "origin" else {}
    counted = tuple(float(c) for c in counts)
    return msgspec.msgpack.encode(ColourScale(quantity, low, high, own_low, own_high, p1, p99, counted, shares))


def _usual_range(quantity: str, low: float, high: float) -> tuple[float, float]:
    """Return the default range of a quantity.

    Fractions have 0 to 1; slopes, overlaps and uncertainties start at 0; signed quantities are symmetric; others have
    0.5 to 99.5 %. The ends are at least 0.2 apart.
    """
    if quantity in ("confidence", "grey"):
        return 0.0, 1.0
    if quantity == "slope":
        return 0.0, max(high, 1.0)
    if quantity in ("overlap", "uncertainty"):
        return 0.0, max(high, 0.1)
    if quantity in ("deviation", "form", "difference"):
        most = max(abs(low), abs(high), 0.1)
        return -most, most
    middle, half = (low + high) / 2, max((high - low) / 2, 0.1)
    return middle - half, middle + half


def _origin_shares(part: HeightMap) -> dict[int, float]:
    counts = np.bincount(part.origin.ravel(), minlength=1)
    return {code: float(n / part.origin.size) for code, n in enumerate(counts) if n}


def relief(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a `CoarseHeightField` as msgpack."""
    part = coarse(provider, request)
    heights, measured = without_gaps(part.z_um).astype("<f4").tobytes(), np.isfinite(part.z_um).tobytes()
    return msgspec.msgpack.encode(
        CoarseHeightField(*part.shape, part.pixel_um, part.x0_um, part.y0_um, heights, measured)
    )
