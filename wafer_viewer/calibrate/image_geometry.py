"""Geometry of the image: pixel size, rotation and mapping deviation from overlapping frames at known moves.

Positions are complex numbers, x + i y of the stage in um and right + i up on the camera in pixels. Along a line the
displacements between neighbouring frames add up to positions on the camera, p, in a frame of reference that is longer
than a field. The regression of the stage's positions s on them, s = m p + constant, has the slope

    m = e exp(i a),    e pixel size in um, a rotation of the camera against the axis of the stage

for lines along x and along y alike. A line averages the errors of the stage's scales over its length; lines far apart
have independent errors, so their scatter is the uncertainty. It includes the registration. The scale of the stage
itself is common to all lines: its uncertainty comes from its certificate.

A patch of texture is moved by the stage to a grid of places in the field. Positions are complex numbers, right + i up
from the centre of the image in pixels and x + i y on the sample in um. With the position q of the patch in the image
and its position s by the stage, the least-squares fit s = m q + constant has the pixel size and the rotation of the
camera in m. The deviation at a place is m q + constant - s: how far off a point lies that is measured there.

The scales of the stage have errors of their own over the width of a field, which differ from one place of the stage to
another. So the deviations are averaged over several patches, far from each other, and their scatter is the uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.quantity import coverage_factor
from wafer_viewer.numerics.cross_correlation import contrast, normalised_cross_correlation
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.numerics.subpixel_registration import RegisteredImage, SubpixelShift, align

# --------------------------------------------------------------------------------------------------- frame displacement


@dataclass(frozen=True, slots=True)
class FrameDisplacementParameters:
    """Search for the displacement between two frames.

    Parameters
    ----------
    reach_fraction : float
        Search range as a fraction of the expected displacement: the largest error of the pixel size beforehand.
    reach_px : int, px
        Smallest search range.
    local_px : int, px
        Side of the square whose mean is removed before the search.
    block_px : int, px
        Side of the blocks of the subpixel alignment.
    least_correlation : float
        Correlation within the blocks below which the frames show nothing in common.
    """

    reach_fraction: float = 0.03
    reach_px: int = 8
    local_px: int = 31
    block_px: int = 24
    least_correlation: float = 0.3


DISPLACEMENT = FrameDisplacementParameters()


def displacement_px(
    first: Image, second: Image, expected_px: complex, parameters: FrameDisplacementParameters = DISPLACEMENT
) -> complex | None:
    """Return the displacement of the frame on the sample, in pixels to the right + i upward.

    Parameters
    ----------
    first, second : uint8 or uint16 [row, col]
        Overlapping frames.
    expected_px : complex
        Displacement by the stage and the present calibration.
    parameters : FrameDisplacementParameters
        Search range and blocks.

    Returns
    -------
    complex or None
        Displacement from the first to the second frame; None where they show nothing in common.
    """
    lag = round(-expected_px.imag), round(expected_px.real)
    reach = max(parameters.reach_px, math.ceil(parameters.reach_fraction * abs(expected_px)))
    spans = [_common(n, offset, reach) for n, offset in zip(first.shape, lag, strict=True)]
    grey = [
        np.ascontiguousarray(image[spans[0][which], spans[1][which]], np.float32)
        for which, image in enumerate((first, second))
    ]
    if min(min(one.shape) for one in grey) <= parameters.local_px:
        return None
    begun = tuple(offset + span[1].start - span[0].start for offset, span in zip(lag, spans, strict=True))
    known = [np.ones(one.shape, np.bool_) for one in grey]
    details = [contrast(one, valid, parameters.local_px) for one, valid in zip(grey, known, strict=True)]
    likeness = normalised_cross_correlation(details[0], known[0], details[1], known[1], (begun[0], begun[1]), reach)
    row, col = np.unravel_index(int(likeness.correlation.argmax()), likeness.correlation.shape)
    images = [RegisteredImage(one, np.ones_like(one), pixel_noise(one)) for one in grey]
    nearest = float(begun[0] - reach + row), float(begun[1] - reach + col)
    found: SubpixelShift = align(images[0], images[1], nearest, parameters.block_px)
    if found.correlation < parameters.least_correlation or not np.isfinite(found.covariance).all():
        return None
    return complex(found.lag[1] - begun[1] + lag[1], begun[0] - lag[0] - found.lag[0])


def _common(n: int, lag: int, margin: int) -> tuple[slice, slice]:
    """Return the rows or columns of the first and the second frame that both show, with a margin."""
    first = slice(max(0, lag - margin), min(n, n + lag + margin))
    second = slice(max(0, -lag - margin), min(n, n - lag + margin))
    return first, second


def pixel_noise(grey: NDArray[np.float32]) -> float:
    """Return an upper bound of the standard deviation of pixel noise; fine texture increases it.

    Source: J. Immerkaer, Fast noise variance estimation, Comput. Vis. Image Underst. 64 (1996) 300; here by a median.
    """
    from scipy.ndimage import convolve

    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    residual = convolve(grey, kernel)[1:-1, 1:-1]
    return float(np.median(np.abs(residual))) / (0.6745 * 6)


# ---------------------------------------------------------------------------------------------------------- pixel scale


Complexes = NDArray[np.complex128]
OUTLIER_SIGMAS = 6.0
"""Distance of a step from the median of all steps above which its registration is rejected."""
LEAST_SIGMA = 1e-4
"""Smallest standard deviation of a step relative to its length: a step of 300 um to 0.03 um."""
LEAST_LINES = 2
"""Fewest lines along an axis."""
LEAST_STEPS = 3
"""Fewest neighbouring steps that make a piece of a line."""


@dataclass(frozen=True, slots=True, eq=False)
class StageLine:
    """Line of overlapping frames.

    moved_um: moves of the stage between neighbours, complex [n]; displaced_px: displacements of the frames on the
    sample, complex [n], NaN where the registration failed.
    """

    moved_um: Complexes
    displaced_px: Complexes


@dataclass(frozen=True, slots=True)
class Estimate:
    """Value with its standard uncertainty (k = 1)."""

    value: float
    u: float


@dataclass(frozen=True, slots=True)
class PixelScale:
    """Pixel size in um, as a mean and along each axis; rotation of the camera and angle between the axes in rad.

    rotation_rad: anticlockwise from the x axis of the stage to the rows of the camera. shear_rad: rotation by the lines
    along y minus that by the lines along x, from axes that are not square to each other. stage_error_um: root mean
    square distance of the stage from the lines. n_rejected: steps without a usable registration.
    """

    pixel_um: Estimate
    pixel_x_um: Estimate
    pixel_y_um: Estimate
    rotation_rad: Estimate
    shear_rad: Estimate
    stage_error_um: float
    n_steps: int
    n_rejected: int


def pixel_scale(
    along_x: Sequence[StageLine], along_y: Sequence[StageLine], u_stage_fraction: float = 0.0
) -> PixelScale:
    """Return pixel size and rotation of the camera from lines along both axes.

    Parameters
    ----------
    along_x, along_y : sequence of StageLine
        At least two lines each.
    u_stage_fraction : float
        Relative standard uncertainty (k = 1) of the scales of the stage, from their certificate.

    Returns
    -------
    PixelScale
        Estimates with standard uncertainties.

    Raises
    ------
    RigError
        With fewer than two usable lines along an axis.

    Notes
    -----
    The uncertainty of a mean over lines is s / sqrt(n), s pooled over both axes and widened by Student's t, so that
    k = 2 covers 95 %. That of the mean pixel size contains half the difference of both axes as a uniform distribution.

    References
    ----------
    .. [1] JCGM 100:2008, Evaluation of measurement data - Guide to the expression of uncertainty in measurement.
    """
    usable = _usable_steps([*along_x, *along_y])
    fits = [
        [fit for line, good in zip(lines, kept, strict=True) if (fit := _fit(line, good)) is not None]
        for lines, kept in ((along_x, usable[: len(along_x)]), (along_y, usable[len(along_x) :]))
    ]
    for axis, of_axis in zip("xy", fits, strict=True):
        if len(of_axis) < LEAST_LINES:
            raise RigError(
                f"{len(of_axis)} of the lines along {axis} can be followed in the frames and {LEAST_LINES} are needed: "
                "choose a place with texture everywhere, and check the focus."
            )
    sizes = [np.array([abs(fit.slope) for fit in of_axis]) for of_axis in fits]
    angles = [np.array([np.angle(fit.slope) for fit in of_axis]) for of_axis in fits]
    pixel, rotation = _mean_of_axes(sizes), _mean_of_axes(angles)
    residuals = np.concatenate([fit.residual_um for of_axis in fits for fit in of_axis])
    n_steps = sum(len(good) for good in usable)
    return PixelScale(
        pixel_um=_with_scale(pixel.mean, u_stage_fraction),
        pixel_x_um=_with_scale(pixel.of_x, u_stage_fraction),
        pixel_y_um=_with_scale(pixel.of_y, u_stage_fraction),
        rotation_rad=rotation.mean,
        shear_rad=Estimate(rotation.of_y.value - rotation.of_x.value, math.hypot(rotation.of_x.u, rotation.of_y.u)),
        stage_error_um=float(np.sqrt(np.mean(np.abs(residuals) ** 2) / 2)),
        n_steps=n_steps,
        n_rejected=n_steps - sum(int(good.sum()) for good in usable),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _LineFit:
    slope: complex
    residual_um: Complexes


@dataclass(frozen=True, slots=True)
class _AxisMeans:
    of_x: Estimate
    of_y: Estimate
    mean: Estimate


def _usable_steps(lines: Sequence[StageLine]) -> list[NDArray[np.bool_]]:
    """Return which steps of each line agree with the median of all steps."""
    ratios = [_ratios(line) for line in lines]
    every = np.concatenate(ratios)
    known = every[np.isfinite(every)]
    if not len(known):
        return [np.zeros(len(line), np.bool_) for line in ratios]
    middle = complex(np.median(known.real), np.median(known.imag))
    sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(known - middle))), LEAST_SIGMA * abs(middle))
    return [np.isfinite(line) & (np.abs(line - middle) <= OUTLIER_SIGMAS * sigma) for line in ratios]


def _ratios(line: StageLine) -> Complexes:
    """Return the move over the displacement of every step, NaN where the registration failed."""
    known = np.isfinite(line.displaced_px)
    return np.where(known, line.moved_um / np.where(known, line.displaced_px, 1.0), np.nan)


def _fit(line: StageLine, good: NDArray[np.bool_]) -> _LineFit | None:
    """Return the regression over the unbroken pieces of a line, each with its own constant; None without a piece."""
    pieces = [piece for piece in np.split(np.arange(len(good)), np.flatnonzero(~good)) if len(piece)]
    steps = [piece[good[piece]] for piece in pieces]
    stage, camera = (
        [_centred(np.cumsum(np.concatenate([[0], of_step[piece]]))) for piece in steps if len(piece) >= LEAST_STEPS]
        for of_step in (line.moved_um, line.displaced_px)
    )
    if not stage:
        return None
    s, p = np.concatenate(stage), np.concatenate(camera)
    slope = complex(np.vdot(p, s) / np.vdot(p, p))
    return _LineFit(slope, s - slope * p)


def _centred(positions: Complexes) -> Complexes:
    return positions - positions.mean()


def _mean_of_axes(values: list[NDArray[np.float64]]) -> _AxisMeans:
    freedom = sum(len(v) - 1 for v in values)
    s = math.sqrt(sum(float(((v - v.mean()) ** 2).sum()) for v in values) / freedom)
    wide = s * coverage_factor(freedom) / 2
    x, y = (Estimate(float(v.mean()), wide / math.sqrt(len(v))) for v in values)
    between = abs(x.value - y.value) / 2 / math.sqrt(3)
    return _AxisMeans(x, y, Estimate((x.value + y.value) / 2, math.hypot(math.hypot(x.u, y.u) / 2, between)))


def _with_scale(estimate: Estimate, u_fraction: float) -> Estimate:
    return Estimate(estimate.value, math.hypot(estimate.u, u_fraction * estimate.value))


# ---------------------------------------------------------------------------------------------------- mapping deviation


PATCH = 0.2
"""Side of a patch as a fraction of the shorter side of the image."""
LEAST_PATCH_PX = 60
"""Smallest side of a patch in pixels: two blocks of 24 pixels of the subpixel alignment, and its border."""
MARGIN_PX = 10
"""Distance of the outer patches from the border of the image in pixels: the reach of the search, and two more."""
LEAST_PATCHES = 3
"""Fewest patches for an uncertainty."""
LEAST_PLACES = 6
"""Fewest places of the grid at which enough patches are found."""
LEAST_SHARE = 0.6
"""Smallest fraction of the patches that must be found at a place."""
CONFIDENCE = 0.9545
"""Probability with which the deviations at all places together lie within U."""


@dataclass(frozen=True, slots=True, eq=False)
class MappingDeviation:
    """Largest deviation in um, and the deviation at each place of the grid, complex [place], NaN where not found."""

    largest_um: Estimate
    deviation_um: Complexes


def patch_px(shape: tuple[int, int]) -> int:
    """Return the side of a patch in pixels, even."""
    return max(LEAST_PATCH_PX, round(PATCH * min(shape)) // 2 * 2)


def grid_px(shape: tuple[int, int], n_rows: int, n_cols: int) -> Complexes:
    """Return the places of a grid in an image, right + i up from its centre in pixels.

    n_cols: along the longer side. Raises RigError where the image is too small for it.
    """
    if shape[0] > shape[1]:
        n_rows, n_cols = n_cols, n_rows
    room = [n / 2 - patch_px(shape) / 2 - MARGIN_PX for n in shape]
    if min(room) <= 0 or min(n_rows, n_cols) < 2:
        raise RigError(
            f"An image of {shape[1]} x {shape[0]} pixels has no room for {n_cols} x {n_rows} patches of "
            f"{patch_px(shape)} pixels: two at least along each side, in an image of over "
            f"{patch_px(shape) + 2 * MARGIN_PX} pixels."
        )
    up, right = (np.linspace(-end, end, n) for end, n in zip(room, (n_rows, n_cols), strict=True))
    return (right[None, :] + 1j * up[:, None]).ravel()


def patch_position_px(reference: Image, image: Image, place_px: complex) -> complex | None:
    """Return the position in an image of the patch that is in the centre of a reference, None if it is not found.

    Parameters
    ----------
    reference, image : uint8 or uint16 [row, col]
        Frames of the same shape.
    place_px : complex
        Expected position, right + i up from the centre.

    Returns
    -------
    complex or None
        Position, right + i up from the centre in pixels.
    """
    side = patch_px((reference.shape[0], reference.shape[1]))
    top, left = ((n - side) // 2 for n in reference.shape)
    down, right = -round(place_px.imag), round(place_px.real)
    row, col = top + down, left + right
    if min(row, col) < 0 or row + side > image.shape[0] or col + side > image.shape[1]:
        return None
    first = reference[top : top + side, left : left + side]
    second = image[row : row + side, col : col + side]
    moved = displacement_px(first, second, 0j)
    return None if moved is None else complex(right, -down) - moved


def mapping_deviation(sample_um: Complexes, found_px: Sequence[Complexes]) -> MappingDeviation:
    """Return the deviations over the image from the positions of several patches.

    Parameters
    ----------
    sample_um : complex [place]
        Positions of a patch by the stage, from the one in the centre of the image.
    found_px : sequence of complex [place]
        Positions in the image of each patch, NaN where it was not found; at least three patches.

    Returns
    -------
    MappingDeviation
        Largest deviation with its standard uncertainty.

    Raises
    ------
    RigError
        With too few patches or places.

    Notes
    -----
    The standard uncertainty is half of the radius within which the mean deviations of all places lie together with
    95.45 %, for normal errors of the scatter that is pooled over the places: the largest deviation is then not further
    off than that. The places of a patch share the errors of the stage, so Student's t has the freedom of the patches.

    References
    ----------
    .. [1] ISO 25178-700:2022, which compares positions with those of a certified grid; here the stage is the standard.
    """
    if len(found_px) < LEAST_PATCHES:
        raise RigError(f"The x-y mapping deviation takes {LEAST_PATCHES} patches; there are {len(found_px)}.")
    each = np.stack([_deviations_um(sample_um, found) for found in found_px])
    count = np.isfinite(each).sum(axis=0)
    enough = count >= max(2, math.ceil(LEAST_SHARE * len(each)))
    if enough.sum() < LEAST_PLACES:
        raise RigError(
            "The patches are found at too few places of the field: choose texture everywhere, and check the focus."
        )
    mean = np.full(len(sample_um), np.nan, np.complex128)
    mean[enough] = np.nanmean(each[:, enough], axis=0)
    residual = np.abs(each[:, enough] - mean[enough]) ** 2
    freedom = float((count[enough] - 1).sum())
    s_um = math.sqrt(float(np.nansum(residual)) / (2 * freedom))
    radius = math.sqrt(-2 * math.log(1 - CONFIDENCE ** (1 / float(enough.sum()))))
    wide = coverage_factor(float(count[enough].mean()) - 1) / 2
    u_um = wide * radius / 2 * s_um / math.sqrt(float(count[enough].mean()))
    return MappingDeviation(Estimate(float(np.nanmax(np.abs(mean))), u_um), mean)


def _deviations_um(sample_um: Complexes, found_px: Complexes) -> Complexes:
    """Return the positions by pixel size and rotation of a least-squares fit minus those by the stage."""
    known = np.isfinite(found_px)
    out = np.full(len(sample_um), np.nan, np.complex128)
    if known.sum() < LEAST_PLACES:
        return out
    design = np.stack([found_px[known], np.ones(int(known.sum()))], axis=1)
    fit, *_ = np.linalg.lstsq(design, sample_um[known], rcond=None)
    out[known] = design @ fit - sample_um[known]
    return out
