"""Search lines in the all-in-focus image, straight edges across them, and their subpixel positions.

The filter across an edge is the derivative of a Gaussian. Its response to a step blurred by a Gaussian is itself a
Gaussian, whose logarithm is a parabola: three values determine it, and its vertex is the edge.

All slopes of an edge up to a limit are tried: along an edge's own slope the responses of all lines add up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats, level_for, require_area
from wafer_viewer.measure.base.measurement_context import Lines, MeasurementContext
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

LEAST_PX = 16
"""Smallest region in pixels each way; the edge filter extends six pixels."""
LEAST_COVERED = 0.5
"""Smallest fraction of a region covered by the image, for a representative result."""
Way = tuple[float, float]
"""x, y in um."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchStrip:
    """Grey values along search lines, float32 [line, place], and mask of covered pixels, bool [line, place].

    A pixel lies at `corner_um` + line * `line_um` + place * `place_um`, each (x, y) in stage um.
    """

    grey: NDArray[np.float32]
    covered: NDArray[np.bool_]
    corner_um: Way
    line_um: Way
    place_um: Way

    @classmethod
    def of(cls, grey: NDArray[np.generic], pixel_um: float, x0_um: float, y0_um: float) -> SearchStrip:
        """Return a strip of a complete image [row, col]; search lines run along x."""
        covered = np.ones(grey.shape, bool)
        return cls(grey.astype(np.float32), covered, (x0_um, y0_um), (0.0, -pixel_um), (pixel_um, 0.0))

    @property
    def pixel_um(self) -> float:
        """Pixel pitch along the search lines."""
        return float(np.hypot(*self.place_um))

    @property
    def turned(self) -> SearchStrip:
        """The same strip with its search lines transposed."""
        return SearchStrip(self.grey.T, self.covered.T, self.corner_um, self.place_um, self.line_um)

    @property
    def reversed(self) -> SearchStrip:
        """The same strip with the direction of its search lines reversed."""
        last = self.grey.shape[1] - 1
        corner = self.corner_um[0] + last * self.place_um[0], self.corner_um[1] + last * self.place_um[1]
        back = -self.place_um[0], -self.place_um[1]
        return SearchStrip(self.grey[:, ::-1], self.covered[:, ::-1], corner, self.line_um, back)

    def part(self, lines: slice, places: slice) -> SearchStrip:
        """Return some lines and places of it, as views; slices need a start and a step of one."""
        x, y = self.at(np.array(float(lines.start or 0)), np.array(float(places.start or 0)))
        grey, covered = self.grey[lines, places], self.covered[lines, places]
        return SearchStrip(grey, covered, (float(x), float(y)), self.line_um, self.place_um)

    def at(self, line: Floats, place: Floats) -> tuple[Floats, Floats]:
        """Return stage x and y of lines and places, which may be fractional."""
        (x, y), (lx, ly), (px, py) = self.corner_um, self.line_um, self.place_um
        return x + line * lx + place * px, y + line * ly + place * py

    def where(self, x_um: Floats, y_um: Floats) -> tuple[Floats, Floats]:
        """Return lines and places of stage x and y: the inverse of `at`."""
        x, y = x_um - self.corner_um[0], y_um - self.corner_um[1]
        square = self.pixel_um**2
        line, place = ((x * axis[0] + y * axis[1]) / square for axis in (self.line_um, self.place_um))
        return line, place


def read_strip(surface: Mosaic, region: Region, what: str) -> tuple[SearchStrip, int]:
    """Return the image of a region, with search lines along x, and the level it was read at.

    what: words of the error message, as in 'and a kerf width needs'. Raises MeasureError when the region has no area,
    lies outside, is smaller than 16 pixels either way, or has less than half of its area covered by the image.
    """
    require_area(region, "measured")
    level = level_for(surface, region)
    part = surface.window(region, level)
    _require_size(region, part, what)
    strip = strip_of(part)
    covered = np.count_nonzero(strip.covered) * part.pixel_um**2
    x0, y0, x1, y1 = region.bounds_um
    share = covered / ((x1 - x0) * (y1 - y0))
    if share < LEAST_COVERED:
        raise MeasureError(
            f"Only {100 * share:.0f} % of the region lies on the picture and {what} needs {100 * LEAST_COVERED:.0f} %: "
            "move it to where fields were taken."
        )
    return strip, level


