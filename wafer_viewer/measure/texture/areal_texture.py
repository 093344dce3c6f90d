"""Areal texture of a face: height, hybrid, functional and spatial parameters of ISO 25178-2."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats, Layer
from wafer_viewer.measure.base.measurement_context import WINDOW, Z_SCALE, Lines, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import BIAS_SHARE, MOST_SIDE, NOISE, noise_lines, window_covariance
from wafer_viewer.measure.base.plane_faces import area_of, lattice_of
from wafer_viewer.measure.texture.resolvable_scales import near_noise, unseen_waves
from wafer_viewer.measure.texture.spatial_texture import spatial
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Texture
from wafer_viewer.model.measurement.tool_options import SlopeScheme, TextureOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.numerics.filters.gaussian import gaussian_mean
from wafer_viewer.numerics.filters.interpolation import polynomial
from wafer_viewer.numerics.filters.sliding_filters import mean_of_valid


def root_mean_square_gradient(z_um: Floats, pixel_um: float) -> float | None:
    """Return Sdq of z [row, col] by forward differences along rows and columns; None if there are none.

    Same as in Gwyddion and SurfaceTopography. The standard defines an integral and does not specify its sampling.
    """
    squares = [np.diff(z_um, axis=axis) ** 2 for axis in (0, 1)]
    if not all(np.isfinite(square).any() for square in squares):
        return None
    return float(np.sqrt(sum(np.nanmean(square) for square in squares))) / pixel_um


def developed_fraction(z_um: Floats, pixel_um: float) -> float | None:
    """Return Sdr as a fraction: excess of the developed area over the projected one; None without any square.

    Each square of four measured pixels is divided into four triangles that meet at its centre, at the mean of the four
    heights.
    """
    a, b, c, d = z_um[:-1, :-1], z_um[:-1, 1:], z_um[1:, 1:], z_um[1:, :-1]
    middle = (a + b + c + d) / 4
    ratio = sum(
        _triangle_areas(one - middle, other - middle, pixel_um) for one, other in ((a, b), (b, c), (c, d), (d, a))
    )
    finite = np.isfinite(middle)
    return float(np.mean(np.asarray(ratio)[finite])) / 4 - 1 if finite.any() else None


SEVEN_POINT = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60
"""Weights of the first derivative through seven points, exact for polynomials of order 6."""


def seven_point_slopes(z_um: Floats, pixel_um: float) -> Floats:
    """Return the slopes of z [row, col] along both axes, [2, pixel], where all points that they need are measured."""
    reach = len(SEVEN_POINT) // 2
    inner = slice(reach, -reach)
    windows = np.lib.stride_tricks.sliding_window_view
    down = windows(z_um, len(SEVEN_POINT), axis=0)[:, inner] @ SEVEN_POINT
    across = windows(z_um, len(SEVEN_POINT), axis=1)[inner] @ SEVEN_POINT
    known = np.isfinite(down) & np.isfinite(across)
    return np.stack([down[known], across[known]]) / pixel_um


def hybrid_parameters(z_um: Floats, pixel_um: float, slopes: SlopeScheme) -> dict[str, float | None]:
    """Return Sdq, and Sdr as a fraction, of z [row, col]; None where no slope is known."""
    if slopes == "neighbours":
        return {
            "sdq": root_mean_square_gradient(z_um, pixel_um),
            "sdr_fraction": developed_fraction(z_um, pixel_um),
        }
    squares = np.sum(seven_point_slopes(z_um, pixel_um) ** 2, axis=0) if min(z_um.shape) > len(SEVEN_POINT) else None
    if squares is None or not squares.size:
        return {"sdq": None, "sdr_fraction": None}
    return {"sdq": float(np.sqrt(np.mean(squares))), "sdr_fraction": float(np.mean(np.sqrt(1 + squares))) - 1}


SLOPES: dict[SlopeScheme, str] = {
    "neighbours": "Sdq of differences of neighbouring pixels, Sdr of four triangles for each four pixels.",
    "seven_point": "Sdq and Sdr of slopes through seven pixels, where all of them are measured.",
}


def _triangle_areas(one: Floats, other: Floats, pixel_um: float) -> Floats:
    """Return area over projected area of a triangle from a square's centre to two corners, by relative heights.

    Its slopes are (other - one) along the side and (one + other) across it, per pixel.
    """
    return np.sqrt(1 + ((other - one) ** 2 + (one + other) ** 2) / pixel_um**2)


CORE = 0.4
"""Width of the secant of smallest slope, as a fraction of the material ratio."""


@dataclass(frozen=True, slots=True)
class Bearing:
    """Core, reduced peak and reduced valley heights in um; material ratios Smr1 and Smr2 as fractions."""

    sk_um: float
    spk_um: float
    svk_um: float
    smr1: float
    smr2: float


def material_ratio_curve(z_um: Floats) -> Floats:
    """Return heights [n] of equal area from the highest to the lowest: the height over each material ratio."""
    return np.sort(z_um)[::-1]


def bearing(curve: Floats) -> Bearing:
    """Return the Sk parameters of a material ratio curve.

    The core line is the least-squares line through the 40 % of the curve with the flattest secant (the first of equal
    ones); Spk and Svk are the heights of triangles with the area of the curve beyond the core.
    """
    slope, top = _line(curve)
    foot = top + slope
    above, below = curve[curve > top], curve[curve < foot]
    n = len(curve)
    return Bearing(
        sk_um=top - foot,
        spk_um=_triangle(float(np.sum(above - top)), len(above)),
        svk_um=_triangle(float(np.sum(foot - below)), len(below)),
        smr1=len(above) / n,
        smr2=1 - len(below) / n,
    )


def _line(curve: Floats) -> tuple[float, float]:
    """Return slope per unit material ratio, and height at ratio 0, of the line through the flattest 40 %."""
    width = max(1, round(CORE * len(curve)))
    first = int(np.argmin(curve[:-width] - curve[width:]))
    part = curve[first : first + width + 1]
    ratio = (first + 0.5 + np.arange(len(part))) / len(curve)
    from_middle = ratio - ratio.mean()
    slope = float(from_middle @ part / (from_middle @ from_middle))
    return slope, float(part.mean() - slope * ratio.mean())


def _triangle(total_um: float, points: int) -> float:
    """Return the height of a triangle with the given base, in points, and area."""
    return 2 * total_um / points if points else 0.0


PEAKS_END, VALLEYS_BEGIN = 0.1, 0.8
"""Material ratios between which is the core, for volumes (ISO 25178-3, default values)."""
EXTREME_FROM, EXTREME_TO = 0.025, 0.5
"""Material ratios of the peak extreme height Sxp (the same)."""


def volumes(curve: Floats) -> dict[str, float]:
    """Return material and void volumes per area, and Sxp, in um, of a material ratio curve."""
    ratios = (PEAKS_END, VALLEYS_BEGIN, EXTREME_FROM, EXTREME_TO)
    at_peaks, at_valleys, extreme, middle = (_height_at(curve, ratio) for ratio in ratios)
    levels, mean_um, n = (at_peaks, at_valleys), float(curve.mean()), len(curve)
    above = (curve[: n - int(np.searchsorted(curve[::-1], level))] for level in levels)
    material = [float(np.sum(part - level)) / n for part, level in zip(above, levels, strict=True)]
    void = [volume + level - mean_um for volume, level in zip(material, levels, strict=True)]
    return {
        "vmp": material[0],
        "vmc": material[1] - material[0],
        "vvc": void[0] - void[1],
        "vvv": void[1],
        "sxp": float(extreme - middle),
    }


def _height_at(curve: Floats, ratio: float) -> float:
    """Return the height over a material ratio, between the two points beside it."""
    place = min(max(ratio * len(curve) - 0.5, 0.0), len(curve) - 1.0)
    before = int(place)
    after = min(before + 1, len(curve) - 1)
    return float(curve[before] + (place - before) * (curve[after] - curve[before]))


FORMS = {0: "Form removed: the mean alone.", 1: "Form removed: plane of least squares."}
"""Notes on the removed form by the order of its polynomial."""
UNFILTERED = "Neither S-filter nor L-filter: noise and waviness are in the numbers."
BORDERS = (
    "Filter at borders and holes: weights scaled to sum one (ISO 16610-28, moment criterion of order 0); nothing from "
    "outside of the region."
)


def scale_limited(z_um: Floats, pixel_um: float, options: TextureOptions) -> Floats:
    """Remove form, S-filtered and L-filtered waves from heights [row, col]; the result has zero mean.

    The S-filter is applied to the residual from the form: it preserves polynomials, and a tilt causes no edge effects.
    Raises MeasureError where a filter is longer than the face, or its points do not determine the form.
    """
    _require_room(z_um.shape, pixel_um, options)
    left = _without_form(z_um - np.nanmean(z_um), options.form_order)
    if options.s_filter_um is not None:
        left = _without_form(gaussian_mean(left, options.s_filter_um / pixel_um), options.form_order)
    if options.l_filter_um is not None:
        left = left - gaussian_mean(left, options.l_filter_um / pixel_um)
    return left - np.nanmean(left)


def filter_names(options: TextureOptions) -> str:
    """Return the description of the filters for a result."""
    named = (("S", options.s_filter_um), ("L", options.l_filter_um))
    names = [f"{name} {cutoff_um:g} um" for name, cutoff_um in named if cutoff_um is not None]
    return f"Gaussian (ISO 16610-61), {', '.join(names)}" if names else "none"


def form_notes(options: TextureOptions) -> tuple[str, ...]:
    """Return notes on the removed form and on the filter borders."""
    form = FORMS.get(options.form_order, f"Form removed: polynomial of least squares of order {options.form_order}.")
    return form, UNFILTERED if filter_names(options) == "none" else BORDERS


def _require_room(shape: tuple[int, ...], pixel_um: float, options: TextureOptions) -> None:
    narrowest_um = min(shape) * pixel_um
    for name, cutoff_um in (("S", options.s_filter_um), ("L", options.l_filter_um)):
        if cutoff_um is not None and cutoff_um > narrowest_um:
            raise MeasureError(
                f"The {name}-filter of {cutoff_um:g} um is longer than the face, {narrowest_um:.4g} um at its "
                "narrowest: draw it larger or take a shorter filter."
            )


def _without_form(z_um: Floats, order: int) -> Floats:
    form = polynomial(z_um, order)
    if form is None:
        raise MeasureError(
            f"The measured points of the face do not determine a form of order {order}: draw it larger or lower the "
            "order."
        )
    return z_um - form


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
    noise_um: float | None = None,
    slopes: SlopeScheme = "neighbours",
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
    noise_um : float, optional
        Root mean square noise of the heights in um, as repeats of a flat give it (`calibrate noise`). Default None:
        unknown, and the uncertainty is not evaluated.
    slopes : {'neighbours', 'seven_point'}, optional
        Slopes of Sdq and Sdr. Default 'neighbours': differences of neighbouring pixels, and four triangles for each
        four. 'seven_point': through seven pixels, which reads short waves truer, and noise higher.
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
        Smr1, Smr2 as fractions), volume (Vmp, Vmc, Vvc, Vvv in um, that is um3/um2, at material ratios of 10 and 80 %;
        Sxp in um) and spatial parameters (Sal in um, Str, Std in degrees). Parameters that are not
        defined for this surface are None. With a noise, the lengths but Sal have expanded uncertainties (k = 2).

    Raises
    ------
    MeasureError
        If the region is a line or a point, or lies outside the surface.
    MeasureError
        If the region has fewer than 200 measured points or less than half of its area measured.
    MeasureError
        If the face is smaller than a filter, or its points do not determine the form.
    MeasureError
        If `form_order` is outside its range, a filter is not positive, `s_filter_um` is not below `l_filter_um`, or
        `noise_um` is negative.

    Notes
    -----
    Parameters are those of ISO 25178-2 [1]_, of the scale-limited surface of ISO 25178-3 [2]_. The order of operations
    is S, then form, then L; the Gaussian filters are those of ISO 16610-61 [3]_. At borders and holes their weights are
    scaled to sum one (ISO 16610-28 [4]_, moment criterion of order 0).

    A flat surface has no Ssk, Sku and spatial parameters, and one without a lay no Std. The notes of the result name
    waves too short to be resolved and an Sq that may be mostly noise.

    Values are those of the definition, not corrected for noise or for the resolution of the focus window. Their
    uncertainty covers both: realisations of the noise, alike over a focus window as that of heights is, are added to
    the surface and evaluated, and the surface is averaged over the window once more (ISO 25178-700 [5]_).

    References
    ----------
    .. [1] ISO 25178-2, Surface texture: Areal - Part 2: Terms, definitions and surface texture parameters.
    .. [2] ISO 25178-3, Surface texture: Areal - Part 3: Specification operators.
    .. [3] ISO 16610-61, Filtration - Part 61: Linear areal filters: Gaussian filters.
    .. [4] ISO 16610-28, Filtration - Part 28: Profile filters: End effects.
    .. [5] ISO 25178-700, Surface texture: Areal - Part 700: Calibration, adjustment and verification of areal
       topography measuring instruments.
    """
    options = TextureOptions(
        form_order=form_order, s_filter_um=s_filter_um, l_filter_um=l_filter_um, noise_um=noise_um, slopes=slopes
    )
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "texture")
    lattice_um = lattice_of(area)
    z_um = scale_limited(lattice_um, area.pixel_um, options)
    lines = _lines(reading, lattice_um, area.pixel_um, options) if reading.calibrated else {}
    left = z_um[np.isfinite(z_um)]
    sq_um = float(np.sqrt(np.mean(left**2)))
    flat = sq_um <= ROUNDING * float(np.abs(area.points.z_um).max())
    waves, names = _spatial(reading, z_um, area.pixel_um, flat)
    notes = (
        *form_notes(options),
        SLOPES[slopes],
        *names,
        *unseen_waves(surface.provenance, area.pixel_um, s_filter_um, "The S-filter"),
        *near_noise(surface.provenance, sq_um, "Sq"),
        *_noise_notes(reading, options),
    )
    curve = material_ratio_curve(left)
    lengths = {
        name: reading.length(value_um, _with_scale(reading, value_um, lines.get(name)))
        for name, value_um in length_parameters(left, curve).items()
    }
    return Texture(
        **{**reading.result_fields(name, area.level, *notes), "filter": filter_names(options)},
        region=region,
        options=options,
        **lengths,
        **_moments(left, sq_um, flat),
        **hybrid_parameters(z_um, area.pixel_um, slopes),
        smr1_fraction=(found := bearing(curve)).smr1,
        smr2_fraction=found.smr2,
        **waves,
        points=len(left),
        measured_fraction=area.measured_fraction,
    )


