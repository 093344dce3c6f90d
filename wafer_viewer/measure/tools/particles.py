"""Particles and grains that stand out of a face: a table of places, sizes, heights and volumes."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.plane_faces import Area, area_of, lattice_of
from wafer_viewer.measure.base.robust_fit import fit_plane
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.particles import Particle, ParticleOptions, Particles
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

DEVIATIONS = 6.0
"""Robust deviations of the face from its plane over which a height belongs to a particle, unless a height is given."""
SPLIT_SHARE = 0.5
"""Least height of a grain's top over the saddle to its neighbour, in thresholds: lower ones are one grain."""
MOST = 20_000
"""Largest number of particles of a result."""
DEFINITION = (
    "Particles are connected places beyond the threshold about the robust plane of the face. Diameters are of circles "
    "of the same area; an edge is seen as wide as the focus window blurs it."
)
Labels = NDArray[np.intp]


def particles(
    surface: Mosaic,
    region: Region,
    *,
    stand: Literal["above", "below"] = "above",
    over_um: float | None = None,
    split: Literal["none", "tops"] = "none",
    least_um: float | None = None,
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> Particles:
    """Find particles or grains on a face, and measure each.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle, circle or polygon on the face, in stage um. Less than half of it may be covered.
    stand : {'above', 'below'}, optional
        Side of the face's plane. Default 'above'; 'below' finds pits.
    over_um : float, optional
        Height over the plane in um from which a place belongs to a particle. Default None: six robust deviations.
    split : {'none', 'tops'}, optional
        Default 'none': what touches is one particle. 'tops': grains by the watershed of their heights.
    least_um : float, optional
        Smallest equivalent diameter in um. Default None: the focus window, smaller ones are not resolved.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Particles
        Means in um without uncertainty, number, density, covered share, and the table of particles, the largest first.

    Raises
    ------
    MeasureError
        If the region is a line or a point, lies outside the surface, or has less than half of its area measured.
    MeasureError
        If nothing stands out, or more than 20 000 particles do.

    Notes
    -----
    Sizes by projected area and heights as in ISO 9276 and ISO 25178-2; grains are hills after pruning of those whose
    top is less than half of the threshold over the saddle.
    """
    options = ParticleOptions(stand=stand, over_um=over_um, split=split, least_um=least_um)
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "a table of particles")
    rises, scatter_um = _over_plane(area, 1 if stand == "above" else -1)
    threshold_um = over_um if over_um is not None else DEVIATIONS * scatter_um
    smallest_um = least_um if least_um is not None else _window_um(reading)
    labels = _labels(rises, threshold_um, split)
    whole, n_cut = _measured(area, rises, labels, smallest_um)
    if not whole:
        raise MeasureError(
            f"No whole particle of {smallest_um:.3g} um or more stands {threshold_um:.3g} um {stand} the plane: "
            "draw the region larger, or set a lower threshold or size."
        )
    sizes = np.array([particle.diameter_um for particle in whole])
    means = (sizes.mean(), np.median(sizes), np.mean([particle.height_um for particle in whole]))
    mean, median, height = (reading.length(float(value), None) for value in means)
    return Particles(
        **reading.result_fields(name, area.level, DEFINITION),
        region=region,
        options=options,
        mean_diameter=mean,
        median_diameter=median,
        mean_height=height,
        n_particles=len(whole),
        n_cut=n_cut,
        density_per_mm2=len(whole) / area.um2 * 1e6,
        covered_fraction=float(np.count_nonzero(labels) / len(area.points)),
        threshold_um=threshold_um,
        measured_fraction=area.measured_fraction,
        particles=tuple(sorted(whole, key=lambda particle: -particle.area_um2)),
    )


def _over_plane(area: Area, sign: int) -> tuple[Floats, float]:
    """Return heights [row, col] over the robust plane of a face, NaN where unmeasured, and their robust deviation."""
    points = area.points
    plane, fit = fit_plane(points)
    over = points.z_um - np.asarray(plane.at(points.x_um, points.y_um))
    ground = over[fit.inliers]
    scatter_um = MAD_TO_SIGMA * float(np.median(np.abs(ground - np.median(ground))))
    placed = HeightSamples(points.x_um, points.y_um, sign * over)
    return lattice_of(replace(area, points=placed)), scatter_um


def _window_um(reading: MeasurementContext) -> float:
    window = reading.surface.provenance.recipe.window
    return reading.surface.pixel_um * (1 if isinstance(window, str) else window)


def _labels(rises: Floats, threshold_um: float, split: str) -> Labels:
    """Return the number of the particle of each place [row, col]; 0: none."""
    from scipy.ndimage import label
    from skimage.morphology import h_maxima
    from skimage.segmentation import watershed

    beyond = np.nan_to_num(rises, nan=-np.inf) > threshold_um
    connected: Any = label(beyond, np.ones((3, 3)))
    labels, n = connected
    if split == "tops" and n:
        flat = np.where(beyond, rises, 0.0)
        tops: Any = label(h_maxima(flat, SPLIT_SHARE * threshold_um), np.ones((3, 3)))
        labels = watershed(-flat, tops[0], mask=beyond, connectivity=2)
        n = int(labels.max())
    if n > MOST:
        raise MeasureError(f"{n} particles stand out, more than {MOST}: set a higher threshold or a smaller region.")
    return np.asarray(labels, np.intp)


def _measured(area: Area, rises: Floats, labels: Labels, least_um: float) -> tuple[list[Particle], int]:
    """Return the whole particles of a size or more, and the number of those cut or beside unmeasured places."""
    from scipy.ndimage import binary_dilation
    from skimage.measure import regionprops

    pixel_um = area.pixel_um
    left_um, top_um = float(area.points.x_um.min()), float(area.points.y_um.max())
    unknown = np.pad(np.isnan(rises), 1, constant_values=True)
    beside = np.asarray(binary_dilation(unknown, np.ones((3, 3))), bool)[1:-1, 1:-1]
    cut = set(np.unique(labels[beside]).tolist()) - {0}
    found: list[Particle] = []
    n_cut = 0
    regions: list[Any] = regionprops(labels)
    for one in regions:
        if one.equivalent_diameter_area * pixel_um < least_um:
            continue
        if one.label in cut:
            n_cut += 1
            continue
        row, col = map(float, one.centroid)
        heights: Floats = rises[one.slice][np.asarray(one.image, bool)]
        round_px = float(one.perimeter_crofton)
        found.append(
            Particle(
                place=Point(x_um=left_um + col * pixel_um, y_um=top_um - row * pixel_um),
                diameter_um=float(one.equivalent_diameter_area) * pixel_um,
                longest_um=float(one.feret_diameter_max) * pixel_um,
                shortest_um=float(one.axis_minor_length) * pixel_um,
                height_um=float(heights.max()),
                area_um2=float(one.area) * pixel_um**2,
                volume_um3=float(heights.sum()) * pixel_um**2,
                circularity=min(1.0, 4 * math.pi * float(one.area) / round_px**2) if round_px else 1.0,
            )
        )
    return found, n_cut
