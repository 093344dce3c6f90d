"""Studies of the gauge: its run chart with warning rules, its capability, and gauge R&R by the AIAG manual."""

from __future__ import annotations

import dataclasses
import datetime
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean, stdev, variance
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special  # scipy.stats is slow to load, and every session loads this module

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.measurement_context import contribution
from wafer_viewer.measure.gauge.gauge_check import KnownTerms
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import (
    CAPABLE,
    EFFECTS,
    K_OF_TRIALS,
    AnovaRow,
    Capability,
    ChartPoint,
    GaugeCheck,
    GaugeRecord,
    GaugeRR,
    Interval,
    Method,
    Repeats,
    RunChart,
    Study,
)
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace, require_choice

# ------------------------------------------------------------------------------------------------------------ run chart


D2 = 1.128
"""Mean range of two normal values, in standard deviations."""
LEAST_FOR_LIMITS = 5
"""Smallest number of points for control limits."""
RUN = 8
"""Length of a run on one side of the mean that triggers a warning (ISO 7870-2)."""
OUTSIDE, ONE_SIDE = "outside the control limits", f"{RUN} in a row on one side of the mean"
LEAST_FREEDOM = 4
"""Smallest degrees of freedom of a pooled scatter."""


def run_chart(records: Sequence[GaugeRecord]) -> RunChart | None:
    """Return the individuals chart of the errors in signed checks of one pair of blocks, oldest first; None if empty.

    Checks from before the last change of the z scale are omitted, because they describe another state of the
    instrument.
    """
    checks = same_scale(records)
    if not checks:
        return None
    errors_um = [check.deviation.value_um for check in checks]
    mean_um, s_um = fmean(errors_um), _s_of_ranges(errors_um)
    low_um, high_um = (mean_um - 3 * s_um, mean_um + 3 * s_um) if s_um is not None else (None, None)
    points = tuple(
        ChartPoint(
            at=check.at,
            value=check.deviation,
            verdict=check.verdict,
            signed_by=check.signed_by,
            breaks=_breaks(errors_um[: n + 1], mean_um, low_um, high_um),
        )
        for n, check in enumerate(checks)
    )
    drift = drift_of(checks)
    return RunChart(
        points=points,
        mean_um=mean_um,
        s_um=s_um,
        low_um=low_um,
        high_um=high_um,
        limit_um=checks[-1].terms.limit_um,
        drift_um_per_day=drift,
        due=_due(checks[-1]),
        warnings=(*_broken(points), *_drifting(checks, drift)),
        notes=_left_out(records, checks),
    )


def same_scale(records: Sequence[GaugeRecord]) -> list[GaugeCheck]:
    """Return the checks made with the z scale of the last one, oldest first."""
    checks = sorted((record.check for record in records), key=lambda check: check.at)
    return [check for check in checks if _scale(check) == _scale(checks[-1])]


def pooled_scatter(records: Sequence[GaugeRecord]) -> KnownTerms | None:
    """Return the pooled within-check deviation of single scans; None with under four degrees of freedom."""
    groups = [[r.height.value_um for r in check.repeats] for check in same_scale(records) if check.n > 1]
    freedom = sum(len(group) - 1 for group in groups)
    if freedom < LEAST_FREEDOM:
        return None
    return KnownTerms(math.sqrt(sum((len(g) - 1) * variance(g) for g in groups) / freedom), freedom)


def errors_of_scans(checks: Iterable[GaugeCheck]) -> list[float]:
    """Return the error of every single scan, um, for the capability study."""
    return [repeat.height.value_um - check.reference.value_um for check in checks for repeat in check.repeats]


def drift_of(checks: Sequence[GaugeCheck]) -> Length | None:
    """Return the slope of the errors over time, um per day, with U from their scatter; None with under three days."""
    if len({check.at[:10] for check in checks}) < 3:
        return None
    days = _days(checks)
    errors_um = np.array([check.deviation.value_um for check in checks])
    away = days - days.mean()
    slope = float(away @ errors_um / (away @ away))
    left_um = errors_um - errors_um.mean() - slope * away
    freedom = len(checks) - 2
    scatter = Scatter(math.sqrt(float(left_um @ left_um) / freedom / float(away @ away)), freedom)
    return Length.evaluated(slope, (contribution("scatter of the checks", scatter),))


def _scale(check: GaugeCheck) -> float | None:
    calibration = check.repeats[0].calibration
    return None if calibration is None else calibration.z_scale


