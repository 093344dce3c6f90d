"""Diameter, position and roundness of a circular edge in the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, median_filter

from wafer_viewer.measure.base.correlated_errors import Scatter, chain_uncertainty
from wafer_viewer.measure.base.height_samples import Floats, Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.robust_fit import robust_fit
from wafer_viewer.measure.edges.edge_search import (
    STRAIGHT_EDGE,
    Responses,
    SearchStrip,
    Sign,
    between_edges,
    between_pixels,
    edges_near,
    notes,
    peaks,
    read_strip,
    responses,
)
from wafer_viewer.measure.edges.straight_edges import AS_STRONG, require_found
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import CircleSize
from wafer_viewer.model.measurement.tool_options import CircleOptions
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.height_map import Mosaic

# ------------------------------------------------------------------------------------------------------- circular edges


@dataclass(frozen=True, slots=True)
class CircleSearchParameters:
    """Limits of the search for a circular edge.

    Parameters
    ----------
    smallest : float
        Smallest radius searched, relative to the drawn circle.
    smallest_px : float, px
        Smallest radius searched.
    largest : float
        Distance from the centre of the drawn circle, in its radii, within which a detected circle lies.
    rays : tuple[int, int]
        Smallest and largest number of rays; half of the smallest is the smallest number of candidates.
    covered : float
        Fraction of the image at a place on a ray from which the place counts as covered.
    per_ray : int
        Number of edge candidates per ray, the steepest ones.
    draws : int
        Number of random three-point circles.
    near_px : float, px
        Distance from a circle within which a candidate supports it.
    seed : int
        Seed of the random circles, fixed so that the same image gives the same circle.
    margin_px : float, px
        Points closer to the detected circle than this support no other circle.
    elsewhere : float
        Distance from the detected circle beyond which a place on a ray is elsewhere, in `margin_px`.
    over_rest : float
        Smallest ratio of the steepness of a circular edge to that elsewhere on the rays.
    bands : int
        Number of angular bands in which the edge is looked for.
    near_steps : int, px
        Distance from the circle along a ray within which the edge is looked for.
    jumps_px : float, px
        Largest median jump of an edge from one ray to the next.
    reach_px : float, px
        Distance from the detected circle within which the edge is followed.
    room_px : int, px
        Extent of the rays to both sides of it.
    neighbours : int
        Number of neighbouring rays of the median filter for roundness.
    most_rounds : int
        Largest number of steps of the circle fit.

    Notes
    -----
    `tests/bench/bench_shape.py` measures the errors of edges, and the coverage of their uncertainties, with these
    values.
    """

    smallest: float = 0.25
    smallest_px: float = 8.0
    largest: float = 1.1
    rays: tuple[int, int] = (64, 720)
    covered: float = 0.99
    per_ray: int = 3
    draws: int = 600
    near_px: float = 1.5
    seed: int = 1
    margin_px: float = 4.0
    elsewhere: float = 1.5
    over_rest: float = 1.25
    bands: int = 24
    near_steps: int = 3
    jumps_px: float = 0.7
    reach_px: float = 6.0
    room_px: int = 14
    neighbours: int = 5
    most_rounds: int = 20


CIRCLE_SEARCH = CircleSearchParameters()


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A circle in line and place coordinates of a strip."""

    line: float
    place: float
    radius: float

    def off(self, line: Floats, place: Floats) -> Floats:
        """Return the signed distance of points outside the circle."""
        return np.hypot(line - self.line, place - self.place) - self.radius


@dataclass(frozen=True, slots=True, eq=False)
class RoundEdge:
    """A circle through the points of a circular edge, in stage um, and their ordered radial residuals.

    sign: 1 where it is brighter outside; inliers: mask of the accepted points.
    """

    x_um: float
    y_um: float
    radius_um: float
    sign: Sign
    angle: Floats
    off_um: Floats
    inliers: NDArray[np.bool_]

    @property
    def u_radius_um(self) -> Scatter | None:
        """Uncertainty of the radius from the scatter of the points; None with too few."""
        angle = self.angle[self.inliers]
        design = np.stack([np.cos(angle), np.sin(angle), np.ones(len(angle))], axis=1)
        return chain_uncertainty(design, self.off_um[self.inliers], np.array([0.0, 0.0, 1.0]))

    @property
    def roundness_um(self) -> float:
        """Peak-to-valley radial deviation, of medians of neighbours."""
        return float(np.ptp(median_filter(self.off_um, CIRCLE_SEARCH.neighbours, mode="wrap")))


