"""Displacement between two overlapping frames, for calibrations of the pixel size and the camera's rotation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.cross_correlation import contrast, normalised_cross_correlation
from wafer_viewer.numerics.subpixel_registration import RegisteredImage, SubpixelShift, align


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
