"""Profile roughness along a line: height parameters of ISO 21920-2 after Gaussian filters."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats, Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.texture.areal_texture import SEVEN_POINT, bearing, material_ratio_curve
from wafer_viewer.measure.texture.resolvable_scales import near_noise, unseen_waves
from wafer_viewer.measure.tools.profile import profile
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import ProfileCurve, Roughness
from wafer_viewer.model.measurement.tool_options import RoughnessOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.numerics.filters.gaussian import gaussian_mean

SECTIONS = 5
"""Number of sampling lengths of an evaluation length, each as long as the cut-off."""
RUN_UP = 0.5
"""Run-up of the filter at each end of a long line, in cut-offs."""
LEAST_POINTS = 20
"""Smallest number of measured points of a section."""
LEAST_MEASURED = 0.5
"""Smallest measured fraction of a line."""
ROUNDING = 1e-6
"""Rq relative to the largest height at or below which a line is flat, without skewness and kurtosis."""
LINE_REMOVED = "Form removed: straight line of least squares."
PRIMARY = (
    "No cut-off lambda-c: the primary profile, waviness included, as one section; the norm writes Pa, Pq, Pz, Pt for "
    "Ra, Rq, Rz, Rt."
)
DEFINITIONS = "ISO 21920-2: Ra, Rq, Rt, Rdq, Rk over the whole evaluation length; Rp, Rv, Rz means of its sections."
BORDERS = (
    "Filter at ends and gaps: weights scaled to sum one (ISO 16610-28, moment criterion of order 0); nothing from "
    "beyond the line."
)


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """The evaluation length: heights [n], NaN where unmeasured, its sections, and notes."""

    z_um: Floats
    sections: int
    section_um: float
    notes: tuple[str, ...]

    def split(self) -> Iterator[Floats]:
        """Yield the measured heights of each section."""
        return (part[np.isfinite(part)] for part in np.array_split(self.z_um, self.sections))


def roughness(
    surface: Mosaic,
    line: Region,
    *,
    lambda_c_um: float | None = None,
    lambda_s_um: float | None = None,
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> Roughness:
    """Measure profile roughness along a line by ISO 21920-2.

    The parameters are Ra, Rq, Rz, Rt, Rp, Rv, Rsk, Rku, Rdq and those of Rk. Unmeasured points are excluded.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    line : Region
        Line, in stage um; heights are averaged over its `width_um`.
    lambda_c_um : float, optional
        Cut-off in um of the Gaussian filter that removes longer waves. Default None: no filter.
    lambda_s_um : float, optional
        Cut-off in um of the Gaussian filter that removes shorter waves. Default None: no filter.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Roughness
        Ra, Rq, Rz, Rt, Rp and Rv in um, Rsk and Rku without unit (None for a flat line), Rdq, the slope; Rk, Rpk
        and Rvk in um, Rmr1 and Rmr2 as fractions, and the sampling lengths.
        Without uncertainty: the contribution of noise is not evaluated.

    Raises
    ------
    MeasureError
        If the region is no line, has no length, or lies outside the surface.
    MeasureError
        If the line is measured to less than half, or in fewer than 20 points a section.
    MeasureError
        If the line is shorter than a cut-off.
    MeasureError
        If a cut-off is not positive, or `lambda_s_um` is not below `lambda_c_um`.

    Notes
    -----
    The least-squares straight line is removed first; the Gaussian filters are those of ISO 16610-21 [2]_. At ends and
    gaps their weights are scaled to sum one (ISO 16610-28 [3]_, moment criterion of order 0).

    Sampling lengths are as long as lambda-c: five where the line is long enough, fewer with a note. By ISO 21920-2
    [1]_, Ra, Rq, Rt, Rsk, Rku, Rdq and those of Rk are over the entire evaluation length; Rp, Rv and Rz are means of
    its sections. Without lambda-c the primary profile, waviness included, is evaluated as one section; the standard
    writes Pa, Pq, Pz, Pt for Ra, Rq, Rz, Rt.

    The notes of the result name waves too short to be resolved and an Rq that may be mostly noise.

    References
    ----------
    .. [1] ISO 21920-2, Surface texture: Profile - Part 2: Terms, definitions and surface texture parameters.
    .. [2] ISO 16610-21, Filtration - Part 21: Linear profile filters: Gaussian filters.
    .. [3] ISO 16610-28, Filtration - Part 28: Profile filters: End effects.
    """
    options = RoughnessOptions(lambda_c_um=lambda_c_um, lambda_s_um=lambda_s_um)
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    section, curve = profile(surface, line, calibration_valid=calibration_valid, layer=layer)
    pixel_um = _pixel_um(curve)
    evaluated = _evaluated(curve, pixel_um, options)
    left = evaluated.z_um[np.isfinite(evaluated.z_um)]
    rq_um = float(np.sqrt(np.mean(left**2)))
    flat = rq_um <= ROUNDING * float(np.nanmax(np.abs(curve.z_um)))
    notes = (
        LINE_REMOVED,
        *evaluated.notes,
        *unseen_waves(surface.provenance, pixel_um, lambda_s_um, "lambda-s"),
        *near_noise(surface.provenance, rq_um, "Rq"),
        *section.notes,
    )
    return Roughness(
        **{**reading.result_fields(name, 0, *notes), "filter": _filter_names(options, line)},
        line=line,
        options=options,
        **_heights(reading, evaluated, pixel_um, left, rq_um, flat),
        sections=evaluated.sections,
        section_um=evaluated.section_um,
        points=len(left),
        measured_fraction=len(left) / len(evaluated.z_um),
    )


def _evaluated(curve: ProfileCurve, pixel_um: float, options: RoughnessOptions) -> Evaluated:
    """Remove the line, the shortest and the longest waves from a profile, and return its evaluated part."""
    length_um = float(curve.distance_um[-1])
    _require_room(length_um, options)
    z_um = _without_line(curve)
    if options.lambda_s_um is not None:
        z_um = gaussian_mean(z_um, options.lambda_s_um / pixel_um)
    cutoff_um = options.lambda_c_um
    if cutoff_um is None:
        found = Evaluated(z_um - np.nanmean(z_um), 1, length_um, (PRIMARY,))
    else:
        found = _in_sections(z_um - gaussian_mean(z_um, cutoff_um / pixel_um), pixel_um, cutoff_um)
    return _require_measured(found)


def _in_sections(z_um: Floats, pixel_um: float, cutoff_um: float) -> Evaluated:
    """Return the central part of a filtered line, five cut-offs long or as many complete ones as fit."""
    length_um = (len(z_um) - 1) * pixel_um
    sections = min(SECTIONS, math.floor(length_um / cutoff_um + 1e-9))
    spare = len(z_um) - min(len(z_um), round(sections * cutoff_um / pixel_um))
    part = z_um[spare // 2 : len(z_um) - (spare - spare // 2)]
    notes = [DEFINITIONS]
    if sections < SECTIONS:
        notes.append(
            f"{sections} of {SECTIONS} sampling lengths: the line is {length_um:.4g} um long and five are "
            f"{SECTIONS * cutoff_um:g} um."
        )
    if spare * pixel_um < 2 * RUN_UP * cutoff_um - pixel_um:
        notes.append(BORDERS)
    return Evaluated(part - np.nanmean(part), sections, cutoff_um, tuple(notes))


def _heights(
    reading: MeasurementContext, evaluated: Evaluated, pixel_um: float, left: Floats, rq_um: float, flat: bool
) -> dict[str, Any]:
    parts, core = list(evaluated.split()), bearing(material_ratio_curve(left))
    heights = {"rk": core.sk_um, "rpk": core.spk_um, "rvk": core.svk_um}
    highest, lowest = (float(np.mean([extreme(part) for part in parts])) for extreme in (np.max, np.min))
    return {
        "ra": reading.length(float(np.mean(np.abs(left))), None),
        "rq": reading.length(rq_um, None),
        "rz": reading.length(highest - lowest, None),
        "rt": reading.length(float(np.ptp(left)), None),
        "rp": reading.length(highest, None),
        "rv": reading.length(-lowest, None),
        "rsk": None if flat else float(np.mean(left**3)) / rq_um**3,
        "rku": None if flat else float(np.mean(left**4)) / rq_um**4,
        "rdq": root_mean_square_slope(evaluated.z_um, pixel_um),
        **{name: reading.length(value_um, None) for name, value_um in heights.items()},
        "rmr1_fraction": core.smr1,
        "rmr2_fraction": core.smr2,
    }


def root_mean_square_slope(z_um: Floats, pixel_um: float) -> float | None:
    """Return Rdq of heights [n] by slopes through seven points; None where there are never as many."""
    if len(z_um) < len(SEVEN_POINT):
        return None
    slopes = np.lib.stride_tricks.sliding_window_view(z_um, len(SEVEN_POINT)) @ SEVEN_POINT / pixel_um
    known = slopes[np.isfinite(slopes)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _without_line(curve: ProfileCurve) -> Floats:
    finite = np.isfinite(curve.z_um)
    from_middle = curve.distance_um - curve.distance_um[finite].mean()
    z_um = curve.z_um - curve.z_um[finite].mean()
    slope = float(from_middle[finite] @ z_um[finite] / (from_middle[finite] @ from_middle[finite]))
    return z_um - slope * from_middle


def _require_room(length_um: float, options: RoughnessOptions) -> None:
    for name, cutoff_um in (("lambda-c", options.lambda_c_um), ("lambda-s", options.lambda_s_um)):
        if cutoff_um is not None and cutoff_um > length_um * (1 + 1e-9):
            raise MeasureError(
                f"{name} of {cutoff_um:g} um is longer than the line, {length_um:.4g} um: draw it longer or take a "
                "shorter cut-off."
            )


def _require_measured(found: Evaluated) -> Evaluated:
    share = float(np.mean(np.isfinite(found.z_um)))
    if share < LEAST_MEASURED:
        raise MeasureError(
            f"Only {100 * share:.0f} % of the line is measured and roughness needs {100 * LEAST_MEASURED:.0f} %: "
            "draw it where the surface has fewer holes."
        )
    if (fewest := min(len(part) for part in found.split())) < LEAST_POINTS:
        raise MeasureError(
            f"A section of the line, {found.section_um:.4g} um, has {fewest} measured points and roughness needs "
            f"{LEAST_POINTS}: take a longer cut-off or draw the line elsewhere."
        )
    return found


def _pixel_um(curve: ProfileCurve) -> float:
    return float(curve.distance_um[-1]) / (len(curve.distance_um) - 1)


def _filter_names(options: RoughnessOptions, line: Region) -> str:
    named = (("lambda-s", options.lambda_s_um), ("lambda-c", options.lambda_c_um))
    cutoffs = [f"{name} {cutoff_um:g} um" for name, cutoff_um in named if cutoff_um is not None]
    names = [f"Gaussian (ISO 16610-21), {', '.join(cutoffs)}"] if cutoffs else []
    if line.width_um:
        names.append(f"mean over {line.width_um:g} um across the line")
    return ", ".join(names) or "none"
