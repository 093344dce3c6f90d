"""Statistics of the inspections of several wafers: Pareto, stack, yield, kill ratio and a control chart of density."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wafer_viewer.measure.defects.signatures import is_searchable, signatures
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, bins_of
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.lot import (
    SAME_PITCH,
    DefectSignature,
    KillRatio,
    LotStatistics,
    ParetoBar,
    ParetoBy,
    Proportion,
    WaferDefect,
    WaferDefects,
    WaferDensity,
)
from wafer_viewer.model.inspection.wafer_map import WaferMap
from wafer_viewer.model.spec import replace

CONFIDENCE = 0.95
"""Probability of two-sided confidence limits."""
OUT_OF_CONTROL = 0.00135
"""Probability beyond each control limit: that of three standard deviations of a normal distribution."""
SIZE_EDGES_UM = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Edges of the size classes, by the length of a defect."""
NOT_RESOLVED = "size not resolved"
OFF_DIES = "off the dies"
Place = tuple[int, int]
BY_TEST = "the test results of the wafer maps"


def lot_statistics(
    wafers: Sequence[WaferDefects], *, tests: Sequence[WaferMap] = (), max_per_die: int | None = None
) -> LotStatistics:
    """Compute Pareto charts, control chart, yield, kill ratios and signatures of several inspected wafers.

    Parameters
    ----------
    wafers : sequence of WaferDefects
        At least one inspected wafer, in the order of the control chart.
    tests : sequence of WaferMap, optional
        Test results: bins of the dies, one map for a wafer, found by its wafer id (and lot, where both state it).
    max_per_die : int, optional
        Largest number of defects of a good die. Default: the limit of each inspection. Tested dies need none.

    Returns
    -------
    LotStatistics
        Its `rows` are one table of all numbers.

    Raises
    ------
    MeasureError
        If there is no wafer, the dies of two wafers have different pitches, or a map states no wafer or another one
        than was inspected.
    DatasetError
        If the dies of a map and a wafer do not correspond.

    Notes
    -----
    Defects judged a nuisance do not count. The control chart is a u chart (ISO 7870-2): the limits of a wafer are the
    quantiles 0.135 % and 99.865 % of the Poisson distribution with the mean density of all wafers and its own inspected
    area. Defects that come in groups vary more than Poisson; the dispersion says so.

    Yield is good dies over inspected ones; a die that is missing counts as not good, dies that were cut or not
    inspected completely do not count. Confidence limits are those of Clopper and Pearson [1]_. The kill ratio of a
    class is 1 - Y1 / Y0, with the yields of tested dies with and without such a defect [2]_; its limits are those of
    the score method for a ratio [3]_. Other classes kill on both sides. It needs test results: dies that fail by the
    number of their defects would confirm themselves. Signatures are those of `signatures`, of each wafer and of the
    stack.

    References
    ----------
    .. [1] C. J. Clopper and E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of the
       binomial", Biometrika 26 (1934), 404-413.
    .. [2] O. D. Patterson, M. H. Hansen, "The impact of tolerance on kill ratio estimation for memory", IEEE
       Transactions on Semiconductor Manufacturing 15 (2002), 404.
    .. [3] P. A. R. Koopman, "Confidence intervals for the ratio of two binomial proportions", Biometrics 40 (1984),
       513-517.
    """
    require_wafers(wafers)
    limited = [wafer if max_per_die is None else replace(wafer, max_per_die=max_per_die) for wafer in wafers]
    bins = [_bins(wafer, _test_of(wafer, tests)) for wafer in limited]
    _require_used(tests, limited)
    per_mm2, lines = _density(limited, [_good(one) for one in bins])
    dispersion, by_chance = _dispersion([line for line in lines if line.inspected_mm2], per_mm2)
    known = [one for one in bins if one is not None]
    tested = [(wafer, one.good) for wafer, one in zip(limited, bins, strict=True) if one is not None and one.tested]
    return LotStatistics(
        wafers=lines,
        pareto=tuple(bar for by, name in _NAMED.items() for bar in _pareto(by, _each(limited, name))),
        per_mm2=per_mm2,
        dispersion=dispersion,
        dispersion_by_chance=by_chance,
        good=proportion(sum(map(_n_good, known)), sum(len(one.good) for one in known)) if known else None,
        good_by="; ".join(dict.fromkeys(one.by for one in known)),
        kill_ratios=tuple(_kill_ratios(tested)),
        signatures=tuple(_signatures(limited)),
        simulated=any(wafer.simulated for wafer in wafers),
        notes=tuple(dict.fromkeys(_notes(limited, bool(tested), len(known)))),
    )


