"""Site map as SVG: one cell per site, coloured by its range, hatched if it has none.

Colours of lines and text are the page's custom properties, so one drawing serves light and dark.
"""

from __future__ import annotations

import html

from wafer_viewer.draw.colormaps import table
from wafer_viewer.draw.number_format import THIN, number
from wafer_viewer.model.measurement.site_range import Site, SiteRanges

_WIDTH, _GAP = 360.0, 0.04
"""Width of the drawing in its own units; gap between cells as a share of the cell side."""
_WORDS_FROM = 34.0
"""Cell width from which the range is written in the cell."""
_LEAST_CONTRAST = 128
"""Luma (of 255) below which text on a cell is white."""


def site_map_svg(found: SiteRanges, colours: str = "mako") -> str:
    """Return the lattice with row 0 at the top; each cell has its position and range as a tooltip."""
    side = _WIDTH / found.cols
    height = side * found.site_height_um / found.site_width_um
    low, high = spread_um(found)
    cells = "".join(
        _cell(site, (k % found.cols) * side, (k // found.cols) * height, side, height, _share(site, low, high), colours)
        for k, site in enumerate(found.sites)
    )
    return (
        f'<svg class="wv-sites" viewBox="0 0 {_WIDTH:g} {height * found.rows:.1f}" role="img" '
        f'aria-label="Site ranges"><defs><pattern id="wv-no-range" width="6" height="6" patternUnits="userSpaceOnUse" '
        f'patternTransform="rotate(45)"><path d="M0 0V6" stroke="var(--ink3)" stroke-width="1.4"/></pattern></defs>'
        f"{cells}</svg>"
    )


def spread_um(found: SiteRanges) -> tuple[float, float]:
    """Return the smallest and the largest range of all sites."""
    ranges = [site.range.value_um for site in found.sites if site.range is not None]
    return min(ranges), max(ranges)


def _share(site: Site, low: float, high: float) -> float | None:
    """Return the relative position of a range between the smallest and the largest; None without a range."""
    if site.range is None:
        return None
    return (site.range.value_um - low) / (high - low) if high > low else 0.5


def _cell(site: Site, x: float, y: float, side: float, height: float, share: float | None, colours: str) -> str:
    gap = _GAP * min(side, height)
    fill, ink = _inks(share, colours)
    told = f"{number(site.range.value_um, 3)}{THIN}µm" if site.range is not None else "too little of it is measured"
    where = f"x {number(site.x_um, 1)}, y {number(site.y_um, 1)}"
    box = f'x="{x + gap:.2f}" y="{y + gap:.2f}" width="{side - 2 * gap:.2f}" height="{height - 2 * gap:.2f}"'
    drawn = f'<rect {box} rx="2" fill="{fill}"><title>{html.escape(f"{where}: {told}")}</title></rect>'
    if site.range is None or min(side, 2 * height) < _WORDS_FROM:
        return drawn
    at = f'x="{x + side / 2:.1f}" y="{y + height / 2:.1f}"'
    size = min(12.0, 0.26 * side)
    words = f'{at} fill="{ink}" font-size="{size:.1f}" text-anchor="middle" dominant-baseline="central"'
    return f'{drawn}<text {words} pointer-events="none">{number(site.range.value_um, 2)}</text>'


def _inks(share: float | None, colours: str) -> tuple[str, str]:
    """Return the colours of a cell and of the text on it."""
    if share is None:
        return "url(#wv-no-range)", "var(--ink)"
    r, g, b = (int(v) for v in table(colours)[round(255 * share)])
    return f"rgb({r},{g},{b})", "#fff" if 0.299 * r + 0.587 * g + 0.114 * b < _LEAST_CONTRAST else "#15202B"
