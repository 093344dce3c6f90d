"""Run chart as HTML: errors of signed checks in order, each with its U, with tolerance and control limits.

Colours are the page's custom properties, so one drawing serves light and dark. Lines are in a stretched SVG, points and
labels are placed over it in percent, so the chart fills its container.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from wafer_viewer.draw.number_format import number, tick_digits, ticks, value_and_u
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import ChartPoint, RunChart

LEFT_PX, RIGHT_PX, TOP_PX, FOOT_PX = 64, 70, 8, 22
MOST_POINTS = 30
"""Number of newest checks that are shown."""
_SIDE = 1000.0
_ROOM = 0.08
"""Margin above and below the extreme values as a share of their range."""
_MOST_Y, _MOST_X, _LABEL_SHARE = 5, 10, 0.115
_DASHES, _DOTS = 'stroke-dasharray="7 5"', 'stroke-dasharray="2 4"'
Attributes = Callable[[ChartPoint], str]
"""Function that returns the HTML attributes of a clickable point."""


def run_chart_html(chart: RunChart, attributes: Attributes = lambda point: "", chosen: str = "") -> str:
    """Return the chart of the newest checks; `chosen`: signing time of the selected check.

    Raises MeasureError for a chart without a point.
    """
    points = chart.points[-MOST_POINTS:]
    if not points:
        raise MeasureError("The run chart has no point: sign a check first.")
    frame, lines = _frame(chart, points), _lines(chart)
    drawn = "".join((_grid(frame, points), *(_level(frame, line) for line in lines), _bars(frame, points)))
    dots = "".join(_dot(frame, k, point, attributes(point), chosen) for k, point in enumerate(points))
    words = f"{_y_words(frame)}{_x_words(frame, points)}{_names(frame, lines)}"
    place = f"left:{LEFT_PX}px;right:{RIGHT_PX}px;top:{TOP_PX}px;bottom:{FOOT_PX}px"
    return (
        f'<div class="wv-plot wv-run"><div style="position:absolute;{place}">'
        f'<svg viewBox="0 0 {_SIDE:g} {_SIDE:g}" preserveAspectRatio="none" role="img" aria-label="Run chart">'
        f"{drawn}{_connecting_line(frame, points)}</svg>{words}{dots}</div>"
        '<span class="wv-plot-y">Error, µm</span></div>'
    )


@dataclass(frozen=True, slots=True)
class _Line:
    """Horizontal line across the chart: level, name and style."""

    um: float
    name: str
    colour: str
    width_px: float
    dashes: str = ""


@dataclass(frozen=True, slots=True)
class _Frame:
    """Limits of the error axis, and number of checks."""

    low_um: float
    high_um: float
    n: int

    def across(self, k: int) -> float:
        """Return the horizontal position of a check, from 0 (left) to 1 (right); a single one is centred."""
        return (k + 0.5) / self.n

    def down(self, um: float) -> float:
        """Return the vertical position of an error, from 0 (top) to 1 (bottom)."""
        return (self.high_um - um) / (self.high_um - self.low_um)

    @property
    def y_ticks(self) -> list[float]:
        """Round errors."""
        return ticks(self.low_um, self.high_um, _MOST_Y)


def _lines(chart: RunChart) -> list[_Line]:
    """Return the lines in order of importance, which gives label priority."""
    lines = [_Line(0.0, "certificate", "ink3", 1.2)]
    if chart.limit_um is not None:
        lines += [_Line(side * chart.limit_um, "limit", "fault", 1.4, _DASHES) for side in (1, -1)]
    if len(chart.points) > 1:
        lines.append(_Line(chart.mean_um, "mean", "accent", 1.2, _DOTS))
    controls = [um for um in (chart.high_um, chart.low_um) if um is not None]
    return lines + [_Line(um, "mean ± 3 s", "attention", 1.1, _DOTS) for um in controls]


def _frame(chart: RunChart, points: Sequence[ChartPoint]) -> _Frame:
    told = [line.um for line in _lines(chart)]
    told += [p.value.value_um + side * (p.value.expanded_um or 0.0) for p in points for side in (-1, 1)]
    low, high = min(told), max(told)
    room = _ROOM * (high - low) or 0.1
    return _Frame(low - room, high + room, len(points))


def _path(d: str, colour: str, width_px: float, more: str = "") -> str:
    return f'<path d="{d}" stroke="var(--{colour})" stroke-width="{width_px:g}" {more}/>'


def _grid(frame: _Frame, points: Sequence[ChartPoint]) -> str:
    along = "".join(f"M0 {_SIDE * frame.down(um):.1f}H{_SIDE:g}" for um in frame.y_ticks)
    up = "".join(f"M{_SIDE * frame.across(k):.1f} 0V{_SIDE:g}" for k, _ in _days(points))
    return _path(along + up, "line", 1)


def _level(frame: _Frame, line: _Line) -> str:
    return _path(f"M0 {_SIDE * frame.down(line.um):.1f}H{_SIDE:g}", line.colour, line.width_px, line.dashes)


def _bars(frame: _Frame, points: Sequence[ChartPoint]) -> str:
    """Return the U of every check as a vertical line through its point."""
    known = [
        (k, p.value.value_um, p.value.expanded_um) for k, p in enumerate(points) if p.value.expanded_um is not None
    ]
    upright = "".join(
        f"M{_SIDE * frame.across(k):.1f} {_SIDE * frame.down(um + u):.1f}V{_SIDE * frame.down(um - u):.1f}"
        for k, um, u in known
    )
    return _path(upright, "ink3", 1.2, 'opacity=".55"') if upright else ""


def _connecting_line(frame: _Frame, points: Sequence[ChartPoint]) -> str:
    """Return the line that connects the checks, without the failed ones."""
    good = [(k, p.value.value_um) for k, p in enumerate(points) if p.verdict != "fail"]
    d = "L".join(f"{_SIDE * frame.across(k):.1f} {_SIDE * frame.down(um):.1f}" for k, um in good)
    return _path(f"M{d}", "accent", 1.6, 'opacity=".75"') if len(good) > 1 else ""


def _dot(frame: _Frame, k: int, point: ChartPoint, attributes: str, chosen: str) -> str:
    at = f"left:{100 * frame.across(k):.2f}%;top:{100 * frame.down(point.value.value_um):.2f}%"
    look = f"{point.verdict.replace(' ', '-')}{' sel' if point.at == chosen else ''}{' breaks' if point.breaks else ''}"
    told = html.escape(_point_title(point), quote=True)
    return f'<u class="wv-dot {look}" style="{at}" title="{told}" aria-label="{told}" {attributes}></u>'


def _point_title(point: ChartPoint) -> str:
    value, u = value_and_u(point.value.value_um, point.value.expanded_um, 3, signed=True)
    with_u = f"{value} ± {u} µm" if point.value.expanded_um is not None else f"{value} µm"
    at = datetime.fromisoformat(point.at)
    return " · ".join((f"{_day(point)} {at:%H:%M}", with_u, point.verdict, *point.breaks))


def _y_words(frame: _Frame) -> str:
    digits = tick_digits(frame.y_ticks)
    return "".join(
        f'<i class="y" style="top:{100 * frame.down(um):.2f}%">{number(um, digits, signed=True)}</i>'
        for um in frame.y_ticks
    )


def _x_words(frame: _Frame, points: Sequence[ChartPoint]) -> str:
    return "".join(f'<i class="x" style="left:{100 * frame.across(k):.2f}%">{day}</i>' for k, day in _days(points))


def _days(points: Sequence[ChartPoint]) -> list[tuple[int, str]]:
    """Return the first check of each day, as far as there is space for labels."""
    days = [_day(point) for point in points]
    first = [(k, day) for k, day in enumerate(days) if k == 0 or day != days[k - 1]]
    named: list[tuple[int, str]] = []
    for k, day in first:
        if not named or k - named[-1][0] >= len(points) / _MOST_X:
            named.append((k, day))
    return named


def _day(point: ChartPoint) -> str:
    at = datetime.fromisoformat(point.at)
    return f"{at.day} {at:%b}"


def _names(frame: _Frame, lines: Sequence[_Line]) -> str:
    """Return the line labels at the right ends; a label without space is omitted."""
    placed: list[float] = []
    words = ""
    for line in lines:
        down = frame.down(line.um)
        if all(abs(down - other) >= _LABEL_SHARE for other in placed):
            placed.append(down)
            words += f'<b class="wv-run-name" style="top:{100 * down:.2f}%;color:var(--{line.colour})">{line.name}</b>'
    return words
