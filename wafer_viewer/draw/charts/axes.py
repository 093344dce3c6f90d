"""Axes of charts: limits, ticks, grid lines and labels as SVG and HTML; and symbols with distinct shapes.

Colours are the page's custom properties (``--ink``, ``--line``, ...), so one drawing serves light and dark.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.number_format import number, tick_digits, ticks

# -------------------------------------------------------------------------------------------------------------- symbols


Shape = Callable[[float], str]
"""Function that returns the symbol around (0, 0) for half its width in px."""


def _scaled(path: str, r: float) -> Markup:
    return Markup('<path transform="scale({:g})" d="{}"/>').format(r, path)


def _path(d: str) -> Markup:
    return Markup('<path d="{}"/>').format(d)


SHAPES: dict[str, Shape] = {
    "disc": lambda r: Markup('<circle r="{:g}"/>').format(r),
    "ring": lambda r: Markup('<circle r="{:g}" fill="none" stroke-width="{:g}" stroke="currentColor"/>').format(
        0.8 * r, 0.55 * r
    ),
    "square": lambda r: Markup('<rect x="{x:g}" y="{x:g}" width="{width:g}" height="{width:g}"/>').format(
        x=-0.9 * r, width=1.8 * r
    ),
    "diamond": lambda r: _path(f"M0 {-1.2 * r:g}L{1.2 * r:g} 0L0 {1.2 * r:g}L{-1.2 * r:g} 0Z"),
    "triangle": lambda r: _path(f"M0 {-1.1 * r:g}L{1.15 * r:g} {0.9 * r:g}H{-1.15 * r:g}Z"),
    "bar": lambda r: Markup(
        '<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" transform="rotate(-40)"/>'
    ).format(x=-1.4 * r, y=-0.4 * r, width=2.8 * r, height=0.8 * r),
    "slant": lambda r: _path(
        f"M{-1.3 * r:g} {0.8 * r:g}L{-0.5 * r:g} {-0.8 * r:g}H{1.3 * r:g}L{0.5 * r:g} {0.8 * r:g}Z"
    ),
    "arc": lambda r: _scaled("M-1.3 .7Q0 -1.9 1.3 .7Q0 -.5 -1.3 .7Z", r),
    "half": lambda r: _scaled("M-1 -1H1V1Z", r),
    "frame": lambda r: _scaled("M-1 -1H1V1H-1ZM-.4 -.4V.4H.4V-.4Z", r),
    "link": lambda r: _scaled("M-1 -1H-.4V-.3H.4V-1H1V1H.4V.3H-.4V1H-1Z", r),
    "corner": lambda r: _path(f"M{-r:g} {r:g}V{-r:g}H{0.1 * r:g}V{-0.1 * r:g}H{r:g}V{r:g}Z"),
    "cross": lambda r: Markup(
        '<path d="M{radius:g} {radius:g}L{radius2:g} {radius2:g}M{radius:g} {radius2:g}L{radius2:g} {radius:g}" '
        'stroke-width="{stroke_width:g}" stroke="currentColor"/>'
    ).format(radius=-r, radius2=r, stroke_width=0.5 * r),
}
"""Shapes by name; stroked parts use the text colour."""


def symbol(shape: str, colour: str, x_px: float = 0.0, y_px: float = 0.0, half_px: float = 4.0) -> Markup:
    """Return a symbol at a position of a drawing."""
    return Markup(
        '<g transform="translate({x_px:.1f} {y_px:.1f})" fill="{colour}" color="{colour}">{shapes}</g>'
    ).format(x_px=x_px, y_px=y_px, colour=colour, shapes=SHAPES[shape](half_px))


def symbol_svg(shape: str, colour: str, side_px: int = 14) -> Markup:
    """Return a symbol as a separate drawing, for use in a line of text."""
    half = side_px / 2
    return Markup(
        '<svg width="{side_px}" height="{side_px}" viewBox="{box:g} {box:g} {side_px} {side_px}" '
        'aria-hidden="true" style="vertical-align:-2px">{symbol}</svg>'
    ).format(side_px=side_px, box=-half, symbol=symbol(shape, colour, half_px=0.32 * side_px))


# ----------------------------------------------------------------------------------------------------------------- axes


Floats = NDArray[np.float64]
Ends = tuple[float, float]
Tick = tuple[float, str]
"""Value and label."""
Value = TypeVar("Value", float, Floats)
SIDE = 1000
"""Side of a stretched drawing in its own units."""
_LEAST_RANGE = 1e-12


def round_ticks(ends: Ends, most: int, *, signed: bool = False) -> tuple[Tick, ...]:
    """Return round values between two ends, at most about `most`, labelled with the decimals that they need."""
    values = ticks(*ends, most)
    digits = tick_digits(values)
    return tuple((value, number(value, digits, signed=signed)) for value in values)


@dataclass(frozen=True, slots=True)
class Axis:
    """Linear axis: the values at its low and high end, the positions of these ends in the drawing, and its ticks."""

    ends: Ends
    span: Ends
    ticks: tuple[Tick, ...] = ()

    def at(self, value: Value) -> Value:
        """Return the position of a value in the drawing."""
        low, high = self.ends
        first, last = self.span
        return first + (value - low) / (high - low or _LEAST_RANGE) * (last - first)

    def within(self, value: float) -> float:
        """Return a value clamped to the ends."""
        low, high = sorted(self.ends)
        return min(max(value, low), high)

    def percent(self, value: float) -> float:
        """Return the position of a value from the left or the top of a drawing that starts at 0, in percent."""
        return 100 * self.at(value) / max(self.span)


@dataclass(frozen=True, slots=True)
class ChartAxes:
    """Two axes: x to the right, y upwards. The span of y is its foot and its top, since y grows downwards in SVG."""

    x: Axis
    y: Axis

    @classmethod
    def stretched(
        cls, x: Ends, y: Ends, x_ticks: tuple[Tick, ...], y_ticks: tuple[Tick, ...], side: float = SIDE
    ) -> ChartAxes:
        """Return axes over a whole square drawing, which `plot_html` stretches."""
        return cls(Axis(x, (0, side), x_ticks), Axis(y, (side, 0), y_ticks))

    def level(self, value: float) -> str:
        """Return the path of a horizontal line across the plot."""
        left, right = self.x.span
        return f"M{left:g} {self.y.at(value):.1f}H{right:g}"

    def upright(self, value: float) -> str:
        """Return the path of a vertical line across the plot."""
        foot, top = self.y.span
        return f"M{self.x.at(value):.1f} {top:g}V{foot:g}"

    def grid(self) -> Markup:
        """Return the path of the grid lines."""
        return Markup("").join([*(self.upright(x) for x, _ in self.x.ticks), *(self.level(y) for y, _ in self.y.ticks)])

    def labels_html(self) -> Markup:
        """Return the tick labels, placed in percent beside a stretched drawing."""
        below = (
            Markup('<i class="x" style="left:{:.2f}%">{}</i>').format(self.x.percent(x), text)
            for x, text in self.x.ticks
        )
        row_labels = (
            Markup('<i class="y" style="top:{:.2f}%">{}</i>').format(self.y.percent(y), text)
            for y, text in self.y.ticks
        )
        return Markup("").join([*below, *row_labels])

    def labels_svg(self) -> Markup:
        """Return the tick labels as text elements below and left of the plot."""
        left, foot = self.x.span[0] - 6, self.y.span[0] + 14
        below = (
            Markup('<text x="{:.1f}" y="{:g}" text-anchor="middle">{}</text>').format(self.x.at(x), foot, text)
            for x, text in self.x.ticks
        )
        row_labels = (
            Markup('<text x="{:g}" y="{:.1f}" text-anchor="end">{}</text>').format(left, self.y.at(y) + 4, text)
            for y, text in self.y.ticks
        )
        return Markup("").join([*below, *row_labels])

    def frame(self) -> str:
        """Return the path around the plot."""
        (left, right), (foot, top) = self.x.span, self.y.span
        return f"M{left:g} {top:g}H{right:g}V{foot:g}H{left:g}Z"


def line_svg(d: str, colour: str, width_px: float, more: str = "") -> Markup:
    """Return a path as a line in a colour of the page; `more`: further attributes."""
    return Markup('<path d="{d}" stroke="var(--{colour})" stroke-width="{width_px:g}" {more}/>').format(
        d=d, colour=colour, width_px=width_px, more=more
    )


@dataclass(frozen=True, slots=True)
class PlotLook:
    """Names of a plot and of its axes, its margins in px, and the classes and style of its element."""

    name: str
    y_title: str
    x_title: str = ""
    left_px: int = 50
    right_px: int = 14
    top_px: int = 8
    foot_px: int = 40
    classes: str = ""
    style: str = ""


def plot_html(axes: ChartAxes, look: PlotLook, drawn: str, over: str = "") -> Markup:
    """Return a plot that fills its container.

    Parameters
    ----------
    axes
        Stretched axes, whose grid and labels are drawn.
    look
        Names, margins and classes.
    drawn
        SVG elements over the grid, in the units of the axes.
    over
        HTML over the drawing, placed in percent.
    """
    place = f"left:{look.left_px}px;right:{look.right_px}px;top:{look.top_px}px;bottom:{look.foot_px}px"
    across, down = max(axes.x.span), max(axes.y.span)
    style = Markup(' style="{}"').format(look.style) if look.style else Markup()
    x_title = Markup('<span class="wv-plot-x">{}</span>').format(look.x_title) if look.x_title else Markup()
    return Markup(
        '<div class="{strip}"{style}><div style="position:absolute;{place}">'
        '<svg viewBox="0 0 {across:g} {down:g}" preserveAspectRatio="none" role="img" aria-label="{name}">'
        "{line_svg}{drawn}</svg>{labels_html}{over}</div>"
        '<span class="wv-plot-y">{y_title}</span>{x_title}</div>'
    ).format(
        strip=f"wv-plot {look.classes}".strip(),
        style=style,
        place=place,
        across=across,
        down=down,
        name=look.name,
        line_svg=line_svg(axes.grid(), "line", 1),
        drawn=drawn,
        labels_html=axes.labels_html(),
        over=over,
        y_title=look.y_title,
        x_title=x_title,
    )
