"""Gauge R&R by the Automotive Industry Action Group's MSA manual: by analysis of variance, and by average and range."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge.gauge_rr import GaugeRR, Method, Repeats, Study

Values = NDArray[np.float64]
"""[part, appraiser, trial]."""
ALPHA = 0.05
"""An interaction whose p value is larger counts as chance, and is pooled into repeatability."""
K_OF_TRIALS = {2: 0.8862, 3: 0.5908, 4: 0.4857, 5: 0.4299}
"""1 / d2: from the mean range of so many trials to their standard deviation."""
K_OF_MEANS = {2: 0.7071, 3: 0.5231, 4: 0.4467, 5: 0.4030, 6: 0.3742, 7: 0.3534, 8: 0.3375, 9: 0.3249, 10: 0.3146}
"""1 / d2* of one range: from the range of so many appraisers' or parts' means to their standard deviation."""
ONE_APPRAISER = "One appraiser: reproducibility is not evaluated."


def gauge_rr(values: ArrayLike, *, method: Method = "anova", tolerance: float | None = None) -> GaugeRR:
    """How much of the spread of repeated measurements is the gauge's.

    values: [part, appraiser, trial], every part measured equally often by everyone. tolerance: upper limit less lower,
    in the unit of the values. Raises MeasureError for fewer than two parts or trials, for missing values, and by range
    for more parts, appraisers or trials than the manual's tables have. Source: AIAG MSA, 4th edition, chapter III B.
    """
    x = _checked(values)
    return _METHODS[method](x, tolerance)


def study_rr(study: Study, method: Method = "anova") -> GaugeRR:
    """Gauge R&R of a study, with the feature's tolerance. Raises MeasureError as `gauge_rr` does."""
    return gauge_rr(np.array(study.values), method=method, tolerance=study.tolerance)


def repeats_of(study: Study) -> Repeats:
    """How well a feature repeats: for the line of a budget. A single part measured twice is enough.

    Raises MeasureError where nothing was measured twice.
    """
    x = np.asarray(study.values, float)
    df = x.shape[0] * x.shape[1] * (x.shape[2] - 1)
    if df < 1:
        raise MeasureError(f"'{study.feature}' was measured once on each part: scan one of them again at least.")
    s = float(np.sqrt(((x - x.mean(axis=2, keepdims=True)) ** 2).sum() / df))
    return Repeats(s=s, degrees_of_freedom=df, unit=study.unit)


def _by_anova(x: Values, tolerance: float | None) -> GaugeRR:
    parts, appraisers, trials = x.shape
    grand, of_part, of_appraiser, of_cell = x.mean(), x.mean(axis=(1, 2)), x.mean(axis=(0, 2)), x.mean(axis=2)
    both = of_cell - of_part[:, None] - of_appraiser + grand
    within, df_within = float(((x - of_cell[..., None]) ** 2).sum()), parts * appraisers * (trials - 1)
    together, df_together = trials * float((both**2).sum()), (parts - 1) * (appraisers - 1)
    p = _chance(together, df_together, within, df_within)
    if p is None or p > ALPHA:  # what appraisers and parts do together is no more than noise
        within, df_within, together_var = within + together, df_within + df_together, 0.0
        base = within / df_within
    else:
        base = together / df_together
        together_var = max(0.0, (base - within / df_within) / trials)
    part_ms = appraisers * trials * float(of_part.var(ddof=1))
    appraiser_ms = parts * trials * float(of_appraiser.var(ddof=1)) if appraisers > 1 else base
    return _found(
        x,
        "anova",
        tolerance,
        repeatability=np.sqrt(within / df_within),
        reproducibility=np.sqrt(max(0.0, (appraiser_ms - base) / (parts * trials)) + together_var),
        part=np.sqrt(max(0.0, (part_ms - base) / (appraisers * trials))),
        interaction=p,
    )


def _by_range(x: Values, tolerance: float | None) -> GaugeRR:
    parts, appraisers, trials = x.shape
    repeatability = _factor(K_OF_TRIALS, trials, "trials") * float(np.ptp(x, axis=2).mean())
    reproducibility = 0.0
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
    reproducibility: float,
    part: float,
    interaction: float | None,
) -> GaugeRR:
    grr = float(np.hypot(repeatability, reproducibility))
    return GaugeRR(
        method=method,
        parts=x.shape[0],
        appraisers=x.shape[1],
        trials=x.shape[2],
        repeatability=float(repeatability),
        reproducibility=float(reproducibility),
        gauge_rr=grr,
        part_variation=float(part),
        total_variation=float(np.hypot(grr, part)),
        interaction=interaction,
        tolerance=tolerance,
        notes=(ONE_APPRAISER,) if x.shape[1] == 1 else (),
    )


def _chance(together: float, df_together: int, within: float, df_within: int) -> float | None:
    """The p value of the interaction; None where there is none to test."""
    if df_together == 0 or within == 0:
        return None
    return float(stats.f.sf((together / df_together) / (within / df_within), df_together, df_within))


def _factor(table: dict[int, float], n: int, of: str) -> float:
    if n not in table:
        raise MeasureError(f"There are {n} {of}: the method of ranges has factors for {min(table)} to {max(table)}.")
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
