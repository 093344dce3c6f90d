"""Pareto chart of the defect classes: counts in descending order and cumulative shares. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.charts.symbols import symbol
from wafer_viewer.model.inspection.defect import DefectClass

_ROW_PX, _SIGN_PX, _NAME_PX, _NUMBER_PX = 20, 16, 100, 36


@dataclass(frozen=True, slots=True)
class Bar:
    """One class: count, share of all defects, and cumulative share."""

    kind: DefectClass
    count: int
    share: float
    cumulated: float


def pareto(kinds: Iterable[DefectClass]) -> tuple[Bar, ...]:
    """Return a bar for each class that occurs; classes of equal count are in order of first occurrence."""
    counts, bars, so_far = Counter(kinds), list[Bar](), 0
    total = sum(counts.values())
    for kind, n in counts.most_common():
        so_far += n
        bars.append(Bar(kind, n, n / total, so_far / total))
    return tuple(bars)


def pareto_svg(kinds: Iterable[DefectClass], *, width_px: int = 300) -> str:
    """Return the bars with counts and cumulative shares, for reports."""
    bars = pareto(kinds)
    most = max((bar.count for bar in bars), default=1)
    drawn = "".join(_row(k * _ROW_PX, bar, most, width_px) for k, bar in enumerate(bars))
    label = "Defects by class, the most frequent first; the share of all up to each"
    return (
        f'<svg viewBox="0 0 {width_px} {len(bars) * _ROW_PX}" width="{width_px}" role="img" '
        f'aria-label="{label}">{drawn}</svg>'
    )


def _row(y: int, bar: Bar, most: int, width_px: int) -> str:
    look, length = KINDS[bar.kind], (width_px - _NAME_PX - 2 * _NUMBER_PX) * bar.count / most
    return (
        f"{symbol(look.shape, look.colour, 6, y + 10)}"
        f'<text x="{_SIGN_PX}" y="{y + 14}" font-size="12" fill="var(--ink)">{look.title}</text>'
        f'<rect x="{_NAME_PX}" y="{y + 4}" width="{length:.1f}" height="{_ROW_PX - 8}" fill="{look.colour}"/>'
        f'<text x="{_NAME_PX + length + 6:.1f}" y="{y + 14}" font-size="12" fill="var(--ink)">{bar.count}</text>'
        f'<text x="{width_px}" y="{y + 14}" font-size="12" text-anchor="end" fill="var(--ink3)">'
        f"{100 * bar.cumulated:.0f} %</text>"
    )
