"""HTML of front-surface site ranges, as mounted: coloured map and table. Pure functions."""

from __future__ import annotations

from wafer_viewer.draw.charts.site_map import site_map_svg, spread_um
from wafer_viewer.draw.colormaps import css_gradient
from wafer_viewer.draw.number_format import THIN, number, share
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.measurement.site_range import Site, SiteRanges

MOST_ROWS = 12
"""Number of sites listed, the largest ranges first; the map shows all."""


def sites(found: SiteRanges) -> str:
    """Return the map with its colour scale, and the table of the largest ranges."""
    n, known = len(found.sites), [site for site in found.sites if site.range is not None]
    size = f"{number(found.site_width_um, 1)} × {number(found.site_height_um, 1)}{THIN}µm"
    pairs = [("Sites, columns × rows", f"{found.cols} × {found.rows}"), ("Size of a site", size)]
    if len(known) < n:
        pairs.append(("Without a range", f"{n - len(known)} of {n}"))
    return html.pairs(pairs) + site_map_svg(found) + _scale(found) + _table(known)


def _scale(found: SiteRanges) -> str:
    low, high = (f"{number(um, 2)}{THIN}µm" for um in spread_um(found))
    gradient = css_gradient("mako").replace("to top", "to right")
    return (
        f'<div class="wv-site-scale"><span>{low}</span><i style="background:{gradient}"></i><span>{high}</span></div>'
    )


def _table(known: list[Site]) -> str:
    largest = sorted(known, key=lambda site: -(site.range.value_um if site.range else 0.0))[:MOST_ROWS]
    more = f"the largest {len(largest)} of {len(known)}" if len(largest) < len(known) else ""
    return html.head("Range of each site", more) + html.table(
        ["Middle x, y", "Measured", "Range"], [_row(site) for site in largest], " nn"
    )


def _row(site: Site) -> str:
    where = f"{number(site.x_um, 1)}, {number(site.y_um, 1)}"
    value = number(site.range.value_um, 3) if site.range is not None else ""
    return html.row([where, share(site.measured_fraction), value], " nn")