def length_parameters(left: Floats, curve: Floats) -> dict[str, float]:
    """Return the height and functional parameters in um, by the names of their fields.

    left: heights [n] with mean 0; curve: their material ratio curve.
    """
    core = bearing(curve)
    return {
        "sa": float(np.mean(np.abs(left))),
        "sq": float(np.sqrt(np.mean(left**2))),
        "sp": float(left.max()),
        "sv": float(-left.min()),
        "sz": float(np.ptp(left)),
        "sk": core.sk_um,
        "spk": core.spk_um,
        "svk": core.svk_um,
        **volumes(curve),
    }


def _moments(left: Floats, sq_um: float, flat: bool) -> dict[str, float | None]:
    squares, n = left * left, len(left)
    return {
        "ssk": None if flat else float(squares @ left) / n / sq_um**3,
        "sku": None if flat else float(squares @ squares) / n / sq_um**4,
    }


NOISE_GIVEN = "Noise of {:.3g} um: values are not corrected for it, U covers it."
NOISE_UNKNOWN = (
    "U needs the noise of the heights, as `calibrate noise` measures it from repeats: give it with noise_um."
)
EXTREMES = ("sp", "sv", "sz", "sk", "spk", "svk")
"""Parameters that grow in proportion to the noise."""
LONGEST_NOISE = 4.0
"""Length over which noise may be alike, in focus windows: U is the larger of that by one and by so many.

An S-filter removes the shorter noise and passes the longer one.
"""
FILTERS_ROOM = 4.0
"""Smallest side, in lengths of the longest filter, of the part on which noise is evaluated."""


