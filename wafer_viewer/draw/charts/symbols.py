"""Symbols with distinct shapes as well as colours. Pure."""

from __future__ import annotations

from collections.abc import Callable

from markupsafe import Markup

Shape = Callable[[float], str]
"""Function that returns the symbol around (0, 0) for half its width in px."""


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
