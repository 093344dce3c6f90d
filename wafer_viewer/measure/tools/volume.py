"""Area and volume above and below a plane within a region.

The plane goes through the border of the region, or is the zero of the heights. Noise alone would raise half of a flat
region above the plane: pixels within three deviations of it count as area on neither side, and their total volume
counts on the side with more volume. The difference of the volumes is therefore that of all pixels, which noise does not
bias.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.error_covariance import WeightedHeights
from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer
from wafer_viewer.measure.base.levelled_surface import levelling_of
from wafer_viewer.measure.base.measurement_context import PIXEL_SCALE, Lines, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import BIAS_SHARE, noise_um, pixel_noise_um
from wafer_viewer.measure.base.plane_faces import Area, Face, area_of, face_of, lattice_of
from wafer_viewer.measure.base.robust_fit import plane_design
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import AreaVolume
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.height_map import Mosaic

BORDER = 0.08
"""Width of the border, in sides of a square with the area of the region."""
LEAST_BORDER_PX = 2.0
"""Smallest width of the border, px."""
MIN_BORDER_POINTS = 100
"""Smallest number of measured points of the border."""
NOISE_DEVIATIONS = 3.0
"""Distance from the plane that is noise, in standard deviations of the border."""
UNMEASURED = "unmeasured part of the region"
Reference = Literal["border", "zero"]
REFERENCES: dict[Reference, str] = {
    "border": "Reference: the plane through the border of the region.",
    "zero": "Reference: the zero that heights are read from. How sure it is is not known, so volumes have no U.",
}


def area_volume(
    surface: Mosaic,
    region: Region,
    *,
    reference: Reference | None = None,
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> AreaVolume:
    """Measure volumes, areas and extreme heights above and below a plane.

    Unmeasured pixels are excluded; what they would add is in the uncertainty of the volumes. Areas are projected
    along z.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle, circle or polygon, in stage um.
    reference : {'border', 'zero'}, optional
        Reference of the heights: the plane through the border of the region, or the zero of the heights. Default None:
        the zero where the surface is levelled, else the border.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    AreaVolume
        Volumes above and below the plane in um3, projected areas in um2, and highest and lowest height in um. Volumes
        over the border have an expanded uncertainty (k = 2). Volumes over the zero have none, because the uncertainty
        of the zero is unknown. The area of the measured pixels has an expanded uncertainty; the areas above and below
        and the extreme heights have none.

    Raises
    ------
    MeasureError
        If the region is a line or a point, or lies outside the surface.
    MeasureError
        If the region has fewer than 200 measured points or less than half of its area measured.
    MeasureError
        If the border of the region has fewer than 100 measured points, or its points do not determine a plane.

    Notes
    -----
    The border is 8 % of the side of a square with the area of the region wide, at least two pixels.

    Noise alone would raise half of a flat region above the plane. Pixels within three deviations of the border about
    its plane count as area on neither side, and their total volume counts on the side with more volume. The difference
    of the volumes is therefore that of all pixels, which noise does not bias.

    The volume is not corrected for unmeasured pixels. The budget has three quarters of what they would add if they were
    as high as the nearest measured ones, so that the expanded uncertainty covers one and a half of it.
    """
    require_choice("reference", reference, Reference | None, MeasureError)
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "region", "a volume")
    from_where = reference or ("border" if levelling_of(surface).by == "stage" else "zero")
    border = _border(reading, area, region)
    within_um = NOISE_DEVIATIONS * border.sq_um
    zero = np.asarray(border.plane.at(area.points.x_um, area.points.y_um)) if from_where == "border" else 0.0
    over = area.points.z_um - zero
    noise_um3 = _noise_um3(reading, border, area) if from_where == "border" else None
    hidden = _hidden(area, region, over)
    above, below = (_side(reading, area, sign * over, sign * hidden, within_um, noise_um3) for sign in (1, -1))
    return AreaVolume(
        **reading.result_fields(name, area.level, REFERENCES[from_where], *border.notes, *reading.not_in_budget()),
        region=region,
        reference=from_where,
        volume_above=above.volume,
        volume_below=below.volume,
        area_above=above.area,
        area_below=below.area,
        area=reading.quantity(area.um2, "um2", {PIXEL_SCALE: 2 * reading.u_pixel_scale * area.um2}),
        highest=reading.length(float(over.max()), None),
        lowest=reading.length(float(over.min()), None),
        noise_um=within_um,
        measured_fraction=area.measured_fraction,
    )


def _border(reading: MeasurementContext, area: Area, region: Region) -> Face:
    """Fit the face along a region's outline. Raises MeasureError with too few points."""
    width_um = max(LEAST_BORDER_PX * area.pixel_um, BORDER * math.sqrt(region.area_um2))
    points = area.points.select(_from_outline_um(region, area.points) <= width_um)
    if len(points) < MIN_BORDER_POINTS:
        raise MeasureError(
            f"Along its border the region has {len(points)} measured points and a volume needs at least "
            f"{MIN_BORDER_POINTS}: draw it so that its border lies on measured ground."
        )
    return face_of(reading, area.level, points)