def _noise_notes(reading: MeasurementContext, options: TextureOptions) -> tuple[str, ...]:
    if not reading.calibrated:
        return ()
    if options.noise_um is None:
        return (NOISE_UNKNOWN,)
    return NOISE_GIVEN.format(options.noise_um), *reading.not_in_budget()


def _lines(reading: MeasurementContext, z_um: Floats, pixel_um: float, options: TextureOptions) -> dict[str, Lines]:
    """Return the budget lines of each length parameter that its size does not give; empty where noise is unknown."""
    if options.noise_um is None:
        return {}
    longest_um = max(options.s_filter_um or 0.0, options.l_filter_um or 0.0)
    part = _middle(z_um, max(MOST_SIDE, round(FILTERS_ROOM * longest_um / pixel_um)))

    def evaluate(heights_um: Floats) -> dict[str, float]:
        left = scale_limited(heights_um, pixel_um, options)
        known = left[np.isfinite(left)]
        return length_parameters(known, material_ratio_curve(known))

    window_px = _window_px(reading, pixel_um)
    models = (window_covariance(options.noise_um, times * window_px) for times in (1.0, LONGEST_NOISE))
    noises = [noise_lines(evaluate, part, covariance, EXTREMES) for covariance in models]
    found, coarser = evaluate(part), evaluate(_averaged(part, window_px))
    frames = reading.frame_lines(1 / math.sqrt(2))
    return {
        name: {
            NOISE: Scatter.largest(noise[name] for noise in noises),
            WINDOW: BIAS_SHARE * _lost_um(found[name], coarser[name]),
            **frames,
        }
        for name in found
    }