def find_circle(
    strip: SearchStrip, x_um: float, y_um: float, radius_um: float, signs: tuple[Sign, ...] = (1, -1)
) -> RoundEdge:
    """Find the circular edge within a circle drawn around it.

    Raises MeasureError where none stands out, another is about as strong, or too few rays detect it.
    """
    line, place = (float(v) for v in strip.where(np.array(x_um), np.array(y_um)))
    drawn = Ring(line, place, radius_um / strip.pixel_um)
    rays = _Rays.over(strip, drawn, max(CIRCLE_SEARCH.smallest * drawn.radius, 2.0), drawn.radius)
    found = sorted((_consensus(rays, drawn, sign) for sign in signs), key=lambda c: -c.score)
    best = found[0]
    _require_clear(rays, best, max(best.rival, *(c.score for c in found[1:]), 0.0))
    return _fitted(strip, best.ring, best.sign)


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Outward gradients of grey values along rays, [ray, step], with the ray geometry."""

    center: Ring
    angle: Floats
    first: float
    response: Responses

    @classmethod
    def over(cls, strip: SearchStrip, center: Ring, first: float, last: float) -> _Rays:
        """Return rays a pixel apart on the circle, from one radius to another."""
        n = int(np.clip(2 * math.pi * last, *CIRCLE_SEARCH.rays))
        angle = np.arange(n, dtype=np.float64) * (2 * math.pi / n)
        radius = np.arange(first, last + 1)
        line, place = _polar(center, angle[:, None], radius[None, :])
        samples = np.stack([line, place])
        grey = map_coordinates(strip.grey, samples, order=3, mode="nearest")
        covered = (
            map_coordinates(strip.covered.astype(np.float32), samples, order=1, mode="constant") > CIRCLE_SEARCH.covered
        )
        return cls(center, angle, first, responses(grey, covered))

    def elsewhere(self, ring: Ring) -> float:
        """Return the root mean square gradient away from a circle; 0 where there is none."""
        step = np.arange(self.response.shape[1], dtype=np.float64)
        off = ring.off(*_polar(self.center, self.angle[:, None], self.first + step[None, :]))
        apart = np.abs(off) > CIRCLE_SEARCH.elsewhere * CIRCLE_SEARCH.margin_px
        return float(np.sqrt(np.mean(self.response[apart].astype(np.float64) ** 2))) if apart.any() else 0.0

    def points(self, ray: NDArray[np.intp], step: Floats) -> tuple[Floats, Floats]:
        """Return line and place coordinates of steps along rays."""
        return _polar(self.center, self.angle[ray], self.first + step)


def _polar(center: Ring, angle: Floats, radius: Floats) -> tuple[Floats, Floats]:
    return center.line - radius * np.sin(angle), center.place + radius * np.cos(angle)


@dataclass(frozen=True, slots=True, eq=False)
class _Consensus:
    """The circle with the best support, its mean steepness over all rays, and that of the next best."""

    ring: Ring
    sign: Sign
    score: float
    rival: float


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Edge candidates: ray, position and steepness, each [n]."""

    ray: NDArray[np.intp]
    line: Floats
    place: Floats
    steep: Floats

    def select(self, mask: NDArray[np.bool_]) -> _Candidates:
        return _Candidates(self.ray[mask], self.line[mask], self.place[mask], self.steep[mask])


def _consensus(rays: _Rays, drawn: Ring, sign: Sign) -> _Consensus:
    found = _candidates(rays, sign)
    ring, score = _best_ring(found, drawn, len(rays.angle))
    if ring is None:
        return _Consensus(drawn, sign, 0.0, 0.0)
    others = found.select(np.abs(ring.off(found.line, found.place)) > CIRCLE_SEARCH.margin_px)
    return _Consensus(ring, sign, score, _best_ring(others, drawn, len(rays.angle))[1])


def _candidates(rays: _Rays, sign: Sign) -> _Candidates:
    rising = sign * rays.response
    worth = np.where(peaks(rising), rising, 0.0)
    step = np.argsort(-worth, axis=1)[:, : CIRCLE_SEARCH.per_ray].ravel()
    ray = np.repeat(np.arange(len(rising)), CIRCLE_SEARCH.per_ray)[: len(step)]
    some = worth[ray, step] > STRAIGHT_EDGE.least_steep
    ray, step = ray[some], step[some]
    return _Candidates(ray, *rays.points(ray, between_pixels(rising, ray, step)), worth[ray, step].astype(np.float64))


