"""Texture of a face: the height, hybrid, functional and spatial parameters of ISO 25178-2."""

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
"""Of the largest height: a surface whose Sq is less is flat, and has neither skewness nor kurtosis nor waves."""
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
    """Parameters of ISO 25178-2 of the measured pixels of a region; unmeasured ones count nowhere.

    form_order: of the polynomial of least squares that is taken off; s_filter_um, l_filter_um: nesting indices of the
    Gaussian filters (ISO 16610-61) against shorter and longer waves, none when left out. First S, then form, then L.

    No uncertainty: what of it is noise is not evaluated. Raises MeasureError when the region is a line, lies outside,
    has fewer than 200 measured points or less than half of its area measured, or is smaller than a filter.
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
    """Sal, Str and Std where there are any, and what to say of them."""
    found = None if flat else spatial(z_um)
    if found is None:
        return {}, () if flat else (NO_DECAY,)
    std = found.direction_deg
    return {
        "sal": reading.length(found.shortest_px * pixel_um, None),
        "str_ratio": found.aspect,
        "std": None if std is None else reading.quantity(std, "deg", None),
    }, () if found.ends else (LONG_LAY,)
