"""Height histogram as HTML that fills its container: bars in the surface colours, ticks in µm. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wafer_viewer.draw.colormaps import table
from wafer_viewer.draw.number_format import number
from wafer_viewer.draw.ticks import tick_digits, ticks
from wafer_viewer.model.surface.clipping import Span

HEIGHT_PX, TICKS_PX = 92, 20
_SIDE = 1000


def histogram_html(
    counts: Sequence[int], ends_um: Span, colours: tuple[str, float, float] | None, within_um: Span | None = None
) -> str:
    """Return the histogram of `counts` in equal bins between `ends_um`, as square roots to show rare heights.

    colours: a colour map and the heights at its ends; None draws all bars grey, like those outside `within_um`.
    """
    root = np.sqrt(np.asarray(counts, float))
    if root.size == 0 or root.max() <= 0:
        return ""
    low, high = ends_um
    n = root.size
    middles = low + (np.arange(n) + 0.5) / n * (high - low)
    bars = "".join(
        f'<rect x="{_SIDE * k / n:.1f}" y="{_SIDE * (1 - s):.0f}" width="{_SIDE / n + 0.6:.1f}" '
        f'height="{_SIDE * s:.0f}" fill="{_fill(z, colours, within_um)}"/>'
        for k, (s, z) in enumerate(zip((0.96 * root / root.max()).tolist(), middles.tolist(), strict=True))
        if s > 0
    )
    return (
        f'<div class="wv-hist" style="height:{HEIGHT_PX + TICKS_PX}px"><svg viewBox="0 0 {_SIDE} {_SIDE}" '
        f'preserveAspectRatio="none" style="height:{HEIGHT_PX}px" role="img" aria-label="Histogram of heights">{bars}'
        f"</svg>{_ticks(low, high)}</div>"
    )


def place_of(z_um: float, ends_um: Span) -> float:
    """Return the position of a height, from 0 (left) to 1 (right), clamped to the ends."""
    low, high = ends_um
    return min(max((z_um - low) / max(high - low, 1e-12), 0.0), 1.0)


def _fill(z_um: float, colours: tuple[str, float, float] | None, within_um: Span | None) -> str:
    if colours is None or (within_um is not None and not within_um[0] <= z_um <= within_um[1]):
        return "var(--ink3)" if colours is None else "var(--line)"
    name, low, high = colours
    red, green, blue = table(name)[round(255 * place_of(z_um, (low, high)))].tolist()
    return f"rgb({red},{green},{blue})"


def _ticks(low: float, high: float) -> str:
    values = ticks(low, high, 6)
    return "".join(
        f'<i style="left:{100 * place_of(v, (low, high)):.2f}%">{number(v, tick_digits(values), signed=v != 0)}</i>'
        for v in values
    )