def strip_of(part: HeightMap) -> SearchStrip:
    """Return the image of a height map, without pixels that no field covers."""
    image = SearchStrip.of(part.all_in_focus, part.pixel_um, part.x0_um, part.y0_um)
    covered = part.origin != Origin.NOT_COVERED
    return SearchStrip(image.grey, covered, image.corner_um, image.line_um, image.place_um)


def require_rectangle(region: Region, what: str) -> None:
    """Raise MeasureError for another kind of region. what: as in 'A kerf width'."""
    if region.kind != "rectangle":
        raise MeasureError(f"{what} is measured in a rectangle, this region is a {region.kind}: draw a rectangle.")
    if region.excluded:
        raise MeasureError(f"{what} is measured in a whole rectangle, and this one has parts left out: leave none.")


def _require_size(region: Region, part: HeightMap, what: str) -> None:
    x0, y0, x1, y1 = region.bounds_um
    sides = (x1 - x0) / part.pixel_um, (y1 - y0) / part.pixel_um
    if min(sides) < LEAST_PX or min(part.shape) < LEAST_PX:
        raise MeasureError(
            f"The region is {sides[0]:.0f} x {sides[1]:.0f} pixels large and {what} needs at least "
            f"{LEAST_PX} x {LEAST_PX} on the surface: draw it larger."
        )


@dataclass(frozen=True, slots=True)
class EdgeFilterParameters:
    """Scales of the filter across an edge, the derivative of a Gaussian.

    Parameters
    ----------
    sigma_px : float, px
        Standard deviation of the Gaussian for the places of edges.
    search_sigma_px : float, px
        Standard deviation for edge detection, where thin lines must count less than ragged edges of large
        areas.
    truncate_sigmas : float
        Half length of the filter, in its standard deviations.
    reach_sigmas : float
        Distance from a missing pixel, in standard deviations of the filter, within which there are no edges.
    reach_px : int, px
        Width about the expected place of an edge in which its typical steepness is taken; half of it is left
        out at both ends of a search line.
    as_steep : float
        Smallest steepness of an edge point relative to the typical steepness of the edge.
    most_apart_px : int, px
        Largest distance between the values that determine the parabola of an edge.

    Notes
    -----
    `tests/bench/bench_shape.py` measures the errors of edges, and the coverage of their uncertainties, with these
    values.
    """

    sigma_px: float = 2.0
    search_sigma_px: float = 4.0
    truncate_sigmas: float = 4.0
    reach_sigmas: float = 3.0
    reach_px: int = 6
    as_steep: float = 0.5
    most_apart_px: int = 4


EDGE_FILTER = EdgeFilterParameters()
U_SUBPIXEL_PX = 0.002
"""Standard uncertainty (k = 1) of an edge due to its subpixel position, on steps blurred by 0.7 px or more.

`tests/measure/edges/test_subpixel_edges.py` searches for a larger one.
"""
Responses = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """Points of an edge, in line and place coordinates of a strip, float64 [n]."""

    line: Floats
    place: Floats

    def __len__(self) -> int:
        return len(self.line)