def require_wafers(wafers: Sequence[WaferDefects]) -> None:
    """Raise MeasureError without a wafer, and for dies of different pitches."""
    if not wafers:
        raise MeasureError("There is no inspection: give at least one.")
    known = [(wafer.name, wafer.grid) for wafer in wafers if wafer.grid is not None]
    for name, grid in known[1:]:
        first_name, first = known[0]
        pairs = ((grid.pitch_x_um, first.pitch_x_um), (grid.pitch_y_um, first.pitch_y_um))
        if any(abs(one / other - 1) > SAME_PITCH for one, other in pairs):
            raise MeasureError(
                f"{name} has dies {grid.pitch_x_um:.6g} x {grid.pitch_y_um:.6g} um apart and {first_name} "
                f"{first.pitch_x_um:.6g} x {first.pitch_y_um:.6g} um: it is of another product."
            )


def _notes(wafers: Sequence[WaferDefects], tested: bool, n_yields: int) -> Iterator[str]:
    twice = [title for title, n in Counter(wafer.title for wafer in wafers).items() if n > 1]
    if twice:
        yield f"Inspected more than once, so that its dies and defects count as often: {'; '.join(twice)}."
    if found := [wafer.title for wafer in wafers if wafer.grid is not None and wafer.grid.by == "found"]:
        yield (
            "The dies were numbered as they were found, so they may be off by whole dies from wafer to wafer: "
            f"{'; '.join(found)}."
        )
    if no_area := [wafer.title for wafer in wafers if not wafer.inspected_mm2]:
        yield f"The inspected area is not known, so there is no density: {'; '.join(no_area)}."
    if n_yields < len(wafers):
        yield "Without dies, test results or a largest number of defects per die a wafer has no yield (--max-per-die)."
    if unknown := [wafer.title for wafer in wafers if not is_searchable(wafer)]:
        yield f"Signatures were not searched for without completely inspected dies: {'; '.join(unknown)}."
    if not tested:
        yield "A kill ratio needs test results of the dies: wafer maps as E142 or SINF (--tests)."
    for wafer in wafers:
        yield from wafer.notes


def _signatures(wafers: Sequence[WaferDefects]) -> Iterator[DefectSignature]:
    """Yield the signatures of each wafer, then those of all on one that has more than one."""
    searched = [wafer for wafer in wafers if is_searchable(wafer)]
    stack = [stacked_defects(searched)] if len(searched) > 1 else []
    for wafer in (*searched, *filter(is_searchable, stack)):
        yield from (replace(one, wafer=wafer.title) for one in signatures(wafer))


# ----------------------------------------------------------------------------------------------------------- pareto


def _size_class(defect: WaferDefect) -> str:
    if not defect.resolved:
        return NOT_RESOLVED
    edges = (0.0, *SIZE_EDGES_UM)
    k = int(np.searchsorted(SIZE_EDGES_UM, defect.length_um, side="right"))
    return f"over {edges[k]:g} um" if k == len(SIZE_EDGES_UM) else f"{edges[k]:g} to {SIZE_EDGES_UM[k]:g} um"


_NAMED: dict[ParetoBy, Callable[[WaferDefect], str]] = {
    "class": lambda defect: defect.kind,
    "size": _size_class,
    "die": lambda defect: defect.die or OFF_DIES,
}