def _s_of_ranges(values: Sequence[float]) -> float | None:
    if len(values) < LEAST_FOR_LIMITS:
        return None
    return fmean(abs(b - a) for a, b in pairwise(values)) / D2


def _breaks(so_far: Sequence[float], mean: float, low: float | None, high: float | None) -> tuple[str, ...]:
    broken: list[str] = []
    if low is not None and high is not None and not low <= so_far[-1] <= high:
        broken.append(OUTSIDE)
    last = so_far[-RUN:]
    if len(last) == RUN and (min(last) > mean or max(last) < mean):
        broken.append(ONE_SIDE)
    return tuple(broken)


def _due(last: GaugeCheck) -> str:
    day = datetime.date.fromisoformat(last.at[:10]) + datetime.timedelta(days=last.terms.interval_days)
    return day.isoformat()


def _left_out(records: Sequence[GaugeRecord], checks: Sequence[GaugeCheck]) -> tuple[str, ...]:
    n = len(records) - len(checks)
    return (f"Made with another z scale and not in the chart: {n}.",) if n else ()


def _broken(points: Sequence[ChartPoint]) -> tuple[str, ...]:
    """Return the warnings of the last point; earlier points were reported at the time."""
    return tuple(f"The last check is {OUTSIDE}." if rule == OUTSIDE else f"There are {rule}." for rule in _last(points))


def _last(points: Sequence[ChartPoint]) -> tuple[str, ...]:
    return points[-1].breaks if points else ()


def _drifting(checks: Sequence[GaugeCheck], drift: Length | None) -> tuple[str, ...]:
    if drift is None or abs(drift.value_um) <= (drift.expanded_um or 0.0):
        return ()
    sentence = f"The error drifts by {drift.value_um:+.2g} um per day, U = {drift.expanded_um:.1g} um per day (95 %)"
    limit_um, due_days = checks[-1].terms.limit_um, checks[-1].terms.interval_days
    if limit_um is None:
        return (f"{sentence}.",)
    days = _days(checks)
    now_um = fmean(check.deviation.value_um for check in checks) + drift.value_um * float(days[-1] - days.mean())
    left_days = (limit_um - math.copysign(1, drift.value_um) * now_um) / abs(drift.value_um)
    if left_days > due_days:
        return (f"{sentence}; it stays within the limit of {limit_um:g} um until the next check.",)
    return (
        f"{sentence}, and leaves the limit of {limit_um:g} um in {max(0.0, left_days):.0f} days, "
        "before the next check is due.",
    )


def _days(checks: Sequence[GaugeCheck]) -> np.ndarray:
    moments = [datetime.datetime.fromisoformat(check.at).timestamp() for check in checks]
    return (np.array(moments) - moments[0]) / 86_400


LEAST_REPEATS = 25
"""Smallest number of repeats for a verdict; each is a new scan."""
CG_SHARE = 0.2
"""Share of the tolerance with which Cg compares six standard deviations."""
CGK_SHARE = 0.1
"""Share of the tolerance that Cgk leaves for the bias to either side."""
VARIANT = "Cg = 0.2 T / (6 s), Cgk = (0.1 T - |mean error|) / (3 s), both >= 1.33 over 25 repeats"


def capability(errors_um: Sequence[float], tolerance_um: float) -> Capability:
    """Return Cg and Cgk from errors of single scans, for a product's tolerance T (upper less lower limit)."""
    n = len(errors_um)
    mean_um = fmean(errors_um) if n else 0.0
    s_um = stdev(errors_um) if n > 1 else None
    cg = CG_SHARE * tolerance_um / (6 * s_um) if s_um else None
    cgk = (CGK_SHARE * tolerance_um - abs(mean_um)) / (3 * s_um) if s_um else None
    capable = None if cg is None or cgk is None or n < LEAST_REPEATS else min(cg, cgk) >= CAPABLE
    return Capability(
        n=n,
        tolerance_um=tolerance_um,
        mean_um=mean_um,
        s_um=s_um,
        cg=cg,
        cgk=cgk,
        capable=capable,
        why=_why(n, s_um, capable),
        variant=VARIANT,
    )


def _why(n: int, s_um: float | None, capable: bool | None) -> str:
    if n < LEAST_REPEATS:
        return f"There are {n} of {LEAST_REPEATS} repeats: fewer give no verdict."
    if not s_um:
        return "The repeats do not differ at all: the instrument rounds, or one scan was counted several times."
    return f"Both are at least {CAPABLE}." if capable else f"One is under {CAPABLE}."


