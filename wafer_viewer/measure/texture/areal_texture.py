"""Areal texture of a face: height, hybrid, functional and spatial parameters of ISO 25178-2."""

from __future__ import annotations

from typing import Any

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats, Layer
from wafer_viewer.measure.base.measurement_context import Lines, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import MOST_SIDE
from wafer_viewer.measure.base.plane_faces import area_of, lattice_of
from wafer_viewer.measure.texture.features import five_heights, peak_numbers, peaks_and_pits
from wafer_viewer.measure.texture.material_ratio import bearing, height_at, material_ratio_curve, volumes
from wafer_viewer.measure.texture.operators import chain_text, longest_um, operated, scale_limited
from wafer_viewer.measure.texture.resolvable_scales import near_noise, unseen_waves
from wafer_viewer.measure.texture.spatial_texture import spatial
from wafer_viewer.measure.texture.texture_noise import length_lines, noise_notes, noise_of, with_scale
from wafer_viewer.model.measurement.measurements import Texture
from wafer_viewer.model.measurement.tool_options import Borders, SlopeScheme, Spikes, TextureOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic


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


FORMS = {0: "Form removed: the mean alone.", 1: "Form removed: plane of least squares."}
"""Notes on the removed form by the order of its polynomial."""
UNFILTERED = "Neither S-filter nor L-filter: noise and waviness are in the numbers."
BORDERS = (
    "Filter at borders and holes: weights scaled to sum one (ISO 16610-28, moment criterion of order 0); nothing from "
    "outside of the region."
)

CUT = "Filter: half its length along the border is not evaluated."


def filter_names(options: TextureOptions) -> str:
    """Return the description of the filters for a result."""
    named = (("S", options.s_filter_um), ("L", options.l_filter_um))
    names = [f"{name} {cutoff_um:g} um" for name, cutoff_um in named if cutoff_um is not None]
    return f"Gaussian (ISO 16610-61), {', '.join(names)}" if names else "none"


def form_notes(options: TextureOptions) -> tuple[str, ...]:
    """Return notes on the removed form and on the filter borders."""
    form = FORMS.get(options.form_order, f"Form removed: polynomial of least squares of order {options.form_order}.")
    filtered = CUT if options.borders == "cut" else BORDERS
    return form, UNFILTERED if filter_names(options) == "none" else filtered


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
    borders: Borders = "keep",
    spikes: Spikes = "keep",
    c_um: float | None = None,
    mr_percent: float | None = None,
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
        that of the heights' own uncertainty; where they have none, U is not evaluated.
    slopes : {'neighbours', 'seven_point'}, optional
        Slopes of Sdq and Sdr. Default 'neighbours': differences of neighbouring pixels, and four triangles for each
        four. 'seven_point': through seven pixels, which reads short waves truer, and noise higher.
    borders : {'keep', 'cut'}, optional
        Default 'keep': what the longer filter evaluates over less than its length at the border counts. 'cut': half of
        its length along the border does not.
    spikes : {'keep', 'remove'}, optional
        Default 'keep'. 'remove': heights more than six robust deviations from the median of their 24 neighbours do not
        count.
    c_um : float, optional
        Height over the mean in um for which the areal material ratio Smr(c) is given. Default None: not given.
    mr_percent : float, optional
        Areal material ratio, 0 to 100 %, for which the height Smc is given. Default None: not given.
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
        Sxp in um), spatial (Sal in um, Str, Std in degrees) and feature parameters (S5p, S5v, S10z in um, Spd in
        1/mm2, Spc in 1/mm). Parameters that are not defined for this surface are None. With a noise, the lengths but
        Sal have expanded uncertainties (k = 2).

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
    is spikes, S, then form, then L: `chain` names them, with Sq after each. The Gaussian filters are those of ISO
    16610-61 [3]_. At borders and holes their weights are scaled to sum one (ISO 16610-28 [4]_, moment criterion of
    order 0).

    Hills and dales are those of the watersheds after Wolf pruning of 5 % of Sz; peaks at the border of the face and
    beside unmeasured pixels do not count.

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
        form_order=form_order,
        s_filter_um=s_filter_um,
        l_filter_um=l_filter_um,
        noise_um=noise_um,
        slopes=slopes,
        borders=borders,
        spikes=spikes,
        c_um=c_um,
        mr_percent=mr_percent,
    )
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "texture")
    lattice_um = lattice_of(area)
    chain, z_um = chain_text(operated(lattice_um, area.pixel_um, options))
    noise = noise_of(reading, noise_um, area.points.x_um, area.points.y_um, area.level)
    lines = _lines(reading, lattice_um, area.pixel_um, options, noise) if noise is not None else {}
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
        *noise_notes(reading, options.noise_um, noise),
    )
    curve = material_ratio_curve(left)
    tops = None if flat else peaks_and_pits(z_um)
    heights = {**length_parameters(left, curve, options), **({} if tops is None else five_heights(*tops))}
    lengths = {
        field: reading.length(value_um, with_scale(reading, value_um, lines[field]) if field in lines else None)
        for field, value_um in heights.items()
    }
    return Texture(
        **{**reading.result_fields(name, area.level, *notes), "filter": filter_names(options)},
        region=region,
        options=options,
        chain=chain,
        **lengths,
        **_moments(left, sq_um, flat),
        **hybrid_parameters(z_um, area.pixel_um, slopes),
        smr1_fraction=(found := bearing(curve)).smr1,
        smr2_fraction=found.smr2,
        smr_fraction=None if c_um is None else float(np.mean(left >= c_um)),
        **waves,
        **({} if tops is None else peak_numbers(z_um, tops[0], area.pixel_um)),
        points=len(left),
        measured_fraction=area.measured_fraction,
    )


