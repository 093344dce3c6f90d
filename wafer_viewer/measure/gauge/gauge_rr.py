"""Gauge R&R by the AIAG MSA manual: analysis of variance, and average and range method."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeRR, Method, Repeats, Study

Values = NDArray[np.float64]
"""Measured values, [part, appraiser, trial]."""
ALPHA = 0.05
"""Significance level of the interaction; above it, the interaction is pooled into repeatability."""
K_OF_TRIALS = {2: 0.8862, 3: 0.5908, 4: 0.4857, 5: 0.4299}
"""1 / d2 by number of trials: factor from their mean range to their standard deviation."""
K_OF_MEANS = {2: 0.7071, 3: 0.5231, 4: 0.4467, 5: 0.4030, 6: 0.3742, 7: 0.3534, 8: 0.3375, 9: 0.3249, 10: 0.3146}
"""1 / d2* of one range, by number of appraisers or parts: factor from the range of means to their deviation."""
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
        Standard deviations in the unit of `values`: repeatability, reproducibility, both combined (`gauge_rr`), part
        variation and total variation. `interaction` is the p value of the interaction of appraisers and parts, None by
        range or where there is none to test.

    Raises
    ------
    MeasureError
        If `values` does not have three axes; there are fewer than two parts, one appraiser or two trials; a value is
        missing; the tolerance is not above 0; or, by range, there are more parts (10), appraisers (10) or trials (5)
        than the tables of the manual have.
    ValueError
        If `values` is no regular array of numbers.
    KeyError
        If `method` is neither of the two.

    Notes
    -----
    By analysis of variance, an interaction that is not significant at the level of 0.05 is pooled into repeatability,
    and a significant one counts as reproducibility. With one appraiser reproducibility is not evaluated: it is 0, with
    a note.

    References
    ----------
    AIAG, Measurement Systems Analysis (MSA), 4th edition, chapter III B.
    """
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
        As `gauge_rr`: if there are fewer than two parts, one appraiser or two trials, a value is missing, or, by range,
        there are more parts, appraisers or trials than the tables of the manual have.
    ValueError
        If the parts were not measured equally often.
    KeyError
        If `method` is neither of the two.

    References
    ----------
    AIAG, Measurement Systems Analysis (MSA), 4th edition, chapter III B.
    """
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
    grand, of_part, of_appraiser, of_cell = x.mean(), x.mean(axis=(1, 2)), x.mean(axis=(0, 2)), x.mean(axis=2)
    both = of_cell - of_part[:, None] - of_appraiser + grand
    within, df_within = float(((x - of_cell[..., None]) ** 2).sum()), parts * appraisers * (trials - 1)
    together, df_together = trials * float((both**2).sum()), (parts - 1) * (appraisers - 1)
    p = _chance(together, df_together, within, df_within)
    if p is None or p > ALPHA:  # the interaction of appraisers and parts is not significant
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
    """Return the p value of the interaction; None where there is none to test."""
    if df_together == 0 or within == 0:
        return None
    return float(stats.f.sf((together / df_together) / (within / df_within), df_together, df_within))


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
