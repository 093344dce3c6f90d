"""Profile roughness along a line: height parameters of ISO 21920-2 after Gaussian filters."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, Layer
from wafer_viewer.measure.base.measurement_context import Lines, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import NOISE
from wafer_viewer.measure.texture.areal_texture import SEVEN_POINT
from wafer_viewer.measure.texture.material_ratio import bearing, material_ratio_curve
from wafer_viewer.measure.texture.resolvable_scales import near_noise, unseen_waves
from wafer_viewer.measure.texture.texture_noise import length_lines, noise_notes, noise_of, with_scale
from wafer_viewer.measure.tools.profile import profile, require_straight
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import ProfileCurve, Roughness
from wafer_viewer.model.measurement.tool_options import Borders, RoughnessOptions
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


CUT = "Filter: half its length at each end is not evaluated."


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
    noise_um: float | None = None,
    borders: Borders = "keep",
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
    noise_um : float, optional
        Root mean square noise of the heights in um, as repeats of a flat give it (`calibrate noise`). Default None:
        that of the heights' own uncertainty; where they have none, U is not evaluated.
    borders : {'keep', 'cut'}, optional
        Default 'keep': what the longer filter evaluates over less than its length at the ends counts. 'cut': half of
        its length at each end does not.
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
        Ra, Rq, Rz, Rt, Rp and Rv in um, Rsk and Rku without unit (None for a flat line), Rdq, the slope; RSm and Rc
        in um (None without a complete profile element); Rk, Rpk and Rvk in um, Rmr1 and Rmr2 as fractions, and the
        sampling lengths. With a noise, all lengths have expanded uncertainties (k = 2).

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

    A profile element is a hill and the dale beside it, from one crossing of the mean line to the next but one, in
    either direction. Hills and dales that are lower than 10 % of Rz or narrower than 1 % of a sampling length belong to
    their neighbours; incomplete ones at the ends do not count.

    The notes of the result name waves too short to be resolved and an Rq that may be mostly noise.

    References
    ----------
    .. [1] ISO 21920-2, Surface texture: Profile - Part 2: Terms, definitions and surface texture parameters.
    .. [2] ISO 16610-21, Filtration - Part 21: Linear profile filters: Gaussian filters.
    .. [3] ISO 16610-28, Filtration - Part 28: Profile filters: End effects.
    """
    options = RoughnessOptions(lambda_c_um=lambda_c_um, lambda_s_um=lambda_s_um, noise_um=noise_um, borders=borders)
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    require_straight(line)
    section, curve = profile(surface, line, calibration_valid=calibration_valid, layer=layer)
    pixel_um = _pixel_um(curve)
    evaluated = _evaluated(curve, pixel_um, options)
    left = evaluated.z_um[np.isfinite(evaluated.z_um)]
    rq_um = float(np.sqrt(np.mean(left**2)))
    noise = noise_of(reading, noise_um, curve.x_um, curve.y_um, 0)
    lines = _lines(reading, curve, pixel_um, options, noise) if noise is not None else {}
    flat = rq_um <= ROUNDING * float(np.nanmax(np.abs(curve.z_um)))
    notes = (
        LINE_REMOVED,
        *evaluated.notes,
        *unseen_waves(surface.provenance, pixel_um, lambda_s_um, "lambda-s"),
        *near_noise(surface.provenance, rq_um, "Rq"),
        *noise_notes(reading, noise_um, noise),
        *section.notes,
    )
    return Roughness(
        **{**reading.result_fields(name, 0, *notes), "filter": _filter_names(options, line)},
        line=line,
        options=options,
        **{
            field: reading.length(value_um, lines.get(field))
            for field, value_um in length_parameters(evaluated, pixel_um).items()
        },
        **_ratios(evaluated, pixel_um, left, rq_um, flat),
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
    if cutoff_um is not None:
        z_um = z_um - gaussian_mean(z_um, cutoff_um / pixel_um)
    if options.borders == "cut":
        cut = math.ceil(max(cutoff_um or 0.0, options.lambda_s_um or 0.0) / 2 / pixel_um)
        z_um = z_um[cut : len(z_um) - cut]
        length_um = (len(z_um) - 1) * pixel_um
        _require_room(length_um, options)
    if cutoff_um is None:
        found = Evaluated(z_um - np.nanmean(z_um), 1, length_um, (PRIMARY,))
    else:
        found = _in_sections(z_um, pixel_um, cutoff_um, options.borders == "cut")
    return _require_measured(found)


def _in_sections(z_um: Floats, pixel_um: float, cutoff_um: float, is_cut: bool) -> Evaluated:
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
    if is_cut:
        notes.append(CUT)
    elif spare * pixel_um < 2 * RUN_UP * cutoff_um - pixel_um:
        notes.append(BORDERS)
    return Evaluated(part - np.nanmean(part), sections, cutoff_um, tuple(notes))


def length_parameters(evaluated: Evaluated, pixel_um: float) -> dict[str, float]:
    """Return the parameters of an evaluated profile that are lengths, in um, by the names of their fields."""
    parts, left = list(evaluated.split()), evaluated.z_um[np.isfinite(evaluated.z_um)]
    core = bearing(material_ratio_curve(left))
    highest, lowest = (float(np.mean([extreme(part) for part in parts])) for extreme in (np.max, np.min))
    return {
        "ra": float(np.mean(np.abs(left))),
        "rq": float(np.sqrt(np.mean(left**2))),
        "rz": highest - lowest,
        "rt": float(np.ptp(left)),
        "rp": highest,
        "rv": -lowest,
        "rk": core.sk_um,
        "rpk": core.spk_um,
        "rvk": core.svk_um,
        **element_parameters(evaluated.z_um, pixel_um, highest - lowest, evaluated.section_um),
    }


def _ratios(evaluated: Evaluated, pixel_um: float, left: Floats, rq_um: float, flat: bool) -> dict[str, Any]:
    core = bearing(material_ratio_curve(left))
    return {
        "rsk": None if flat else float(np.mean(left**3)) / rq_um**3,
        "rku": None if flat else float(np.mean(left**4)) / rq_um**4,
        "rdq": root_mean_square_slope(evaluated.z_um, pixel_um),
        "rmr1_fraction": core.smr1,
        "rmr2_fraction": core.smr2,
    }


LEAST_HEIGHT, LEAST_WIDTH = 0.1, 0.01
"""Least height of a hill or dale as a fraction of Rz, and least width as a fraction of the sampling length."""


def element_parameters(z_um: Floats, pixel_um: float, rz_um: float, section_um: float) -> dict[str, float]:
    """Return RSm and Rc in um of the complete profile elements of heights [n] about their mean line; empty without."""
    place = np.flatnonzero(np.isfinite(z_um))
    z = z_um[place]
    starts = _crossings(z, LEAST_HEIGHT * rz_um, LEAST_WIDTH * section_um / pixel_um, place)
    if len(starts) < 3:
        return {}
    before, after = z[starts - 1], z[starts]
    share = before / (before - after)
    at_um = pixel_um * (place[starts - 1] + share * (place[starts] - place[starts - 1]))
    extremes = np.array([_extreme(part) for part in np.split(z, starts)[1:-1]])
    return {
        "rsm": float(np.mean(at_um[2:] - at_um[:-2])),
        "rc": float(np.mean(np.abs(extremes[1:] - extremes[:-1]))),
    }


def _extreme(part: Floats) -> float:
    return float(part[np.argmax(np.abs(part))])


def _crossings(z: Floats, least_um: float, least_px: float, place: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return where hills and dales begin [n], the first point of each but the first one.

    Those that are too low or too narrow belong to the neighbours before them.
    """
    changes = np.flatnonzero(np.diff(np.sign(z)) != 0) + 1
    ends = np.concatenate([[0], changes, [len(z)]])
    kept, sign = list[int](), 0.0
    for first, last in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        wide = place[last - 1] - place[first] + 1 >= least_px
        if not wide or np.abs(z[first:last]).max() < least_um or np.sign(z[first]) in (0.0, sign):
            continue
        if sign:
            kept.append(first)
        sign = float(np.sign(z[first]))
    return np.array(kept, np.intp)


def _lines(
    reading: MeasurementContext, curve: ProfileCurve, pixel_um: float, options: RoughnessOptions, noise_um: float
) -> dict[str, Lines]:
    """Return the budget lines of each length parameter, of all lines as if its width did not average the noise."""

    def evaluate(z_um: Floats) -> dict[str, float]:
        found = length_parameters(_evaluated(replace(curve, z_um=z_um[0]), pixel_um, options), pixel_um)
        return {"rsm": 0.0, "rc": 0.0, **found}

    lines = length_lines(reading, evaluate, curve.z_um[None], pixel_um, noise_um, EXTREMES, SPREAD)
    found = evaluate(curve.z_um[None])
    return {
        **{name: with_scale(reading, found[name], each) for name, each in lines.items()},
        "rsm": {NOISE: lines["rsm"][NOISE], **reading.lateral_lines(found["rsm"])},
    }


EXTREMES = ("rz", "rt", "rp", "rv", "rk", "rpk", "rvk", "rsm", "rc")
"""Parameters that change in proportion to the noise."""
SPREAD = 1.0
"""Standard deviations of a parameter of a single line, added to its bias: tests/measure/texture."""


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
