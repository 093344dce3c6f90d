"""Deviation of the x-y mapping of an image: the distortion of lens and camera against the scales of the stage.

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

from wafer_viewer.calibrate.frame_displacement import displacement_px
from wafer_viewer.calibrate.pixel_scale import Estimate
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import RigError
from wafer_viewer.numerics.normal_statistics import student

Complexes = NDArray[np.complex128]
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
    wide = student(float(count[enough].mean()) - 1) / 2
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
