"""History of a characteristic as HTML: its signed values in order, each with its U."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import Axes, PlotLook, Tick, line_svg, plot_html, round_ticks

MOST_POINTS = 30
"""Number of newest values that are shown."""
_ROOM, _MOST_Y, _MOST_X = 0.08, 5, 8
"""Margin above and below the extreme values as a share of their range, and most labels."""


@dataclass(frozen=True, slots=True)
class HistoryPoint:
    """Value with its U, its day as the label of the axis, and a sentence as its title."""

    value: float
    expanded: float
    day: str
    title: str


def history_chart_html(points: Sequence[HistoryPoint], name: str, quantity: str) -> Markup:
    """Return the chart of the newest values; quantity: title of the value axis, with its unit."""
    points = points[-MOST_POINTS:]
    axes = _axes(points)
    uncertainties = "".join(
        f"M{axes.x.at(k):.1f} {axes.y.at(p.value + p.expanded):.1f}V{axes.y.at(p.value - p.expanded):.1f}"
        for k, p in enumerate(points)
    )
    course = "L".join(f"{axes.x.at(k):.1f} {axes.y.at(p.value):.1f}" for k, p in enumerate(points))
    drawn = line_svg(uncertainties, "ink3", 1.6) + line_svg(f"M{course}", "accent", 1.6, Markup('opacity=".75"'))
    dots = Markup("").join(
        Markup('<u class="wv-dot still" style="left:{:.2f}%;top:{:.2f}%" title="{}"></u>').format(
            axes.x.percent(k), axes.y.percent(p.value), p.title
        )
        for k, p in enumerate(points)
    )
    look = PlotLook(name, quantity, left_px=78, right_px=24, foot_px=22, classes="wv-run")
    return plot_html(axes, look, drawn, dots)


def _axes(points: Sequence[HistoryPoint]) -> Axes:
    """Return the axes: values over the number of the calibration, each in the middle of its interval."""
    ends = [p.value + side * p.expanded for p in points for side in (-1, 1)]
    low, high = min(ends), max(ends)
    room = _ROOM * (high - low) or 0.1 * abs(high) or 0.1
    limits = low - room, high + room
    every = -(-len(points) // _MOST_X)
    days: tuple[Tick, ...] = tuple((k, p.day) for k, p in enumerate(points) if k % every == 0)
    return Axes.stretched((-0.5, len(points) - 0.5), limits, days, round_ticks(limits, _MOST_Y))
