"""Symbols with distinct shapes as well as colours. Pure."""

from __future__ import annotations

from collections.abc import Callable

Shape = Callable[[float], str]
"""Function that returns the symbol around (0, 0) for half its width in px."""


def _path(d: str) -> str:
    return f'<path d="{d}"/>'


SHAPES: dict[str, Shape] = {
    "disc": lambda r: f'<circle r="{r:g}"/>',
    "ring": lambda r: f'<circle r="{0.8 * r:g}" fill="none" stroke-width="{0.55 * r:g}" stroke="currentColor"/>',
    "square": lambda r: f'<rect x="{-0.9 * r:g}" y="{-0.9 * r:g}" width="{1.8 * r:g}" height="{1.8 * r:g}"/>',
    "diamond": lambda r: _path(f"M0 {-1.2 * r:g}L{1.2 * r:g} 0L0 {1.2 * r:g}L{-1.2 * r:g} 0Z"),
    "triangle": lambda r: _path(f"M0 {-1.1 * r:g}L{1.15 * r:g} {0.9 * r:g}H{-1.15 * r:g}Z"),
    "bar": lambda r: (
        f'<rect x="{-1.4 * r:g}" y="{-0.4 * r:g}" width="{2.8 * r:g}" height="{0.8 * r:g}" transform="rotate(-40)"/>'
    ),
    "slant": lambda r: _path(
        f"M{-1.3 * r:g} {0.8 * r:g}L{-0.5 * r:g} {-0.8 * r:g}H{1.3 * r:g}L{0.5 * r:g} {0.8 * r:g}Z"
    ),
    "corner": lambda r: _path(f"M{-r:g} {r:g}V{-r:g}H{0.1 * r:g}V{-0.1 * r:g}H{r:g}V{r:g}Z"),
    "cross": lambda r: (
        f'<path d="M{-r:g} {-r:g}L{r:g} {r:g}M{-r:g} {r:g}L{r:g} {-r:g}" '
        f'stroke-width="{0.5 * r:g}" stroke="currentColor"/>'
    ),
}
"""Shapes by name; stroked parts use the text colour."""


def symbol(shape: str, colour: str, x_px: float = 0.0, y_px: float = 0.0, half_px: float = 4.0) -> str:
    """Return a symbol at a position of a drawing."""
    return (
        f'<g transform="translate({x_px:.1f} {y_px:.1f})" fill="{colour}" color="{colour}">{SHAPES[shape](half_px)}</g>'
    )


def symbol_svg(shape: str, colour: str, side_px: int = 14) -> str:
    """Return a symbol as a separate drawing, for use in a line of text."""
    half = side_px / 2
    return (
        f'<svg width="{side_px}" height="{side_px}" viewBox="{-half:g} {-half:g} {side_px} {side_px}" '
        f'aria-hidden="true" style="vertical-align:-2px">{symbol(shape, colour, half_px=0.32 * side_px)}</svg>'
    )
