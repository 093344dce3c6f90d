"""Areal texture of a face: height, hybrid, functional and spatial parameters of ISO 25178-2."""

from __future__ import annotations

from typing import Any

import numpy as np

from wafer_viewer.measure.base.area_samples import area_of
from wafer_viewer.measure.base.height_samples import Floats, Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.texture.hybrid_parameters import developed_fraction, root_mean_square_gradient
from wafer_viewer.measure.texture.material_ratio import bearing
from wafer_viewer.measure.texture.resolvable_scales import near_noise, unseen_waves
from wafer_viewer.measure.texture.scale_limited_surface import filter_words, form_notes, lattice_of, scale_limited
from wafer_viewer.measure.texture.spatial_parameters import spatial
from wafer_viewer.model.measurement.texture import Texture
from wafer_viewer.model.measurement.tool_options import TextureOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

ROUNDING = 1e-6
"""Sq relative to the largest height at or below which a surface is flat, without Ssk, Sku and spatial parameters."""
NO_DECAY = "Sal and Str: heights stay alike over half of the region to all sides; draw it larger."
LONG_LAY = "Str is an upper limit: along the lay heights stay alike over half of the region and more."


def texture(
    surface: Mosaic,
    region: Region,
    *,
    form_order: int = 1,
    s_filter_um: float | None = None,
    l_filter_um: float | None = None,
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> Texture:
    """Measure the areal texture of a region by ISO 25178-2.

    Unmeasured pixels are excluded.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle, circle or polygon on the face, in stage um.
    form_order : int, optional
        Order of the least-squares polynomial that is removed as form, 0 to 8: 0 is the mean, 1 a plane. Default 1.
    s_filter_um : float, optional
        Nesting index in um of the Gaussian filter that removes shorter waves. Default None: no filter.
    l_filter_um : float, optional
        Nesting index in um of the Gaussian filter that removes longer waves. Default None: no filter.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Texture
        Height (Sa, Sq, Sp, Sv, Sz in um; Ssk, Sku), hybrid (Sdq, Sdr as a fraction), functional (Sk, Spk, Svk in um;
        Smr1, Smr2 as fractions) and spatial parameters (Sal in um, Str, Std in degrees). Parameters that are not
        defined for this surface are None. Without uncertainty: the contribution of noise is not evaluated.

    Raises
    ------
    MeasureError
        If the region is a line or a point, or lies outside the surface.
    MeasureError
        If the region has fewer than 200 measured points or less than half of its area measured.
    MeasureError
        If the face is smaller than a filter, or its points do not determine the form.
    MeasureError
        If `form_order` is outside its range, a filter is not positive, or `s_filter_um` is not below `l_filter_um`.

    Notes
    -----
    Parameters are those of ISO 25178-2 [1]_, of the scale-limited surface of ISO 25178-3 [2]_. The order of operations
    is S, then form, then L; the Gaussian filters are those of ISO 16610-61 [3]_. At borders and holes their weights are
    scaled to sum one (ISO 16610-28 [4]_, moment criterion of order 0).

    A flat surface has no Ssk, Sku and spatial parameters, and one without a lay no Std. The notes of the result name
    waves too short to be resolved and an Sq that may be mostly noise.

    References
    ----------
    .. [1] ISO 25178-2, Surface texture: Areal - Part 2: Terms, definitions and surface texture parameters.
    .. [2] ISO 25178-3, Surface texture: Areal - Part 3: Specification operators.
    .. [3] ISO 16610-61, Filtration - Part 61: Linear areal filters: Gaussian filters.
    .. [4] ISO 16610-28, Filtration - Part 28: Profile filters: End effects.
    """
    options = TextureOptions(form_order=form_order, s_filter_um=s_filter_um, l_filter_um=l_filter_um)
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "texture")
    z_um = scale_limited(lattice_of(area), area.pixel_um, options)
    left = z_um[np.isfinite(z_um)]
    sq_um = float(np.sqrt(np.mean(left**2)))
    flat = sq_um <= ROUNDING * float(np.abs(area.points.z_um).max())
    waves, told = _spatial(reading, z_um, area.pixel_um, flat)
    notes = (
        *form_notes(options),
        *told,
        *unseen_waves(surface.provenance, area.pixel_um, s_filter_um, "The S-filter"),
        *near_noise(surface.provenance, sq_um, "Sq"),
    )
    return Texture(
        **{**reading.told(name, area.level, *notes), "filter": filter_words(options)},
        region=region,
        options=options,
        **_heights(reading, left, sq_um, flat),
        sdq=root_mean_square_gradient(z_um, area.pixel_um),
        sdr_fraction=developed_fraction(z_um, area.pixel_um),
        **_functional(reading, left),
        **waves,
        points=len(left),
        measured_fraction=area.measured_fraction,
    )


def _heights(reading: MeasurementContext, left: Floats, sq_um: float, flat: bool) -> dict[str, Any]:
    squares, n = left * left, len(left)
    return {
        "sa": reading.length(float(np.mean(np.abs(left))), None),
        "sq": reading.length(sq_um, None),
        "sp": reading.length(float(left.max()), None),
        "sv": reading.length(float(-left.min()), None),
        "sz": reading.length(float(np.ptp(left)), None),
        "ssk": None if flat else float(squares @ left) / n / sq_um**3,
        "sku": None if flat else float(squares @ squares) / n / sq_um**4,
    }


def _functional(reading: MeasurementContext, left: Floats) -> dict[str, Any]:
    found = bearing(left)
    return {
        "sk": reading.length(found.sk_um, None),
        "spk": reading.length(found.spk_um, None),
        "svk": reading.length(found.svk_um, None),
        "smr1_fraction": found.smr1,
        "smr2_fraction": found.smr2,
    }


def _spatial(
    reading: MeasurementContext, z_um: Floats, pixel_um: float, flat: bool
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return Sal, Str and Std where they exist, and notes on them."""
    found = None if flat else spatial(z_um)
    if found is None:
        return {}, () if flat else (NO_DECAY,)
    std = found.direction_deg
    return {
        "sal": reading.length(found.shortest_px * pixel_um, None),
        "str_ratio": found.aspect,
        "std": None if std is None else reading.quantity(std, "deg", None),
    }, () if found.ends else (LONG_LAY,)
