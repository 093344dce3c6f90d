"""Front-surface site range: range of heights per site, and the SEMI terms that need more than the front side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np

from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.measure.base.levelled_surface import levelling_of
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.plane_faces import Area, area_of, least_squares_plane
from wafer_viewer.measure.tools.flatness import form_lines, noise_of_form
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Site, SiteRanges
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

INSTEAD = "What one side shows is the front-surface site range, as mounted: measure site-range."
THICKNESS = "of the thickness, and this map has the front side only"
FREE = "of the wafer lying free, between both its sides, and this map has the front side on its chuck"
REFUSED = {
    "ttv": f"TTV is the total variation {THICKNESS}.",
    "gbir": f"GBIR is the range over the back side, {THICKNESS}.",
    "sbir": f"SBIR is the range in a site over the back side, {THICKNESS}.",
    "ltv": f"LTV is the local variation {THICKNESS}.",
    "sfqr": "SFQR holds for a back side drawn flat by an ideal chuck, and this map has the front side as it lay.",
    "esfqr": "ESFQR holds for a back side drawn flat by an ideal chuck, and this map has the front side as it lay.",
    "warp": f"Warp is {FREE}.",
    "bow": f"Bow is {FREE}.",
    "sori": "Sori is of the front side of a wafer lying free, and this one lay on its chuck.",
}
"""SEMI terms that cannot be measured here, with the reason."""
MOST_SITES = 10_000
"""Largest number of sites of a lattice."""
MOST_WITH_U = 400
"""Largest number of sites that all get an uncertainty, which takes up to a quarter of a second each."""
READING_SHARE = 0.2
"""Part of the time in which the heights of all sites are read; in the rest their uncertainties are evaluated."""
QUARTER = 0.25
"""Default size of a site, relative to the region's sides."""
T = TypeVar("T")
Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""
AS_MOUNTED = "Front-surface site range, as mounted: highest over lowest about each site's plane of least squares."
NOISE_WIDENS = "Noise and single false heights widen the range. It is not corrected for them; U covers the noise."
LARGEST_ALONE = f"Of more than {MOST_WITH_U} sites the largest range alone has U."
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
    progress: Progress = silent,
    should_stop: ShouldStop = never,
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
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop; asked between sites.

    Returns
    -------
    SiteRanges
        Range of each site in um, row by row from the top left, and the largest one, with U: noise widens extremes, is
        not taken off, and U covers it. Of more than 400 sites the largest range alone has U. A site with less than half
        of its area or fewer than 200 points measured has no range.

    Raises
    ------
    MeasureError
        If a side of a site is not positive.
    MeasureError
        If no site fits, or more than 10 000 do.
    MeasureError
        If no site has half of its area measured, or the points of a site do not determine its plane.
    MeasureError
        If the work is stopped.

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

    def counted(sites: Sequence[T], from_share: float, to_share: float) -> Iterator[T]:
        for n, each in enumerate(sites):
            if should_stop():
                raise MeasureError("The measurement of the sites was stopped.")
            progress(from_share + (to_share - from_share) * n / len(sites))
            yield each

    areas = [_area(reading, box.without(*within.excluded)) for box in counted(boxes, 0.0, READING_SHARE)]
    ranges_um = [None if area is None else float(np.ptp(least_squares_plane(area.points)[1])) for area in areas]
    measured = [(area, found) for area, found in zip(areas, ranges_um, strict=True) if area and found is not None]
    if not measured:
        raise MeasureError(f"None of {len(boxes)} sites has half of its area measured: choose a region that has.")
    largest = _range(reading, *max(measured, key=lambda site: site[1]))
    few = len(measured) <= MOST_WITH_U
    sites = tuple(
        Site(
            x_um=sum(box.bounds_um[::2]) / 2,
            y_um=sum(box.bounds_um[1::2]) / 2,
            range=None if area is None or found is None else _range(reading, area, found, with_u=few),
            measured_fraction=0.0 if area is None else area.measured_fraction,
        )
        for box, area, found in counted([*zip(boxes, areas, ranges_um, strict=True)], READING_SHARE, 1.0)
    )
    progress(1.0)
    return SiteRanges(
        region=within,
        site_width_um=site_um[0],
        site_height_um=site_um[1],
        rows=rows,
        cols=cols,
        sites=sites,
        largest=largest,
        surface=reading.layer,
        levelling=levelling_of(surface),
        simulated=surface.provenance.simulated,
        notes=(
            *(AS_MOUNTED, NO_OTHER, NOISE_WIDENS),
            *(() if few else (LARGEST_ALONE,)),
            *_left_out(len(sites) - len(measured)),
            *(reading.not_in_budget() if reading.calibrated else ()),
        ),
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


def _area(reading: MeasurementContext, box: Region) -> Area | None:
    """Return the measured points of a site; None where less than half of it is measured."""
    try:
        return area_of(reading, box, "site", "its range")
    except MeasureError:
        return None


def _range(reading: MeasurementContext, area: Area, range_um: float, with_u: bool = True) -> Length:
    noise = noise_of_form(area) if with_u and reading.calibrated else {}
    return reading.length(range_um, form_lines(reading, range_um, noise.get("t")))


def _left_out(n: int) -> tuple[str, ...]:
    return (f"{n} site{'' if n == 1 else 's'} with less than half of the area measured: no range.",) if n else ()
