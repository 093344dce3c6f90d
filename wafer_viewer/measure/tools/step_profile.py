"""Depth of a groove, height of a ridge or a step along a line, by ISO 5436-1.

The model with the largest explained sum of squares is chosen: z = a x + b + h delta, where delta is 1 between two
places and 0 outside. Running sums give the explained sum of squares of every pair of places, so that all are tried.

For a groove of width W, zone C is the middle third. Zones A and B, two thirds of W long, begin a third of W off its
edges, so that rounded edges are excluded. The standard has no zones for a single step: here the zones of its two sides
are A and B of a groove as wide as the shorter side is long.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.correlated_errors import Scatter, functional_scatter
from wafer_viewer.measure.base.error_covariance import WeightedHeights
from wafer_viewer.measure.base.height_samples import Floats, Layer
from wafer_viewer.measure.base.measurement_context import NOISE, POSES, Lines, MeasurementContext, step_budget
from wafer_viewer.measure.base.pixel_noise import noise_um, pixel_noise_um
from wafer_viewer.measure.base.robust_fit import least_squares
from wafer_viewer.measure.tools.profile import places_across, profile, require_straight
from wafer_viewer.measure.tools.step_height import PoseSensitivities, poses_u_um
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import ProfileCurve, StepProfile
from wafer_viewer.model.measurement.tool_options import Conditions, GrooveOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.height_map import Mosaic


@dataclass(frozen=True, slots=True)
class StepProfileParameters:
    """Limits of the edge search along a profile, and of the evaluation of its zones.

    Parameters
    ----------
    bins : int
        Number of means along the profile for the exhaustive search; then single samples are tried.
    median_of : int
        Window of the running median, in samples, which removes single false heights.
    least_bins : int
        Smallest width of the bottom and of each side, in means; for a single step in samples.
    rounds : int
        Number of times that both edges are moved in turn, sample by sample.
    least_samples : int
        Smallest number of measured samples of a zone.
    usual : float
        Quantile of the distances from the running median that is taken as usual.
    false : float
        Multiple of the usual distance beyond which a height is false.
    rounding_um : float, um
        Distance from the running median within which no height is false.
    least_measured : float
        Smallest measured fraction of a zone.
    drawn : int
        Largest number of curve points in a result.
    stands_out : float
        Smallest ratio of a jump to its noise; the jump is the largest of very many.
    """

    bins: int = 300
    median_of: int = 5
    least_bins: int = 2
    rounds: int = 3
    least_samples: int = 10
    usual: float = 0.9
    false: float = 3.0
    rounding_um: float = 1e-4
    least_measured: float = 0.5
    drawn: int = 240
    stands_out: float = 6.0


STEP_PROFILE = StepProfileParameters()


@dataclass(frozen=True, slots=True, eq=False)
class SideSums:
    """Running sums over samples of a profile: count, centred place, and residual from a straight line."""

    n: Floats
    x: Floats
    left: Floats
    x_squares: float

    @classmethod
    def of(cls, x: Floats, z: Floats) -> SideSums:
        """Return the running sums of samples at x with heights z, both [n]."""
        about = x - x.mean()
        squares = float(about @ about)
        left = z - z.mean() - about * (float(about @ z) / squares)
        count, place, rest = (np.concatenate([[0.0], np.cumsum(c)]) for c in (np.ones(len(x)), about, left))
        return cls(count, place, rest, squares)

    def explained(self, first: np.ndarray, end: np.ndarray) -> Floats:
        """Return the sum of squares explained by a jump of samples first ... end - 1; indices broadcast."""
        count, place, left = (column[end] - column[first] for column in (self.n, self.x, self.left))
        spread = count - count**2 / self.n[-1] - place**2 / self.x_squares
        return np.where(spread > 1e-9, left**2 / np.maximum(spread, 1e-9), 0.0)


def groove_edges(x: Floats, z: Floats) -> tuple[int, int]:
    """Return the range of the bottom's samples: first and end, 0 < first < end < n."""
    even, ends = smooth(z), _bins(len(x))
    coarse = SideSums.of(_side_means(x, ends), _side_means(even, ends))
    n = len(ends) - 1
    first, end = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    allowed = (
        (first >= STEP_PROFILE.least_bins)
        & (end <= n - STEP_PROFILE.least_bins)
        & (end - first >= STEP_PROFILE.least_bins)
    )
    best = np.argmax(np.where(allowed, coarse.explained(first, end), -1.0))
    i, j = (int(ends[k]) for k in divmod(int(best), n + 1))
    fine, reach = SideSums.of(x, even), 2 * -(-len(x) // n)
    for _ in range(STEP_PROFILE.rounds):
        i = _best(fine, np.arange(max(1, i - reach), min(j, i + reach + 1)), np.array(j))
        j = _best(fine, np.array(i), np.arange(max(i + 1, j - reach), min(len(x), j + reach + 1)))
    return i, j


def step_edge(x: Floats, z: Floats) -> int:
    """Return the first sample beyond the edge of a single step."""
    sums = SideSums.of(x, smooth(z))
    return _best(sums, np.arange(STEP_PROFILE.least_bins, len(x) - STEP_PROFILE.least_bins), np.array(len(x)))


def _best(sums: SideSums, first: np.ndarray, end: np.ndarray) -> int:
    """Return the varying index with the largest explained sum of squares."""
    varies = first if first.ndim else end
    return int(varies[np.argmax(sums.explained(first, end))])


def smooth(z: Floats) -> Floats:
    """Remove single false heights with a running median."""
    from scipy.ndimage import median_filter

    return median_filter(z, STEP_PROFILE.median_of, mode="nearest")


def _bins(n: int) -> np.ndarray:
    return np.unique(np.linspace(0, n, min(n, STEP_PROFILE.bins) + 1).round().astype(np.intp))


def _side_means(values: Floats, ends: np.ndarray) -> Floats:
    return np.add.reduceat(values, ends[:-1]) / np.diff(ends)


Shape = Literal["groove", "step"]
GROOVE = "ISO 5436-1: z = a x + b + h delta, delta +1 in the zones A and B and -1 in C; the depth is 2 h."
STEP = "z = a x + b + h delta, delta 0 in the zone A before the edge and 1 in B beyond it."


@dataclass(frozen=True, slots=True)
class Zone:
    """An evaluated part of a profile, from start to end along the line, with its delta."""

    name: str
    start_um: float
    end_um: float
    delta: float

    def holds(self, at_um: Floats) -> NDArray[np.bool_]:
        """Return which places along the line lie in the zone."""
        return (at_um >= self.start_um) & (at_um <= self.end_um)


@dataclass(frozen=True, slots=True)
class StepPlan:
    """Evaluation plan: edges along the line, zones, factor of h in the height, and definition."""

    edges_um: tuple[float, ...]
    zones: tuple[Zone, ...]
    times: float
    definition: str


@dataclass(frozen=True, slots=True, eq=False)
class FittedStep:
    """Accepted samples of the zones, [n]: places, zone, design (x, 1, delta) and residuals; h in um."""

    x_um: Floats
    y_um: Floats
    at_um: Floats
    zone: np.ndarray
    design: Floats
    left_um: Floats
    h_um: float

    @property
    def weights(self) -> Floats:
        """Weight of each sample in h, [n]."""
        return np.linalg.pinv(self.design)[2]


def step_profile(
    surface: Mosaic,
    line: Region,
    *,
    shape: Shape = "groove",
    conditions: Conditions = Conditions(),
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> StepProfile:
    """Measure a groove depth, ridge height or single step along a line.

    Edges are detected automatically. Heights are averaged over the `width_um` of the line.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    line : Region
        Line across the groove, ridge or step, in stage um.
    shape : {'groove', 'step'}, optional
        Two edges of a groove or a ridge, or the edge of a single step. Default 'groove'.
    conditions : Conditions, optional
        Further known contributions to the uncertainty, standard uncertainties (k = 1). Contributions that are unknown
        are listed as not evaluated. Default: none given; linearity and Abbe error are then those of the calibration,
        where it has them.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    StepProfile
        Height in um with its expanded uncertainty (k = 2): positive for a groove or a ridge; for a step, the height
        behind its edge minus that before it. Also the width of a groove or a ridge in um, without uncertainty, the
        edges and the zones along the line, and the profile.

    Raises
    ------
    MeasureError
        If the region is no line, has no length, or lies outside the surface.
    MeasureError
        If fewer than 30 samples along the line were measured.
    MeasureError
        If the line ends too near to an edge: it has to reach as far beyond a groove as the groove is wide.
    MeasureError
        If a zone has fewer than 10 measured samples, or less than half of its samples measured.
    MeasureError
        If nothing stands out of the noise along the line.

    Notes
    -----
    The model of ISO 5436-1 [1]_, z = a x + b + h delta, is fitted by least squares over zones. For a groove of width W,
    delta is -1 in zone C, its middle third, and +1 in zones A and B, two thirds of W long, which begin a third of W off
    its edges, so that rounded edges are excluded; the depth is 2 h.

    The standard has no zones for a single step. Here the zones of its two sides are A and B of a groove as wide as the
    shorter side is long; delta is 0 in A and 1 in B. Single false heights, far from a running median, are rejected.

    References
    ----------
    .. [1] ISO 5436-1, Surface texture: Profile method; Measurement standards - Part 1: Material measures.
    """
    require_choice("shape", shape, Shape, MeasureError)
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    require_straight(line)
    section, curve = profile(surface, line, calibration_valid=calibration_valid, layer=layer)
    measured = _some(curve, np.isfinite(curve.z_um))
    if len(measured.z_um) < 3 * STEP_PROFILE.least_samples:
        raise MeasureError(
            "Too few heights were measured along the line: draw it longer, or where the surface has fewer holes."
        )
    plan = PLANS[shape](measured.distance_um, measured.z_um, section.length_um)
    trusted = _trusted(measured)
    fitted = _fitted(trusted, curve.distance_um, plan.zones)
    scatter = _scatter(fitted, plan, trusted)
    if scatter is not None and abs(fitted.h_um) <= STEP_PROFILE.stands_out * scatter.u:
        raise MeasureError(f"No {shape} stands out of the noise along the line: draw it across one.")
    height_um = plan.times * fitted.h_um
    kind = shape if shape == "step" else "groove" if height_um > 0 else "ridge"
    lines, missing = _budget(reading, line, fitted, plan, scatter, conditions)
    fields = reading.result_fields(name, 0, *section.notes, *reading.not_in_budget(own=True))
    fields["filter"] = section.filter
    return StepProfile(
        **fields,
        line=line,
        kind=kind,
        height=reading.length(height_um if kind == "step" else abs(height_um), lines),
        definition=plan.definition,
        options=GrooveOptions(shape=shape, conditions=conditions),
        width=None if shape == "step" else reading.length(plan.edges_um[1] - plan.edges_um[0], None),
        edges_um=plan.edges_um,
        zones=tuple((zone.name, zone.start_um, zone.end_um) for zone in plan.zones),
        curve=_drawn(measured),
        sq_um=float(np.sqrt(np.mean(fitted.left_um**2))),
        points=len(fitted.left_um),
        measured_fraction=section.measured_fraction,
        not_evaluated=missing,
    )


def _groove(at_um: Floats, z_um: Floats, length_um: float) -> StepPlan:
    first, end = groove_edges(at_um, z_um)
    left_um, right_um = (float(at_um[k - 1] + at_um[k]) / 2 for k in (first, end))
    width_um = right_um - left_um
    room_um = min(left_um, length_um - right_um)
    if room_um < width_um:
        raise MeasureError(
            f"The line reaches {room_um:.1f} um beyond what stands out most along it and has to reach as far as that "
            f"is wide, {width_um:.1f} um: draw it longer on both sides of a groove."
        )
    third = width_um / 3
    zones = (
        Zone("A", left_um - 3 * third, left_um - third, 1.0),
        Zone("C", left_um + third, right_um - third, -1.0),
        Zone("B", right_um + third, right_um + 3 * third, 1.0),
    )
    return StepPlan((left_um, right_um), zones, 2.0, GROOVE)


def _step(at_um: Floats, z_um: Floats, length_um: float) -> StepPlan:
    k = step_edge(at_um, z_um)
    edge_um = float(at_um[k - 1] + at_um[k]) / 2
    third = min(edge_um, length_um - edge_um) / 3
    zones = (
        Zone("A", edge_um - 3 * third, edge_um - third, 0.0),
        Zone("B", edge_um + third, edge_um + 3 * third, 1.0),
    )
    return StepPlan((edge_um,), zones, 1.0, STEP)


PLANS: dict[Shape, Callable[[Floats, Floats, float], StepPlan]] = {"groove": _groove, "step": _step}
"""Evaluation plans by shape."""


def _fitted(curve: ProfileCurve, samples_um: Floats, zones: tuple[Zone, ...]) -> FittedStep:
    """Fit z = a x + b + h delta to the zones; samples_um: all sample places, measured or not."""
    zone = np.full(len(curve.z_um), -1)
    for k, segment in enumerate(zones):
        inside = segment.holds(curve.distance_um)
        zone[inside] = k
        _require_enough(segment, int(np.count_nonzero(inside)), int(np.count_nonzero(segment.holds(samples_um))))
    counts = zone >= 0
    at_um, z_um = curve.distance_um[counts], curve.z_um[counts]
    delta = np.array([segment.delta for segment in zones])[zone[counts]]
    design = np.column_stack([at_um - at_um.mean(), np.ones(len(at_um)), delta])
    coefficients = least_squares(design, z_um)
    left_um = z_um - design @ coefficients
    return FittedStep(
        curve.x_um[counts], curve.y_um[counts], at_um, zone[counts], design, left_um, float(coefficients[2])
    )


def _trusted(curve: ProfileCurve) -> ProfileCurve:
    """Remove samples far from a running median: single false heights."""
    off_um = np.abs(curve.z_um - smooth(curve.z_um))
    inliers = off_um <= max(
        STEP_PROFILE.false * float(np.quantile(off_um, STEP_PROFILE.usual)), STEP_PROFILE.rounding_um
    )
    return _some(curve, inliers)


def _drawn(curve: ProfileCurve) -> tuple[tuple[float, float], ...]:
    """Return every point, or means of neighbours if there are too many."""
    step = -(-len(curve.z_um) // STEP_PROFILE.drawn)
    starts = np.arange(0, len(curve.z_um), step)
    count = np.diff(np.append(starts, len(curve.z_um)))
    at_um, z_um = (np.add.reduceat(column, starts) / count for column in (curve.distance_um, curve.z_um))
    return tuple(zip(np.round(at_um, 3).tolist(), np.round(z_um, 4).tolist(), strict=True))


def _some(curve: ProfileCurve, which: NDArray[np.bool_]) -> ProfileCurve:
    return ProfileCurve(*(column[which] for column in (curve.distance_um, curve.z_um, curve.x_um, curve.y_um)))


def _require_enough(zone: Zone, measured: int, samples: int) -> None:
    if measured < max(STEP_PROFILE.least_samples, STEP_PROFILE.least_measured * samples):
        needed = max(STEP_PROFILE.least_samples, round(STEP_PROFILE.least_measured * samples))
        raise MeasureError(
            f"Zone {zone.name} of the profile has {measured} measured samples of {samples} and needs "
            f"{needed}: draw the line where the surface has fewer holes, or across something wider."
        )


def _scatter(fitted: FittedStep, plan: StepPlan, curve: ProfileCurve) -> Scatter | None:
    """Return the uncertainty of h by the residuals of the whole line; None where they do not determine it.

    A zone shorter than the correlation length of the errors does not show its own. curve: the trusted samples. Samples
    within a third of the width of an edge do not count, nor what lies beyond the next thing that stands out half as far
    as this.
    """
    at_um, edges_um = curve.distance_um, np.array(plan.edges_um)
    before, beyond = plan.zones[:2]
    third_um = beyond.start_um - edges_um[0]
    inside = (at_um > edges_um[0]) & (at_um < (edges_um[-1] if len(edges_um) > 1 else np.inf))
    design = np.column_stack([at_um - at_um.mean(), np.ones(len(at_um)), np.where(inside, beyond.delta, before.delta)])
    flat = np.abs(at_um[:, None] - edges_um).min(axis=1) >= third_um
    left_um = np.zeros(len(at_um))
    for _ in range(STEP_PROFILE.rounds):
        left_um = curve.z_um - design @ least_squares(design[flat], curve.z_um[flat])
        stands_out = flat & (np.abs(left_um) > abs(fitted.h_um * (beyond.delta - before.delta)) / 2)
        if not stands_out.any():
            break
        away_um = at_um[stands_out]
        flat &= (at_um > away_um[away_um < edges_um[0]].max(initial=-np.inf)) & (
            at_um < away_um[away_um > edges_um[-1]].min(initial=np.inf)
        )
    weights = np.zeros(len(at_um))
    weights[np.searchsorted(at_um, fitted.at_um)] = fitted.weights
    return functional_scatter(weights, np.where(flat, left_um, np.nan), design.shape[1])


def _budget(
    reading: MeasurementContext,
    line: Region,
    fitted: FittedStep,
    plan: StepPlan,
    scatter: Scatter | None,
    conditions: Conditions,
) -> tuple[Lines | None, tuple[str, ...]]:
    if not reading.calibrated or scatter is None:
        return None, ()
    weight = plan.times * fitted.weights
    of_points = {
        NOISE: noise_um(
            scatter.times(plan.times),
            pixel_noise_um(reading, _of_pixels(reading, line, fitted, weight)),
        ),
        POSES: poses_u_um(reading.surface, PoseSensitivities(fitted.x_um, fitted.y_um, weight)),
    }
    budget = step_budget(plan.times * fitted.h_um, of_points, conditions, reading.surface.provenance)
    return budget.lines, budget.not_evaluated


def _of_pixels(reading: MeasurementContext, line: Region, fitted: FittedStep, weight: Floats) -> WeightedHeights:
    """Return a sum over samples, each the mean of the pixels across the line, as one over those."""
    x_um, y_um = places_across(line, fitted.x_um, fitted.y_um, reading.surface.pixel_um)
    each = np.broadcast_to(weight[:, None] / x_um.shape[1], x_um.shape)
    return WeightedHeights(x_um.ravel(), y_um.ravel(), each.ravel())