# ------------------------------------------------------------------------------------------------------------- gauge rr


Values = NDArray[np.float64]
"""Measured values, [part, appraiser, trial]."""
ALPHA = 0.05
"""Significance level of the interaction; above it, the interaction is pooled into repeatability."""
K_OF_MEANS = {2: 0.7071, 3: 0.5231, 4: 0.4467, 5: 0.4030, 6: 0.3742, 7: 0.3534, 8: 0.3375, 9: 0.3249, 10: 0.3146}
"""1 / d2* of one range, by number of appraisers or parts: factor from the range of means to their deviation."""
CONFIDENCE = 0.95
"""Level of two-sided confidence limits."""
ONE_APPRAISER = "One appraiser: reproducibility is not evaluated."


def gauge_rr(values: ArrayLike, *, method: Method = "anova", tolerance: float | None = None) -> GaugeRR:
    """Evaluate a gauge R&R study.

    The study separates repeatability, reproducibility and part variation.

    Parameters
    ----------
    values : array_like of float, shape (parts, appraisers, trials)
        Measured values in any one unit, every part measured equally often by every appraiser.
    method : {"anova", "range"}, default "anova"
        Analysis of variance, or the average and range method.
    tolerance : float, optional
        Upper limit minus lower limit, in the unit of `values`, above 0. By default the study is not related to a
        tolerance.

    Returns
    -------
    GaugeRR
        Standard deviations in the unit of `values`: repeatability, reproducibility, that of the interaction of
        appraisers and parts, which is part of reproducibility (`interaction_variation`), both combined (`gauge_rr`),
        part variation and total variation; by analysis of variance also its table, and 95 % confidence limits of
        repeatability, gauge R&R and part variation. `word` and `why` say if the gauge will do. `interaction_p` is the p
        value of the interaction. The two of the interaction are None by range or where there is none to test.

    Raises
    ------
    MeasureError
        If `method` is neither of the two; `values` does not have three axes; there are fewer than two parts, one
        appraiser or two trials; a value is missing; the tolerance is not above 0; or, by range, there are more parts
        (10), appraisers (10) or trials (5) than the tables of the manual have.
    ValueError
        If `values` is no regular array of numbers.

    Notes
    -----
    By analysis of variance, an interaction that is not significant at the level of 0.05 is pooled into repeatability,
    its own variation is 0 then, and a significant one counts as reproducibility. With one appraiser reproducibility is
    not evaluated: it is None, with a note. Confidence limits are exact for repeatability, and modified large-sample
    limits for sums and differences of mean squares; those cover 95 % where the interaction is not pooled too.

    References
    ----------
    AIAG, Measurement Systems Analysis (MSA), 4th edition, chapter III B. Burdick, Borror, Montgomery: Design and
    Analysis of Gauge R&R Studies, 2005 (confidence limits). VDA 5, 2021 (Q_MP).
    """
    require_choice("method", method, Method, MeasureError)
    x = _checked(values)
    return _METHODS[method](x, tolerance)


def study_rr(study: Study, method: Method = "anova") -> GaugeRR:
    """Evaluate a gauge R&R study, with the tolerance of its feature.

    Parameters
    ----------
    study : Study
        Repeated measurements of one feature, [part][appraiser][trial] in the unit of the study.
    method : {"anova", "range"}, default "anova"
        Analysis of variance, or the average and range method.

    Returns
    -------
    GaugeRR
        Standard deviations in the unit of the study; see `gauge_rr`.

    Raises
    ------
    MeasureError
        As `gauge_rr`: if `method` is neither of the two, there are fewer than two parts, one appraiser or two trials, a
        value is missing, or, by range, there are more parts, appraisers or trials than the tables of the manual have.
    ValueError
        If the parts were not measured equally often.

    References
    ----------
    AIAG, Measurement Systems Analysis (MSA), 4th edition, chapter III B.
    """
    require_choice("method", method, Method, MeasureError)
    return gauge_rr(np.array(study.values), method=method, tolerance=study.tolerance)


