"""Front-surface site range: range of heights per site, and the SEMI terms that need more than the front side."""

from __future__ import annotations

import numpy as np

from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.measure.base.levelled_surface import levelling_of
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.plane_faces import area_of, least_squares_plane
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Site, SiteRanges
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

INSTEAD = "What one side shows is the front-surface site range, as mounted: measure site-range."
THICKNESS = "of the thickness, and this map has the front side only"
FREE = "of the wafer lying free, between both its sides, and this map has the front side on its chuck"
REFUSED = {
    "ttv": f"TTV is the total variation {THICKNESS}.",
    "gbir": f"GBIR is the range over the back side, {THICKNESS}.",
    "sbir": f"SBIR is the range in a site over the back side, {THICKNESS}.",
    "sfqr": "SFQR holds for a back side drawn flat by an ideal chuck, and this map has the front side as it lay.",
    "warp": f"Warp is {FREE}.",
    "bow": f"Bow is {FREE}.",
    "sori": "Sori is of the front side of a wafer lying free, and this one lay on its chuck.",
}
"""SEMI terms that cannot be measured here, with the reason."""
MOST_SITES = 10_000
"""Largest number of sites of a lattice."""
QUARTER = 0.25
"""Default size of a site, relative to the region's sides."""
Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""
AS_MOUNTED = "Front-surface site range, as mounted: highest over lowest about each site's plane of least squares."
NO_OTHER = "The wafer's chuck is in it, its thickness is not: no SFQR, no SBIR."


def refuse(term: str) -> MeasureError:
    """Return the error for a term of `REFUSED`."""
    return MeasureError(f"{REFUSED[term]} {INSTEAD}")


def site_ranges(
    surface: Mosaic,
    site_um: tuple[float, float],
    region: Region | None = None,
    *,
    calibration_valid: bool = True,
    layer: Layer | None = None,
) -> SiteRanges:
    """Measure the range of heights in each site of a lattice.

    The range of a site is the highest minus the lowest height about its least-squares plane.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    site_um : tuple of float
        Width and height of a site, in um.
    region : Region, optional
        Region in stage um whose bounding box holds the lattice. Default None: the entire surface. Complete sites are
        centred in it; the remaining border belongs to none.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.

    Returns
    -------
    SiteRanges
        Range of each site in um, row by row from the top left, and the largest one, without uncertainty: noise widens
        extremes. A site with less than half of its area or fewer than 200 points measured has no range.

    Raises
    ------
    MeasureError
        If a side of a site is not positive.
    MeasureError
        If no site fits, or more than 10 000 do.
    MeasureError
        If no site has half of its area measured, or the points of a site do not determine its plane.

    Notes
    -----
    The result is the front-surface site range, as mounted: the chuck of the wafer is in it, its thickness is not. It is
    neither SFQR nor SBIR of SEMI [1]_: SFQR holds for a back side drawn flat by an ideal chuck, and SBIR is the range
    in a site over the back side.

    References
    ----------
    .. [1] SEMI M1, Specification for Polished Single Crystal Silicon Wafers.
    """
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    within = region or Region.rectangle(*_bounds_um(surface))
    boxes, rows, cols = _lattice(site_um, within.bounds_um)
    sites = tuple(_site(reading, box.without(*within.excluded)) for box in boxes)
    ranges = [site.range for site in sites if site.range is not None]
    if not ranges:
        raise MeasureError(f"None of {len(sites)} sites has half of its area measured: choose a region that has.")
    return SiteRanges(
        region=within,
        site_width_um=site_um[0],
        site_height_um=site_um[1],
        rows=rows,
        cols=cols,
        sites=sites,
        largest=max(ranges, key=lambda length: length.value_um),
        surface=reading.layer,
        levelling=levelling_of(surface),
        simulated=surface.provenance.simulated,
        notes=(AS_MOUNTED, NO_OTHER, *_left_out(len(sites) - len(ranges))),
    )


def sites_of_region(
    surface: Mosaic,
    region: Region,
    *,
    calibration_valid: bool = True,
    width_um: float | None = None,
    height_um: float | None = None,
    layer: Layer | None = None,
) -> SiteRanges:
    """Measure `site_ranges` in a region; default side: a quarter of the region's. Raises the same errors."""
    x0, y0, x1, y1 = region.bounds_um
    site_um = width_um or (x1 - x0) * QUARTER, height_um or (y1 - y0) * QUARTER
    return site_ranges(surface, site_um, region, calibration_valid=calibration_valid, layer=layer)


def _bounds_um(surface: Mosaic) -> Box:
    """Return the outer edges of the surface's pixels."""
    (rows, cols), pixel_um = surface.shape, surface.pixel_um
    left_um, top_um = surface.x0_um - pixel_um / 2, surface.y0_um + pixel_um / 2
    return left_um, top_um - rows * pixel_um, left_um + cols * pixel_um, top_um


def _lattice(site_um: tuple[float, float], bounds_um: Box) -> tuple[list[Region], int, int]:
    (width, height), (x0, y0, x1, y1) = site_um, bounds_um
    if not min(width, height) > 0:
        raise MeasureError(f"A site of {width:g} x {height:g} um has no area: give both sides.")
    cols, rows = int((x1 - x0) / width + 1e-9), int((y1 - y0) / height + 1e-9)
    if not 0 < rows * cols <= MOST_SITES:
        fits = "no site" if rows * cols == 0 else f"{rows * cols} sites, more than {MOST_SITES},"
        raise MeasureError(f"{fits} of {width:g} x {height:g} um fit into {x1 - x0:g} x {y1 - y0:g} um: choose others.")
    left, top = x0 + (x1 - x0 - cols * width) / 2, y1 - (y1 - y0 - rows * height) / 2
    boxes = [
        Region.rectangle(left + c * width, top - (r + 1) * height, left + (c + 1) * width, top - r * height)
        for r in range(rows)
        for c in range(cols)
    ]
    return boxes, rows, cols


def _site(reading: MeasurementContext, box: Region) -> Site:
    x0, y0, x1, y1 = box.bounds_um
    try:
        area = area_of(reading, box, "site", "its range")
    except MeasureError:
        return Site(x_um=(x0 + x1) / 2, y_um=(y0 + y1) / 2, range=None)
    _, left = least_squares_plane(area.points)
    found = reading.length(float(np.ptp(left)), None)
    return Site(x_um=(x0 + x1) / 2, y_um=(y0 + y1) / 2, range=found, measured_fraction=area.measured_fraction)


def _left_out(n: int) -> tuple[str, ...]:
    return (f"{n} site{'' if n == 1 else 's'} with less than half of the area measured: no range.",) if n else ()