def _with_scale(reading: MeasurementContext, value_um: float, lines: Lines | None) -> Lines | None:
    return None if lines is None else {Z_SCALE: reading.u_z_scale * value_um, **lines}


def _middle(z_um: Floats, side_px: int) -> Floats:
    """Return the middle of a lattice, at most so many pixels wide."""
    rows, cols = (slice(max(0, (n - side_px) // 2), (n + side_px) // 2) for n in z_um.shape)
    return z_um[rows, cols]


def _window_px(reading: MeasurementContext, pixel_um: float) -> float:
    """Return the focus window in pixels of a level; one pixel where the surface does not tell it."""
    provenance = reading.surface.provenance
    window = provenance.recipe.window
    return 1.0 if isinstance(window, str) else max(1.0, window * reading.surface.pixel_um / pixel_um)


def _averaged(z_um: Floats, window_px: float) -> Floats:
    """Return heights averaged over the focus window twice, as wide as caps show that a focus measure averages."""
    valid, size = np.isfinite(z_um), 2 * round((window_px - 1) / 2) + 1
    averaged = np.where(valid, z_um - np.nanmean(z_um), 0.0)
    for _ in range(2):
        averaged = mean_of_valid(averaged, valid, size)
    return np.where(valid, averaged, np.nan)


def _lost_um(value_um: float, coarser_um: float) -> float:
    """Return what averaging took of a length, by the share that it takes when it is done once more."""
    return value_um * max(0.0, value_um / coarser_um - 1) if coarser_um > 0 else value_um


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