def length_parameters(left: Floats, curve: Floats, options: TextureOptions) -> dict[str, float]:
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
        **({} if options.mr_percent is None else {"smc": height_at(curve, options.mr_percent / 100)}),
    }


def _moments(left: Floats, sq_um: float, flat: bool) -> dict[str, float | None]:
    squares, n = left * left, len(left)
    return {
        "ssk": None if flat else float(squares @ left) / n / sq_um**3,
        "sku": None if flat else float(squares @ squares) / n / sq_um**4,
    }


EXTREMES = ("sp", "sv", "sz", "sk", "spk", "svk", "s5p", "s5v", "s10z")
"""Parameters that grow in proportion to the noise."""
FEATURES_SIDE = 200
"""Largest side, in pixels, on which the noise of peaks and pits is evaluated."""
FILTERS_ROOM = 4.0
"""Smallest side, in lengths of the longest filter, of the part on which noise is evaluated."""


def _lines(
    reading: MeasurementContext, z_um: Floats, pixel_um: float, options: TextureOptions, noise_um: float
) -> dict[str, Lines]:
    """Return the budget lines of each length parameter that its size does not give."""
    room_px = round(FILTERS_ROOM * longest_um(options) / pixel_um)
    part, small = (_middle(z_um, max(side, room_px)) for side in (MOST_SIDE, FEATURES_SIDE))
    whole = replace(options, borders="keep")

    def evaluate(heights_um: Floats) -> dict[str, float]:
        left = scale_limited(heights_um, pixel_um, whole)
        known = left[np.isfinite(left)]
        return length_parameters(known, material_ratio_curve(known), options)

    def features(heights_um: Floats) -> dict[str, float]:
        return five_heights(*peaks_and_pits(scale_limited(heights_um, pixel_um, whole)), least=1)

    return {
        **length_lines(reading, evaluate, part, pixel_um, noise_um, EXTREMES),
        **length_lines(reading, features, small, pixel_um, noise_um, EXTREMES),
    }


def _middle(z_um: Floats, side_px: int) -> Floats:
    """Return the middle of a lattice, at most so many pixels wide."""
    rows, cols = (slice(max(0, (n - side_px) // 2), (n + side_px) // 2) for n in z_um.shape)
    return z_um[rows, cols]


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
