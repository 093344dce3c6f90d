"""Run chart of gauge-block checks with warning rules, and the capability Cg and Cgk."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from statistics import fmean, stdev, variance

import numpy as np

from wafer_viewer.measure.gauge.gauge_check import KnownTerms
from wafer_viewer.model.gauge import Capability, ChartPoint, GaugeCheck, GaugeRecord, RunChart
from wafer_viewer.model.quantity import Contribution, Length
from wafer_viewer.numerics.normal_statistics import student

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
    u = student(freedom) / 2 * math.sqrt(float(left_um @ left_um) / freedom / float(away @ away))
    return Length.evaluated(slope, (Contribution(name="scatter of the checks", u_um=u),))


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
    sentence = f"The error drifts by {drift.value_um:+.2g} um per day, U = {drift.expanded_um:.1g} um per day (k = 2)"
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
LEAST = 1.33
"""Lower limit of Cg and of Cgk."""
VARIANT = "Cg = 0.2 T / (6 s), Cgk = (0.1 T - |mean error|) / (3 s), both >= 1.33 over 25 repeats"


def capability(errors_um: Sequence[float], tolerance_um: float) -> Capability:
    """Return Cg and Cgk from errors of single scans, for a product's tolerance T (upper less lower limit)."""
    n = len(errors_um)
    mean_um = fmean(errors_um) if n else 0.0
    s_um = stdev(errors_um) if n > 1 else None
    cg = CG_SHARE * tolerance_um / (6 * s_um) if s_um else None
    cgk = (CGK_SHARE * tolerance_um - abs(mean_um)) / (3 * s_um) if s_um else None
    capable = None if cg is None or cgk is None or n < LEAST_REPEATS else min(cg, cgk) >= LEAST
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
    return f"Both are at least {LEAST}." if capable else f"One is under {LEAST}."