def _best_ring(found: _Candidates, drawn: Ring, n_rays: int) -> tuple[Ring | None, float]:
    """Return the random three-point circle with the best support, within the drawn circle."""
    if len(found.ray) < CIRCLE_SEARCH.rays[0] // 2:
        return None, 0.0
    rings = _through_three(found, drawn)
    scores = [_support(found, ring, n_rays) for ring in rings]
    if not scores:
        return None, 0.0
    best = int(np.argmax(scores))
    return rings[best], scores[best]


def _through_three(found: _Candidates, drawn: Ring) -> list[Ring]:
    drawn_by_chance = np.random.default_rng(CIRCLE_SEARCH.seed).integers(0, len(found.ray), (CIRCLE_SEARCH.draws, 3))
    x, y = found.place[drawn_by_chance], found.line[drawn_by_chance]
    ax, ay, bx, by = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0], x[:, 2] - x[:, 0], y[:, 2] - y[:, 0]
    cross = 2 * (ax * by - ay * bx)
    good = np.abs(cross) > 1.0
    a2, b2, cross = (ax**2 + ay**2)[good], (bx**2 + by**2)[good], cross[good]
    u, v = (by[good] * a2 - ay[good] * b2) / cross, (ax[good] * b2 - bx[good] * a2) / cross
    place, line, radius = x[good, 0] + u, y[good, 0] + v, np.hypot(u, v)
    away = np.hypot(place - drawn.place, line - drawn.line)
    fits = (
        (away + radius <= CIRCLE_SEARCH.largest * drawn.radius)
        & (radius >= max(CIRCLE_SEARCH.smallest_px, CIRCLE_SEARCH.smallest * drawn.radius))
        & (away <= radius)
    )
    return [Ring(*ring) for ring in zip(line[fits].tolist(), place[fits].tolist(), radius[fits].tolist(), strict=True)]


def _support(found: _Candidates, ring: Ring, n_rays: int) -> float:
    """Return the mean over all rays of the steepness of the points on a circle."""
    near = np.abs(ring.off(found.line, found.place)) <= CIRCLE_SEARCH.near_px
    steepest = np.zeros(n_rays)
    np.maximum.at(steepest, found.ray[near], found.steep[near])
    return float(steepest.mean())


def _require_clear(rays: _Rays, best: _Consensus, rival: float) -> None:
    if best.score <= max(CIRCLE_SEARCH.over_rest * rays.elsewhere(best.ring), STRAIGHT_EDGE.least_steep):
        raise MeasureError("No round edge stands out in the circle: draw it round something that the picture shows.")
    if rival > AS_STRONG * best.score:
        raise MeasureError(
            f"Two round edges in the circle are about as strong, {100 * rival / best.score:.0f} % one of the other: "
            "draw the circle closer, or say whether it is bright or dark inside."
        )


def _fitted(strip: SearchStrip, start: Ring, sign: Sign) -> RoundEdge:
    """Fit a least-squares circle to the edge near a ring, along rays from its own centre."""
    ring, line, place, inliers = _nearer(strip, _nearer(strip, start, sign)[0], sign)
    x_um, y_um = (float(v) for v in strip.at(np.array(ring.line), np.array(ring.place)))
    angle = np.arctan2(ring.line - line, place - ring.place)
    off_um = ring.off(line, place) * strip.pixel_um
    return RoundEdge(x_um, y_um, ring.radius * strip.pixel_um, sign, angle, off_um, inliers)


def _nearer(strip: SearchStrip, ring: Ring, sign: Sign) -> tuple[Ring, Floats, Floats, NDArray[np.bool_]]:
    """Return the circle through the edge points near a ring, their lines and places, and the mask of accepted ones."""
    rays = _Rays.over(strip, ring, max(1.0, ring.radius - CIRCLE_SEARCH.room_px), ring.radius + CIRCLE_SEARCH.room_px)
    rising, expected = sign * rays.response, np.full(len(rays.angle), ring.radius - rays.first)
    points = edges_near(rising, expected, (CIRCLE_SEARCH.reach_px, CIRCLE_SEARCH.reach_px), "nearest")
    require_found(points, len(rising))
    _require_all_round(rising, expected, points.place)
    line, place = rays.points(points.line.astype(np.intp), points.place)
    found, inliers = fit_ring(line, place, ring)
    return found, line, place, inliers