def repeats_of(study: Study) -> Repeats:
    """Return the repeatability of a feature, for a budget line.

    A single part measured twice is enough.

    Parameters
    ----------
    study : Study
        Repeated measurements of one feature, [part][appraiser][trial] in the unit of the study.

    Returns
    -------
    Repeats
        Standard deviation of a single measurement in the unit of the study, pooled over parts and appraisers, and its
        degrees of freedom: parts x appraisers x (trials - 1).

    Raises
    ------
    MeasureError
        If nothing was measured twice.
    ValueError
        If the parts were not measured equally often.

    References
    ----------
    JCGM 100:2008 (GUM), 4.2: Type A evaluation of standard uncertainty.
    """
    x = np.asarray(study.values, float)
    df = x.shape[0] * x.shape[1] * (x.shape[2] - 1)
    if df < 1:
        raise MeasureError(f"'{study.feature}' was measured once on each part: scan one of them again at least.")
    s = float(np.sqrt(((x - x.mean(axis=2, keepdims=True)) ** 2).sum() / df))
    return Repeats(s=s, degrees_of_freedom=df, unit=study.unit)


def _by_anova(x: Values, tolerance: float | None) -> GaugeRR:
    parts, appraisers, trials = x.shape
    of_part, of_appraiser, both, error = _sums_of_squares(x)
    together = _tested(both, error)
    p = together.p
    pooled = p is None or p > ALPHA  # the interaction of appraisers and parts is not significant
    repeats = _MeanSquare(*(error.plus(both) if pooled else error))
    base = repeats if pooled else _MeanSquare(*both)
    n = parts * trials
    gauge = [repeats]
    if appraisers > 1:  # other mean squares contain the error too
        gauge = [_MeanSquare(*of_appraiser, 1 / n), repeats.times(1 - 1 / (n if pooled else trials))]
        gauge += [] if pooled else [base.times((parts - 1) / n)]
    part = [_MeanSquare(*of_part, 1 / (appraisers * trials)), base.times(-1 / (appraisers * trials))]
    together_var = 0.0 if pooled else max(0.0, (base.value - repeats.value) / trials)
    between = max(0.0, (_MeanSquare(*of_appraiser).value - base.value) / n) if appraisers > 1 else 0.0
    found = _found(
        x,
        "anova",
        tolerance,
        repeatability=np.sqrt(repeats.value),
        reproducibility=np.sqrt(between + together_var) if appraisers > 1 else None,
        part=np.sqrt(max(0.0, sum(square.part for square in part))),
        interaction=None if p is None else (float(np.sqrt(together_var)), p),
    )
    tests = _tested(of_part, base), _tested(of_appraiser, base), together
    rows = zip(EFFECTS, (of_part, of_appraiser, both, error), (*tests, _Test()), strict=True)
    return replace(
        found,
        anova=tuple(
            AnovaRow(effect=effect, freedom=of.freedom, sum_of_squares=of.squares, f=test.f, p=test.p)
            for effect, of, test in rows
            if of.freedom
        ),
        repeatability_limits=_limits([repeats]),
        gauge_rr_limits=_limits(gauge),
        part_limits=_limits(part),
    )


class _Squares(NamedTuple):
    """A sum of squares and its degrees of freedom."""

    squares: float
    freedom: int

    def plus(self, other: _Squares) -> _Squares:
        return _Squares(self.squares + other.squares, self.freedom + other.freedom)


@dataclass(frozen=True, slots=True)
class _MeanSquare:
    """A sum of squares with its degrees of freedom, and the weight of its mean square in a variance."""

    squares: float
    freedom: int
    weight: float = 1.0

    @property
    def value(self) -> float:
        return self.squares / self.freedom if self.freedom else 0.0

    @property
    def part(self) -> float:
        return self.weight * self.value

    def times(self, weight: float) -> _MeanSquare:
        return dataclasses.replace(self, weight=weight)

    def off(self, quantile: float) -> float:
        """Return how far its part may be off, as chi-squared is at a quantile."""
        return self.part * (1 - self.freedom / float(2 * special.gammaincinv(self.freedom / 2, quantile)))


class _Test(NamedTuple):
    """F test of an effect; None where there is nothing to test."""

    f: float | None = None
    p: float | None = None