def _each(wafers: Iterable[WaferDefects], name: Callable[[WaferDefect], str]) -> Iterator[str]:
    return (name(defect) for wafer in wafers for defect in wafer.defects)


def _pareto(by: ParetoBy, names: Iterable[str]) -> Iterator[ParetoBar]:
    counts = Counter(names)
    total, so_far = sum(counts.values()), 0
    for name, n in counts.most_common():
        so_far += n
        yield ParetoBar(by=by, name=name, count=n, share=n / total, cumulated=so_far / total)


# ------------------------------------------------------------------------------------------------------------ stack


def stacked_defects(wafers: Sequence[WaferDefects]) -> WaferDefects:
    """Return the defects of several wafers on one: each at its place on the same die of the first lattice.

    Parameters
    ----------
    wafers : sequence of WaferDefects
        At least one inspected wafer.

    Returns
    -------
    WaferDefects
        All defects, with new numbers, on the dies of the first wafer with dies; a die counts the defects of all
        wafers, and was inspected if it was on any. Without dies, the defects lie at their own coordinates.

    Raises
    ------
    MeasureError
        If there is no wafer, or the dies of two wafers have different pitches.

    Notes
    -----
    Dies correspond by their numbers. Wafers without dies are left out if others have some, and a note says so.
    """
    require_wafers(wafers)
    grid = next((wafer.grid for wafer in wafers if wafer.grid is not None), None)
    used = [wafer for wafer in wafers if grid is None or wafer.grid is not None]
    placed = [defect for wafer in used for defect in _on_lattice(wafer, grid)]
    dies = {die.name: die for wafer in used for die in wafer.dies}
    dies |= {die.name: die for wafer in used for die in wafer.inspected_dies}
    on = Counter(defect.die for defect in placed)
    counted = (
        die if die.defects is None else replace(die, defects=on[die.name], measured=None) for die in dies.values()
    )
    left_out = [wafer.title for wafer in wafers if wafer.grid is None and grid is not None]
    return WaferDefects(
        name=f"stack of {len(used)} wafers",
        product=used[0].product,
        notch=used[0].notch,
        center=next((wafer.center for wafer in used if wafer.grid is grid), None),
        grid=grid,
        dies=tuple(counted),
        defects=tuple(replace(defect, number=k) for k, defect in enumerate(placed, 1)),
        inspected_mm2=sum(wafer.inspected_mm2 for wafer in used),
        simulated=any(wafer.simulated for wafer in used),
        notes=(f"Without dies, so not in the stack: {'; '.join(left_out)}.",) if left_out else (),
    )


def _on_lattice(wafer: WaferDefects, grid: DieGrid | None) -> Iterator[WaferDefect]:
    """Yield the defects at the same places of the dies of another lattice."""
    if wafer.grid is None or grid is None:
        yield from wafer.defects
        return
    x_um, y_um = (np.array([getattr(defect, axis) for defect in wafer.defects]) for axis in ("x_um", "y_um"))
    there = grid.to_stage(*wafer.grid.to_die(x_um, y_um))
    turn_deg = math.degrees(grid.angle_rad - wafer.grid.angle_rad)
    for defect, x, y in zip(wafer.defects, *(axis.tolist() for axis in there), strict=True):
        yield replace(defect, x_um=x, y_um=y, angle_deg=defect.angle_deg + turn_deg)


# ---------------------------------------------------------------------------------------------------- control chart


def _density(
    wafers: Sequence[WaferDefects], good: Sequence[Proportion | None]
) -> tuple[float | None, tuple[WaferDensity, ...]]:
    """Return the mean density, and each wafer with its control limits."""
    known = [wafer for wafer in wafers if wafer.inspected_mm2]
    area_mm2 = sum(wafer.inspected_mm2 for wafer in known)
    per_mm2 = sum(len(wafer.defects) for wafer in known) / area_mm2 if area_mm2 else None
    times = Counter(wafer.title for wafer in wafers)
    titles = [one.title if times[one.title] == 1 else f"{one.title} ({one.name})" for one in wafers]
    each = zip(wafers, titles, good, strict=True)
    return per_mm2, tuple(_of_wafer(wafer, title, per_mm2, share) for wafer, title, share in each)