def _require_all_round(rising: Responses, expected: Floats, place: Floats) -> None:
    """Raise MeasureError where an edge is not detected in most directions, as for chance alignments of noise."""
    bins = np.round(expected).astype(np.intp)
    near = np.stack(
        [rising[np.arange(len(bins)), bins + k] for k in range(-CIRCLE_SEARCH.near_steps, CIRCLE_SEARCH.near_steps + 1)]
    ).max(axis=0)
    bands = np.array([part.mean() for part in np.array_split(near, CIRCLE_SEARCH.bands)])
    jumps = float(np.median(np.abs(np.diff(place))))
    if (
        np.mean(bands > STRAIGHT_EDGE.least_score * np.median(bands)) < STRAIGHT_EDGE.all_along
        or jumps > CIRCLE_SEARCH.jumps_px
    ):
        raise MeasureError("The round edge is not seen all round: draw the circle round one that the picture shows.")


def fit_ring(line: Floats, place: Floats, start: Ring) -> tuple[Ring, NDArray[np.bool_]]:
    """Fit a circle by geometric least squares with rejection beyond 3 robust deviations.

    start: initial estimate. Also returns the mask of accepted points. Raises MeasureError when the points do not
    determine a circle.
    """
    ring, inliers = start, np.ones(len(line), bool)
    for _ in range(CIRCLE_SEARCH.most_rounds):
        away = np.maximum(np.hypot(line - ring.line, place - ring.place), 1e-9)
        design = np.stack([(line - ring.line) / away, (place - ring.place) / away, np.ones(len(away))], axis=1)
        fit = robust_fit(design, away - ring.radius)
        step, inliers = fit.coefficients, fit.inliers
        ring = Ring(ring.line + float(step[0]), ring.place + float(step[1]), ring.radius + float(step[2]))
        if float(np.abs(step).max()) < 1e-6:
            break
    return ring, inliers


# --------------------------------------------------------------------------------------------------------------- circle


Inside = Literal["either", "bright", "dark"]
SIGNS: dict[Inside, tuple[Sign, ...]] = {"either": (1, -1), "bright": (-1,), "dark": (1,)}
"""Signs of the brightness change from inside to outside."""
ROOM = 1.2
"""Ratio of the image area read to the drawn circle; an edge near the circle needs both its sides."""
ROUNDNESS = f"Roundness is that of medians of {CIRCLE_SEARCH.neighbours} neighbouring rays; noise makes it larger."


def circle_size(
    surface: Mosaic,
    circle: Region,
    *,
    inside: Inside = "either",
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> CircleSize:
    """Measure diameter, radius and roundness of a circular edge.

    The edge is detected in the all-in-focus image, within the drawn circle.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    circle : Region
        Circle drawn around the edge, in stage um.
    inside : {'either', 'bright', 'dark'}, optional
        Brightness of the inside relative to the outside. Default 'either'.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer that the result names; edges are detected in the image. Default None: the layer on which
        the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    CircleSize
        Diameter and radius of the least-squares circle in um, with expanded uncertainties (k = 2), its centre, and the
        roundness in um, whose uncertainty is not evaluated.

    Raises
    ------
    MeasureError
        If the region is no circle, lies outside the surface or is too small, or less than half of the area searched
        lies on the image.
    MeasureError
        If no circular edge stands out, more than one does, or it is not detected all round.

    Notes
    -----
    Roundness is RONt of ISO 12181 [1]_ about the least-squares circle, of medians of five neighbouring rays. Noise
    makes it larger.

    References
    ----------
    .. [1] ISO 12181-1, Roundness - Part 1: Vocabulary and parameters of roundness.
    """
    require_choice("inside", inside, Inside, MeasureError)
    if circle.kind != "circle":
        raise MeasureError(f"A diameter is measured in a circle, this region is a {circle.kind}: draw a circle.")
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    drawn = circle.points[0]
    room = Region.circle(drawn.x_um, drawn.y_um, ROOM * circle.radius_um + CIRCLE_SEARCH.room_px * surface.pixel_um)
    strip, level = read_strip(surface, room, "a diameter")
    edge = find_circle(strip, drawn.x_um, drawn.y_um, circle.radius_um, SIGNS[inside])
    u_um = edge.u_radius_um
    x_um, y_um, radius_um = (round(v, 4) for v in (edge.x_um, edge.y_um, edge.radius_um))
    return CircleSize(
        **reading.result_fields(name, level, *notes(reading, ROUNDNESS)),
        circle=circle,
        options=CircleOptions(inside=inside),
        diameter=between_edges(reading, 2 * edge.radius_um, strip.pixel_um, None if u_um is None else u_um.times(2)),
        radius=between_edges(reading, edge.radius_um, strip.pixel_um, u_um, 1),
        roundness=reading.length(edge.roundness_um, None),
        center=Point(x_um=x_um, y_um=y_um),
        found=Region.circle(x_um, y_um, radius_um),
        inside="bright" if edge.sign < 0 else "dark",
        points=len(edge.angle),
    )