def responses(
    grey: NDArray[np.floating], covered: NDArray[np.bool_] | None = None, sigma_px: float = EDGE_FILTER.sigma_px
) -> Responses:
    """Return the gradient along search lines, [line, place], grey values per pixel; 0 near missing pixels."""
    found: Responses = np.zeros(grey.shape, np.float32)
    gaussian_filter1d(
        grey.astype(np.float32),
        sigma_px,
        axis=1,
        order=1,
        output=found,
        mode="nearest",
        truncate=EDGE_FILTER.truncate_sigmas,
    )
    if covered is not None and not covered.all():
        near_missing: NDArray[np.bool_] = np.empty(covered.shape, bool)
        maximum_filter1d(~covered, 2 * round(EDGE_FILTER.reach_sigmas * sigma_px) + 1, axis=1, output=near_missing)
        found[near_missing] = 0.0
    found[:, : EDGE_FILTER.reach_px // 2] = found[:, -(EDGE_FILTER.reach_px // 2) :] = 0.0
    return found


def peaks(rising: Responses) -> NDArray[np.bool_]:
    """Return the mask of local maxima along search lines, [line, place]."""
    found = np.zeros(rising.shape, bool)
    middle = rising[:, 1:-1]
    found[:, 1:-1] = (middle > 0) & (middle > rising[:, :-2]) & (middle >= rising[:, 2:])
    return found


def between_pixels(rising: Responses, line: NDArray[np.intp], place: NDArray[np.intp]) -> Floats:
    """Return the subpixel places of the peaks of one edge, float64 [n].

    For wider edges, the values that determine the parabola are further apart, which reduces the effect of noise.
    """
    apart = _apart(rising, line, place)
    before, top, after = _logarithms(rising, line, place, apart)
    bend = before - 2 * top + after
    moved = np.where(bend < 0, 0.5 * apart * (before - after) / np.where(bend < 0, bend, 1.0), 0.0)
    return place.astype(np.float64) + np.clip(moved, -1.0, 1.0)


def _apart(rising: Responses, line: NDArray[np.intp], place: NDArray[np.intp]) -> int:
    """Return approximately the standard deviation of the response, in integer pixels."""
    if not len(line):
        return 1
    before, top, after = (float(np.median(values)) for values in _logarithms(rising, line, place, 1))
    bend = 2 * top - before - after
    return int(np.clip(round(bend**-0.5), 1, EDGE_FILTER.most_apart_px)) if bend > 0 else EDGE_FILTER.most_apart_px


def _logarithms(rising: Responses, line: NDArray[np.intp], place: NDArray[np.intp], apart: int) -> tuple[Floats, ...]:
    last = rising.shape[1] - 1
    values = (rising[line, np.clip(place + k, 0, last)] for k in (-apart, 0, apart))
    return tuple(np.log(np.maximum(value, 1e-6).astype(np.float64)) for value in values)


def edges_near(
    rising: Responses, expected: Floats, reach: tuple[float, float], choose: Literal["nearest", "steepest"] = "steepest"
) -> EdgePoints:
    """Return one sufficiently steep edge point per line, near its expected place.

    expected: a place on each line; reach: search distance before and behind it. Lines without an edge are left out.
    """
    place = np.arange(rising.shape[1])[None, :]
    away = place - expected[:, None]
    good = peaks(rising) & (away >= -reach[0]) & (away <= reach[1])
    good &= rising >= EDGE_FILTER.as_steep * typical(rising, expected)
    worth = np.where(good, -np.abs(away) if choose == "nearest" else rising, -np.inf)
    best = np.argmax(worth, axis=1)
    line = np.flatnonzero(np.isfinite(worth[np.arange(len(best)), best]))
    return EdgePoints(line.astype(np.float64), between_pixels(rising, line, best[line]))


def typical(rising: Responses, expected: Floats) -> float:
    """Return the steepness of an edge near its expected place: median over the lines."""
    near = (
        np.round(expected).astype(np.intp)[:, None]
        + np.arange(-EDGE_FILTER.reach_px // 2, EDGE_FILTER.reach_px // 2 + 1)[None, :]
    )
    inside = np.clip(near, 0, rising.shape[1] - 1)
    return max(float(np.median(np.take_along_axis(rising, inside, axis=1).max(axis=1))), 1e-6)


@dataclass(frozen=True, slots=True)
class StraightEdgeParameters:
    """Limits of the search for a straight edge over all slopes.

    Parameters
    ----------
    most_slope : float, px per line
        Largest slope of an edge against the normal of the search lines: 6.8 degrees.
    slope_step_px : float, px
        Step between trial slopes: largest displacement of an edge's ends relative to its centre.
    bands : int
        Largest number of bands to which search lines are averaged before slopes are tried.
    stands_out : float
        Smallest prominence of an edge, in robust deviations of all places.
    least_steep : float, grey values per px
        Smallest gradient of an edge.
    least_rest : int
        Smallest number of places for the noise estimate.
    least_score : float
        Fraction of an edge's mean steepness required in a band.
    all_along : float
        Fraction of the bands that must reach it.
    half_level : float
        Fraction of its maximum that bounds a peak.
    margin_px : int, px
        Smallest half-width of a peak.

    Notes
    -----
    `tests/bench/bench_shape.py` measures the errors of edges, and the coverage of their uncertainties, with these
    values.
    """

    most_slope: float = 0.12
    slope_step_px: float = 4.0
    bands: int = 64
    stands_out: float = 5.0
    least_steep: float = 0.05
    least_rest: int = 16
    least_score: float = 0.4
    all_along: float = 0.8
    half_level: float = 0.5
    margin_px: int = 10


STRAIGHT_EDGE = StraightEdgeParameters()
Sign = Literal[-1, 1]
"""1: from dark to bright along the search lines."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeScores:
    """Steepness of a straight edge at each place of the middle line: best over all slopes, [place], and that slope.

    bands: means of neighbouring lines, [band, place]; middles: offsets of their centres from the middle line.
    """

    best: Floats
    slope: Floats
    n_lines: int
    bands: Responses
    middles: Floats

    def expected(self, place: int) -> Floats:
        """Return the crossings of each line with the edge through a place of the middle line."""
        line = np.arange(self.n_lines, dtype=np.float64)
        return place + float(self.slope[place]) * (line - (self.n_lines - 1) / 2)

    def top(self) -> int:
        """Return the place of the strongest edge."""
        return int(np.argmax(self.best))

    def first(self, share: float) -> int:
        """Return the place of the first edge with this fraction of the strongest."""
        strong = self.best >= share * float(self.best.max())
        start = int(np.argmax(strong))
        weak = np.flatnonzero(~strong[start:])
        return start + int(np.argmax(self.best[start : start + int(weak[0]) if len(weak) else None]))

    def strongest_other(self, place: int, after: int = 0, up_to: int | None = None) -> float:
        """Return the strength of the strongest other edge, or of that between two places."""
        low, high = self._extent(place)
        return max(float(part.max(initial=0.0)) for part in (self.best[after:low], self.best[high:up_to]))

    def stands_out(self, place: int, only_before: bool = False) -> bool:
        """Return whether an edge is continuous and exceeds the noise of places well apart from it.

        only_before: noise from the places before it only, where those after it are patterned.
        """
        if not self._all_along(place):
            return False
        low, high = self._extent(place)
        wide = high - low
        behind = self.best[:0] if only_before else self.best[high + wide :]
        rest = np.concatenate([self.best[: max(0, low - wide)], behind])
        if len(rest) < STRAIGHT_EDGE.least_rest:
            return bool(self.best[place] > STRAIGHT_EDGE.least_steep)
        middle = float(np.median(rest))
        spread = MAD_TO_SIGMA * float(np.median(np.abs(rest - middle)))
        return bool(self.best[place] > max(middle + STRAIGHT_EDGE.stands_out * spread, STRAIGHT_EDGE.least_steep))

    def _all_along(self, place: int) -> bool:
        """Return whether an edge is present in most bands; chance alignments of noise are not."""
        bins = np.round(place + float(self.slope[place]) * self.middles).astype(np.intp)
        scores = self.bands[np.arange(len(bins)), np.clip(bins, 0, self.bands.shape[1] - 1)]
        return bool(np.mean(scores > STRAIGHT_EDGE.least_score * self.best[place]) >= STRAIGHT_EDGE.all_along)

    def _extent(self, place: int) -> tuple[int, int]:
        """Return the first place of a peak and the first after it; at least the width of the filter response."""
        below = self.best < STRAIGHT_EDGE.half_level * self.best[place]
        low, high = np.flatnonzero(below[:place]), np.flatnonzero(below[place:])
        first = int(low[-1]) + 1 if len(low) else 0
        last = place + int(high[0]) if len(high) else len(self.best)
        return max(0, min(first, place - STRAIGHT_EDGE.margin_px)), max(last, place + STRAIGHT_EDGE.margin_px + 1)


def scores_of(strip: SearchStrip, sign: Sign) -> EdgeScores:
    """Return the strength of a straight edge of a sign at every place of the middle line, over all slopes."""
    middles, bands = _bands(responses(strip.grey, strip.covered, EDGE_FILTER.search_sigma_px), sign)
    n_lines = len(strip.grey)
    slopes = np.linspace(
        -STRAIGHT_EDGE.most_slope,
        STRAIGHT_EDGE.most_slope,
        2 * math.ceil(STRAIGHT_EDGE.most_slope * n_lines / STRAIGHT_EDGE.slope_step_px / 2) + 1,
    )
    found = np.stack([_along(bands, np.round(slope * middles).astype(np.intp)) for slope in slopes])
    which = np.argmax(found, axis=0)
    return EdgeScores(
        found[which, np.arange(found.shape[1])].astype(np.float64), slopes[which], n_lines, bands, middles
    )


def _bands(response: Responses, sign: Sign) -> tuple[Floats, Responses]:
    """Return the means of neighbouring lines, and the offsets of their centres from the middle line."""
    cuts = np.linspace(0, len(response), min(STRAIGHT_EDGE.bands, len(response)) + 1).astype(np.intp)
    sums = np.add.reduceat(response, cuts[:-1], axis=0)
    middles = (cuts[:-1] + cuts[1:] - 1) / 2 - (len(response) - 1) / 2
    return middles, (sign * sums / np.diff(cuts)[:, None]).astype(np.float32)


def _along(bands: Responses, shifts: NDArray[np.intp]) -> Floats:
    """Return the mean over the bands, each shifted back; places outside count as zero."""
    width = bands.shape[1]
    place = np.arange(width)[None, :] + shifts[:, None]
    found = np.take_along_axis(bands, np.clip(place, 0, width - 1), axis=1)
    return np.where((place >= 0) & (place < width), found, 0.0).mean(axis=0)


NOT_IN_BUDGET = (
    "Not in the budget: where light and focus put an edge on the picture, {distortion}positions of fields against each "
    "other, repeat scans, temperature other than 20 °C."
)
DISTORTION = "distortion and shear of the picture, "
ON_PICTURE = "Measured on the picture that is in focus everywhere."


def notes(reading: MeasurementContext, *more: str) -> tuple[str, ...]:
    """Return the notes of an image measurement; those on budgets only if calibrated."""
    if not reading.calibrated:
        return (ON_PICTURE, *more)
    return (ON_PICTURE, *more, NOT_IN_BUDGET.format(distortion=DISTORTION if reading.u_mapping_um is None else ""))


def between_edges(
    reading: MeasurementContext, value_um: float, pixel_um: float, scatter_um: float | Scatter | None, n_edges: int = 2
) -> Length:
    """Return a length between edges. scatter_um: uncertainty from edge points; None: unknown."""
    if scatter_um is None:
        return reading.length(value_um, None)
    lines: Lines = {
        **reading.lateral_lines(value_um),
        "scatter of the edge points": scatter_um,
        "place between two pixels": math.sqrt(n_edges) * U_SUBPIXEL_PX * pixel_um,
    }
    return reading.length(value_um, lines)


def angle(reading: MeasurementContext, value_deg: float, scatter_deg: Scatter | None) -> Quantity:
    """Return an angle between edges. scatter_deg: uncertainty from edge points; None: unknown."""
    lines: Lines | None = None if scatter_deg is None else {"scatter of the edge points": scatter_deg}
    return reading.quantity(value_deg, "deg", lines)


def sum_of_independent(*parts: Scatter | None) -> Scatter | None:
    """Return the uncertainty of a sum of independent parts; None where one is unknown."""
    known = [part for part in parts if part is not None]
    return Scatter.joined(*known) if len(known) == len(parts) else None