def _of_wafer(wafer: WaferDefects, title: str, per_mm2: float | None, good: Proportion | None) -> WaferDensity:
    n, area_mm2 = len(wafer.defects), wafer.inspected_mm2
    line = WaferDensity(name=wafer.name, title=title, defects=n, inspected_mm2=area_mm2, good=good)
    if per_mm2 is None or not area_mm2:
        return line
    from scipy.stats import poisson

    low, high = (float(poisson.ppf(q, per_mm2 * area_mm2)) if per_mm2 else 0.0 for q in _CONTROL_QUANTILES)
    limits = {"low_per_mm2": low / area_mm2, "high_per_mm2": high / area_mm2}
    side = "above" if n > high else "below" if n < low else ""
    return replace(line, per_mm2=n / area_mm2, outside=side, **limits)


_CONTROL_QUANTILES = (OUT_OF_CONTROL, 1 - OUT_OF_CONTROL)
"""Quantiles of the Poisson distribution at the control limits."""


def _dispersion(lines: Sequence[WaferDensity], per_mm2: float | None) -> tuple[float | None, float | None]:
    """Return the index of dispersion of the numbers of defects, and the probability that chance exceeds it."""
    if not per_mm2 or len(lines) < 2:
        return None, None
    from scipy.stats import chi2

    counts, means = np.array([(line.defects, per_mm2 * line.inspected_mm2) for line in lines]).T
    squares, freedom = float(((counts - means) ** 2 / means).sum()), len(lines) - 1
    return squares / freedom, float(chi2.sf(squares, freedom))


# ------------------------------------------------------------------------------------------------- yield, kill ratio


@dataclass(frozen=True, slots=True)
class _Bins:
    """True for each good and False for each failing die of a wafer, and the source of that."""

    good: dict[Place, bool]
    by: str
    tested: bool = False


def _bins(wafer: WaferDefects, test: WaferMap | None) -> _Bins | None:
    """Return the good and failing dies by test, else by the number of defects; None if neither is known."""
    if test is not None:
        if not wafer.dies:
            raise MeasureError(f"{wafer.title} has no dies, so its test results belong to none: give its dies.")
        qualities = test.on(wafer.dies, wafer.notch)
        inspected = {(die.col, die.row) for die in wafer.inspected_dies}
        judged = {place: die.quality for place, die in qualities.items() if place in inspected}
        return _Bins({at: word == "pass" for at, word in judged.items() if word != "skip"}, BY_TEST, tested=True)
    if wafer.max_per_die is None or not wafer.dies:
        return None
    bins = bins_of(wafer.dies, (d.die for d in wafer.defects), DefectLimits(max_per_die=wafer.max_per_die))
    good = {place: word == "pass" for place, word in bins.items() if word != "not inspected"}
    return _Bins(good, f"at most {wafer.max_per_die} defects on a die")


def _test_of(wafer: WaferDefects, tests: Sequence[WaferMap]) -> WaferMap | None:
    return next((test for test in tests if _is_of(test, wafer)), None)


def _is_of(test: WaferMap, wafer: WaferDefects) -> bool:
    same_lot = not test.lot or not wafer.lot or test.lot == wafer.lot
    return bool(test.wafer) and test.wafer == wafer.wafer and same_lot


def _require_used(tests: Sequence[WaferMap], wafers: Sequence[WaferDefects]) -> None:
    for test in tests:
        if not any(_is_of(test, wafer) for wafer in wafers):
            of = f"of wafer {test.wafer}" if test.wafer else "without a wafer id"
            inspected = "; ".join(wafer.wafer or f"none stated by {wafer.name}" for wafer in wafers)
            raise MeasureError(f"There is a map {of}, and inspected were: {inspected}. Give maps of these wafers.")