def _noise_um3(reading: MeasurementContext, border: Face, area: Area) -> Scatter:
    """Return the uncertainty of the volume: that of all heights less that of the plane under them."""
    pixel_um2, n = area.pixel_um**2, len(area.points)
    gradient = plane_design(area.points, (border.plane.x_um, border.plane.y_um)).sum(axis=0)
    plane = WeightedHeights.of_fit(border.points, border.design, gradient)
    whole = WeightedHeights.of(area.points, np.ones(n))
    over = WeightedHeights.joined((whole, plane.times(-1.0)))
    of_pixels_um = 0.0 if area.level else pixel_noise_um(reading, over)
    return noise_um(border.errors.scatter(over), of_pixels_um).times(pixel_um2)


def _hidden(area: Area, region: Region, over: Floats) -> Floats:
    """Return the heights over the plane that unmeasured pixels of a region have if they are as high as the nearest."""
    from scipy.ndimage import distance_transform_edt

    points = area.points
    z_um = lattice_of(dataclasses.replace(area, points=HeightSamples(points.x_um, points.y_um, over)))
    rows, cols = np.nonzero(np.isnan(z_um))
    x_um, y_um = points.x_um.min() + cols * area.pixel_um, points.y_um.max() - rows * area.pixel_um
    inside = region.contains(x_um, y_um)
    if not inside.any():
        return np.zeros(0)
    nearest = np.asarray(distance_transform_edt(np.isnan(z_um), return_distances=False, return_indices=True))
    return z_um[tuple(nearest[:, rows[inside], cols[inside]])]


def _from_outline_um(region: Region, points: HeightSamples) -> Floats:
    """Return the distances of points inside a region from its outline."""
    if region.kind == "circle":
        center = region.points[0]
        return region.radius_um - np.hypot(points.x_um - center.x_um, points.y_um - center.y_um)
    corners = [(p.x_um, p.y_um) for p in region.points]
    if region.kind == "rectangle":
        x0, y0, x1, y1 = region.bounds_um
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    nearest = np.full(len(points), np.inf)
    for start, end in zip(corners, (*corners[1:], corners[0]), strict=True):
        nearest = np.minimum(nearest, _from_side_um(points, start, end))
    return nearest


def _from_side_um(points: HeightSamples, start: tuple[float, float], end: tuple[float, float]) -> Floats:
    """Return the distances of points from a straight side."""
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    x, y = points.x_um - start[0], points.y_um - start[1]
    length2 = along_x**2 + along_y**2
    along = np.clip((x * along_x + y * along_y) / length2, 0.0, 1.0) if length2 else np.zeros(len(points))
    return np.hypot(x - along * along_x, y - along * along_y)


@dataclass(frozen=True, slots=True)
class VolumeSide:
    """Volume and area on one side of the plane."""

    volume: Quantity
    area: Quantity


def _side(
    reading: MeasurementContext, area: Area, rises: Floats, hidden: Floats, within_um: float, noise_um3: Scatter | None
) -> VolumeSide:
    """Return volume and area where `rises` are positive; pixels within the noise count on the larger side.

    hidden: rises of the unmeasured pixels, which count in the uncertainty only.
    """
    beyond, pixel_um2 = rises > within_um, area.pixel_um**2
    beyond_um3, opposite_um3 = float(rises[beyond].sum()), -float(rises[rises < -within_um].sum())
    within = float(rises[np.abs(rises) <= within_um].sum()) if beyond_um3 >= opposite_um3 else 0.0
    um2, um3 = float(np.count_nonzero(beyond)) * pixel_um2, max(0.0, beyond_um3 + within) * pixel_um2
    hidden_um3 = float(hidden[hidden > within_um].sum()) * pixel_um2
    volume = reading.quantity(um3, "um3", _lines(reading, um3, um2, hidden_um3, noise_um3))
    return VolumeSide(volume, reading.quantity(um2, "um2", None))


def _lines(
    reading: MeasurementContext, um3: float, um2: float, hidden_um3: float, noise_um3: Scatter | None
) -> Lines | None:
    if noise_um3 is None:
        return None
    return {
        "z scale": reading.u_z_scale * um3,
        PIXEL_SCALE: 2 * reading.u_pixel_scale * um3,
        "noise and form of the border": noise_um3,
        **({UNMEASURED: BIAS_SHARE * hidden_um3} if hidden_um3 > 0 else {}),
        **reading.frame_lines(um2),
    }
