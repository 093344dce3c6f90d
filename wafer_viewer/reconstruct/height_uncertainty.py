"""Standard uncertainty of each height of a field.

Noise of the camera reaches a height through the levels in the window of its peak. Two terms are common to all pixels of
a field: interpolation between frames, and what the frames are seen to do (`FrameHealth`). Two come from the surface
under the focus window: where it is inclined, texture weighs one side of the window more than the other, and where it is
curved, the window lowers a summit and fills a hollow.

Errors of pixels that share a focus window are correlated: a mean of n neighbours is hardly more certain than one pixel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.frame_health import FrameHealth
from wafer_viewer.numerics.jit import Float32s, Int, Real, inline_kernel, lean_kernel

TEXTURE_SHARE = 0.07
"""Standard deviation of the centre of texture in a focus window, in windows: tests/bench/bench_pixel_u.py --seed 1."""
SLOPE_WINDOWS = 0.5
"""Distance of the two heights from whose difference the slope at a pixel between them is taken, in windows."""


def window_variance_px2(window: int, passes: int) -> float:
    """Return the variance of a window of `passes` boxes along one axis, in square pixels."""
    return passes * (window**2 - 1) / 12


def uncertainty_um(
    noise_um: NDArray[np.float32],
    z_um: NDArray[np.float32],
    window: int,
    passes: int,
    interpolation_um: float,
    health: FrameHealth,
) -> NDArray[np.float32]:
    """Return the standard uncertainty (k = 1) of each height in um, NaN where there is none.

    noise_um: that of the peaks due to the noise of the camera; z_um: measured heights, NaN elsewhere; both [row, col].
    """
    common_um2 = interpolation_um**2 + health.u_jitter_um**2 + health.u_flicker_um**2
    near, far = max(1, round(SLOPE_WINDOWS * window)), window
    out = np.empty(z_um.shape, np.float32)
    _combine(
        np.ascontiguousarray(noise_um),
        np.ascontiguousarray(z_um),
        common_um2,
        near,
        TEXTURE_SHARE * window / near,
        far,
        window_variance_px2(window, passes) / 2 / far**2,
        out,
    )
    return out


@lean_kernel
def _combine(
    noise_um: Float32s,
    z_um: Float32s,
    common_um2: Real,
    near: Int,
    per_rise: Real,
    far: Int,
    per_bend: Real,
    out: Float32s,
) -> None:
    rows, cols = z_um.shape
    for r in range(rows):
        for x in range(cols):
            z, noise = z_um[r, x], noise_um[r, x]
            if z != z:
                out[r, x] = np.nan
                continue
            along_y = _rise(_height(z_um, r - near, x), z, _height(z_um, r + near, x))
            along_x = _rise(_height(z_um, r, x - near), z, _height(z_um, r, x + near))
            bend = _bend(_height(z_um, r - far, x), z, _height(z_um, r + far, x))
            bend += _bend(_height(z_um, r, x - far), z, _height(z_um, r, x + far))
            of_form_um2 = per_rise**2 * (along_x**2 + along_y**2) + (per_bend * bend) ** 2
            out[r, x] = math.sqrt(noise * noise + common_um2 + of_form_um2)


@inline_kernel
def _height(z_um: Float32s, r: Int, x: Int) -> Real:
    """Return a height, NaN beyond the border."""
    inside = (r >= 0) & (r < z_um.shape[0]) & (x >= 0) & (x < z_um.shape[1])
    return z_um[r, x] if inside else np.float32(np.nan)


@inline_kernel
def _rise(before: Real, z: Real, after: Real) -> Real:
    """Return the mean rise from one height to the next of three, as far as they are measured."""
    first, last = z if before != before else before, z if after != after else after
    return (last - first) * (0.5 if (after == after) & (before == before) else 1.0)


@inline_kernel
def _bend(before: Real, z: Real, after: Real) -> Real:
    """Return the second difference of three heights, 0 if one is not measured."""
    second = before - 2 * z + after
    return second if second == second else 0.0