def _good(bins: _Bins | None) -> Proportion | None:
    return None if bins is None else proportion(_n_good(bins), len(bins.good))


def _n_good(bins: _Bins) -> int:
    return sum(bins.good.values())


def proportion(n: int, total: int) -> Proportion:
    """Return n of a total with the confidence limits of Clopper and Pearson."""
    from scipy.special import betaincinv

    tail = (1 - CONFIDENCE) / 2
    low = float(betaincinv(n, total - n + 1, tail)) if n else 0.0
    high = float(betaincinv(n + 1, total - n, 1 - tail)) if n < total else 1.0
    return Proportion(n=n, total=total, low=low, high=high)


def _kill_ratios(tested: Sequence[tuple[WaferDefects, dict[Place, bool]]]) -> Iterator[KillRatio]:
    """Yield the kill ratio of each class on tested dies, the one that kills most first."""
    found = [_kill_ratio(kind, tested) for kind in dict.fromkeys(_each((w for w, _ in tested), _NAMED["class"]))]
    yield from sorted((kill for kill in found if kill.failing_with.total), key=lambda kill: -(kill.loss or -math.inf))


def _kill_ratio(kind: str, tested: Sequence[tuple[WaferDefects, dict[Place, bool]]]) -> KillRatio:
    good = {True: 0, False: 0}
    total = {True: 0, False: 0}
    for wafer, bins in tested:
        on = {defect.die for defect in wafer.defects if defect.kind == kind}
        for (col, row), is_good in bins.items():
            has = f"{col},{row}" in on
            total[has] += 1
            good[has] += is_good
    failing = {has: proportion(total[has] - good[has], total[has]) for has in (True, False)}
    numbers: dict[str, Any] = {"kind": kind, "failing_with": failing[True], "failing_without": failing[False]}
    if not total[True] or not good[False]:
        return KillRatio(**numbers, ratio=None)
    ratio = 1 - good[True] / total[True] / (good[False] / total[False])
    low, high = ratio_limits(good[True], total[True], good[False], total[False])
    limits: dict[str, Any] = {"low": None if math.isinf(high) else 1 - high, "high": 1 - low}
    return KillRatio(**numbers, ratio=ratio, loss=ratio * total[True] / (total[True] + total[False]), **limits)


_FARTHEST = 1e9
"""Ratio of two proportions beyond which there is no limit."""


def ratio_limits(n1: int, total1: int, n0: int, total0: int) -> tuple[float, float]:
    """Return the confidence limits of the ratio of two proportions by the score method of Koopman; inf: none."""
    from scipy.optimize import brentq
    from scipy.special import chdtri

    most = float(chdtri(1, 1 - CONFIDENCE))

    def beyond(log_ratio: float) -> float:
        return _score(math.exp(log_ratio), n1, total1, n0, total0) - most

    best = math.log(max(n1, 0.5) / total1 / (max(n0, 0.5) / total0))
    ends = (-math.log(_FARTHEST), math.log(_FARTHEST))
    solve: Callable[..., float] = brentq  # pyright: ignore[reportAssignmentType]
    low = math.exp(solve(beyond, ends[0], best)) if n1 else 0.0
    high = math.exp(solve(beyond, best, ends[1])) if n0 else math.inf
    return low, high


def _score(ratio: float, n1: int, total1: int, n0: int, total0: int) -> float:
    """Return Pearson's chi-squared of two proportions whose ratio is given, at their likeliest values."""
    a, b, c = total1 + total0, ratio * (total1 + n0) + n1 + total0, ratio * (n1 + n0)
    p1 = 2 * c / (b + math.sqrt(max(b * b - 4 * a * c, 0.0)))
    parts = ((n1, total1, p1), (n0, total0, p1 / ratio))
    return sum((n - total * p) ** 2 / (total * p * (1 - p)) for n, total, p in parts if 0 < p < 1)
