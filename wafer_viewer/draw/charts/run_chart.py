"""Charts of signed values in order as HTML: the run chart of the checks, and the history of a characteristic.

Lines are in a stretched SVG, points and labels are placed over it in percent, so the chart fills its container.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import ChartAxes, PlotLook, Tick, line_svg, plot_html, round_ticks
from wafer_viewer.draw.number_format import value_and_u
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import ChartPoint, RunChart

MOST_POINTS = 30
"""Number of newest values that are shown."""
_ROOM = 0.08
"""Margin above and below the extreme values as a share of their range."""
_MOST_Y, _MOST_X, _LABEL_PERCENT = 5, 10, 11.5
_LOOK = PlotLook("Run chart", "Error, µm", left_px=64, right_px=70, foot_px=22, classes="wv-run")
_DASHES, _DOTS = Markup('stroke-dasharray="7 5"'), Markup('stroke-dasharray="2 4"')
Attributes = Callable[[ChartPoint], str]
"""Function that returns the HTML attributes of a clickable point."""


def run_chart_html(chart: RunChart, attributes: Attributes = lambda point: "", chosen: str = "") -> Markup:
    """Return the chart of the newest checks; `chosen`: signing time of the selected check.

    Raises MeasureError for a chart without a point.
    """
    points = chart.points[-MOST_POINTS:]
    if not points:
        raise MeasureError("The run chart has no point: sign a check first.")
    axes, lines = _axes(chart, points), _lines(chart)
    drawn = Markup("").join(
        (*(_level(axes, line) for line in lines), _bars(axes, points), _connecting_line(axes, points))
    )
    dots = Markup("").join(_dot(axes, k, point, attributes(point), chosen) for k, point in enumerate(points))
    return plot_html(axes, _LOOK, drawn, _names(axes, lines) + dots)


@dataclass(frozen=True, slots=True)
class _Line:
    """Horizontal line across the chart: level, name and style."""

    um: float
    name: str
    colour: str
    width_px: float
    dashes: str = ""


def _lines(chart: RunChart) -> list[_Line]:
    """Return the lines in order of importance, which gives label priority."""
    lines = [_Line(0.0, "certificate", "ink3", 1.2)]
    if chart.limit_um is not None:
        lines += [_Line(side * chart.limit_um, "limit", "fault", 1.4, _DASHES) for side in (1, -1)]
    if len(chart.points) > 1:
        lines.append(_Line(chart.mean_um, "mean", "accent", 1.2, _DOTS))
    controls = [um for um in (chart.high_um, chart.low_um) if um is not None]
    return lines + [_Line(um, "mean ± 3 s", "attention", 1.1, _DOTS) for um in controls]


def _axes(chart: RunChart, points: Sequence[ChartPoint]) -> ChartAxes:
    """Return the axes: errors over the number of the check, each in the middle of its interval."""
    values = [line.um for line in _lines(chart)]
    values += [p.value.value_um + side * (p.value.expanded_um or 0.0) for p in points for side in (-1, 1)]
    low, high = min(values), max(values)
    room = _ROOM * (high - low) or 0.1
    ends_um = low - room, high + room
    return ChartAxes.stretched(
        (-0.5, len(points) - 0.5), ends_um, _days(points), round_ticks(ends_um, _MOST_Y, signed=True)
    )


def _level(axes: ChartAxes, line: _Line) -> Markup:
    return line_svg(axes.level(line.um), line.colour, line.width_px, line.dashes)


def _bars(axes: ChartAxes, points: Sequence[ChartPoint]) -> Markup:
    """Return the U of every check as a vertical line through its point."""
    measured = [
        (k, p.value.value_um, p.value.expanded_um) for k, p in enumerate(points) if p.value.expanded_um is not None
    ]
    upright = "".join(f"M{axes.x.at(k):.1f} {axes.y.at(um + u):.1f}V{axes.y.at(um - u):.1f}" for k, um, u in measured)
    return line_svg(upright, "ink3", 1.2, Markup('opacity=".55"')) if upright else Markup()


def _connecting_line(axes: ChartAxes, points: Sequence[ChartPoint]) -> Markup:
    """Return the line that connects the checks, without the failed ones."""
    good = [(k, p.value.value_um) for k, p in enumerate(points) if p.verdict != "fail"]
    d = "L".join(f"{axes.x.at(k):.1f} {axes.y.at(um):.1f}" for k, um in good)
    return line_svg(f"M{d}", "accent", 1.6, Markup('opacity=".75"')) if len(good) > 1 else Markup()


def _dot(axes: ChartAxes, k: int, point: ChartPoint, attributes: str, chosen: str) -> Markup:
    position = f"left:{axes.x.percent(k):.2f}%;top:{axes.y.percent(point.value.value_um):.2f}%"
    look = f"{point.verdict.replace(' ', '-')}{' sel' if point.at == chosen else ''}{' breaks' if point.breaks else ''}"
    title = _point_title(point)
    return Markup(
        '<u class="wv-dot {look}" style="{position}" title="{title}" aria-label="{title}" {attributes}></u>'
    ).format(look=look, position=position, title=title, attributes=attributes)


def _point_title(point: ChartPoint) -> str:
    value, u = value_and_u(point.value.value_um, point.value.expanded_um, 3, signed=True)
    with_u = f"{value} ± {u} µm" if point.value.expanded_um is not None else f"{value} µm"
    moment = datetime.fromisoformat(point.at)
    return " · ".join((f"{_day(point)} {moment:%H:%M}", with_u, point.verdict, *point.breaks))


def _days(points: Sequence[ChartPoint]) -> tuple[Tick, ...]:
    """Return the first check of each day, as far as there is space for labels."""
    days = [_day(point) for point in points]
    first = [(k, day) for k, day in enumerate(days) if k == 0 or day != days[k - 1]]
    named: list[Tick] = []
    for k, day in first:
        if not named or k - named[-1][0] >= len(points) / _MOST_X:
            named.append((k, day))
    return tuple(named)


def _day(point: ChartPoint) -> str:
    moment = datetime.fromisoformat(point.at)
    return f"{moment.day} {moment:%b}"


def _names(axes: ChartAxes, lines: Sequence[_Line]) -> str:
    """Return the line labels at the right ends; a label without space is omitted."""
    placed: list[float] = []
    words = ""
    for line in lines:
        down = axes.y.percent(line.um)
        if all(abs(down - other) >= _LABEL_PERCENT for other in placed):
            placed.append(down)
            words += Markup('<b class="wv-run-name" style="top:{:.2f}%;color:var(--{})">{}</b>').format(
                down, line.colour, line.name
            )
    return words


_MOST_DAYS = 8
"""Most days that are named."""


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
    axes = _history_axes(points)
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


def _history_axes(points: Sequence[HistoryPoint]) -> ChartAxes:
    """Return the axes: values over the number of the calibration, each in the middle of its interval."""
    ends = [p.value + side * p.expanded for p in points for side in (-1, 1)]
    low, high = min(ends), max(ends)
    room = _ROOM * (high - low) or 0.1 * abs(high) or 0.1
    limits = low - room, high + room
    every = -(-len(points) // _MOST_DAYS)
    days: tuple[Tick, ...] = tuple((k, p.day) for k, p in enumerate(points) if k % every == 0)
    return ChartAxes.stretched((-0.5, len(points) - 0.5), limits, days, round_ticks(limits, _MOST_Y))