def _sums_of_squares(x: Values) -> tuple[_Squares, _Squares, _Squares, _Squares]:
    """Return those of `EFFECTS`."""
    parts, appraisers, trials = x.shape
    grand, of_part, of_appraiser, of_cell = x.mean(), x.mean(axis=(1, 2)), x.mean(axis=(0, 2)), x.mean(axis=2)
    both = of_cell - of_part[:, None] - of_appraiser + grand
    return (
        _Squares(appraisers * trials * float(((of_part - grand) ** 2).sum()), parts - 1),
        _Squares(parts * trials * float(((of_appraiser - grand) ** 2).sum()), appraisers - 1),
        _Squares(trials * float((both**2).sum()), (parts - 1) * (appraisers - 1)),
        _Squares(float(((x - of_cell[..., None]) ** 2).sum()), parts * appraisers * (trials - 1)),
    )


def _tested(effect: _Squares, base: _Squares | _MeanSquare) -> _Test:
    """Return the F test of an effect against a base; a base that does not vary makes any effect certain."""
    if not effect.freedom or effect.squares == base.squares == 0:
        return _Test()
    if base.squares == 0:
        return _Test(p=0.0)
    f = (effect.squares / effect.freedom) / (base.squares / base.freedom)
    return _Test(f, float(special.fdtrc(effect.freedom, base.freedom, f)))


def _limits(squares: Sequence[_MeanSquare]) -> Interval:
    """Return modified large-sample limits of the root of a weighted sum of mean squares; exact for a single one.

    Of a difference the limits leave out the small term of both mean squares together.
    """
    middle = sum(square.part for square in squares)
    tail = (1 - CONFIDENCE) / 2
    low, high = (
        math.sqrt(sum(square.off(q if square.weight > 0 else 1 - q) ** 2 for square in squares))
        for q in (1 - tail, tail)
    )
    return Interval(low=math.sqrt(max(0.0, middle - low)), high=math.sqrt(max(0.0, middle + high)))


def _by_range(x: Values, tolerance: float | None) -> GaugeRR:
    parts, appraisers, trials = x.shape
    repeatability = _factor(K_OF_TRIALS, trials, "trials") * float(np.ptp(x, axis=2).mean())
    reproducibility = None
    if appraisers > 1:
        spread = _factor(K_OF_MEANS, appraisers, "appraisers") * float(np.ptp(x.mean(axis=(0, 2))))
        reproducibility = np.sqrt(max(0.0, spread**2 - repeatability**2 / (parts * trials)))
    part = _factor(K_OF_MEANS, parts, "parts") * float(np.ptp(x.mean(axis=(1, 2))))
    return _found(
        x, "range", tolerance, repeatability=repeatability, reproducibility=reproducibility, part=part, interaction=None
    )


_METHODS: dict[Method, Callable[[Values, float | None], GaugeRR]] = {"anova": _by_anova, "range": _by_range}


def _found(
    x: Values,
    method: Method,
    tolerance: float | None,
    *,
    repeatability: float,
    reproducibility: float | None,
    part: float,
    interaction: tuple[float, float] | None,
) -> GaugeRR:
    """Return the result; interaction: its standard deviation and its p value."""
    interaction_variation, interaction_p = interaction or (None, None)
    grr = float(np.hypot(repeatability, reproducibility or 0.0))
    return GaugeRR(
        method=method,
        parts=x.shape[0],
        appraisers=x.shape[1],
        trials=x.shape[2],
        repeatability=float(repeatability),
        reproducibility=None if reproducibility is None else float(reproducibility),
        gauge_rr=grr,
        part_variation=float(part),
        total_variation=float(np.hypot(grr, part)),
        interaction_variation=interaction_variation,
        interaction_p=interaction_p,
        tolerance=tolerance,
        notes=(ONE_APPRAISER,) if x.shape[1] == 1 else (),
    )


def _factor(table: dict[int, float], n: int, effect: str) -> float:
    if n not in table:
        raise MeasureError(
            f"There are {n} {effect}: the method of ranges has factors for {min(table)} to {max(table)}."
        )
    return table[n]


def _checked(values: ArrayLike) -> Values:
    x = np.asarray(values, float)
    if x.ndim != 3 or x.shape[0] < 2 or x.shape[1] < 1 or x.shape[2] < 2:
        shape = " x ".join(str(n) for n in x.shape)
        raise MeasureError(f"The study is {shape}: it takes two parts, one appraiser and two trials at least.")
    if not np.isfinite(x).all():
        part, appraiser, trial = (int(k) + 1 for k in np.argwhere(~np.isfinite(x))[0])
        raise MeasureError(
            f"Part {part}, appraiser {appraiser}, trial {trial} has no value: measure it, or leave the part out."
        )
    return x
