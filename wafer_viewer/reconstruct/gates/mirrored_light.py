"""Mirror symmetry of the light about the measured heights, which tells printed patterns from walls.

Defocus blurs alike above and below the focus: where all light near a pixel comes from surfaces at its own height, the
frames at equal distances above and below that height show the same grey, whatever is printed there and whatever the
lens. Light from another height, as from the bright trench beside a die, and light that a wall hides blur about another
frame and break the symmetry. So an outline whose surroundings are symmetric about their heights is print on a surface.

Per cell of 4 x 4 pixels, with a(d) and b(d) its grey at a distance d above and below its height, asymmetry is the sum
of (a - b)^2 and symmetry that of (a + b - their mean)^2, both less the share of the noise of the camera. A lens whose
magnification changes with the focus, and one that blurs unlike on both sides, break the symmetry too: then outlines
are walls as long as heights do not say otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.filters.sliding_filters import mean, mean_of_valid
from wafer_viewer.numerics.jit import Float32s, Float64s, Int, Int32s, Real, lean_kernel, lean_part
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX, on_threads
from wafer_viewer.reconstruct.frame_blocks import Frames, StackSource, StackWindow, developed, stripes
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise


@dataclass(frozen=True, slots=True)
class MirrorParameters:
    """Limits of the symmetry of light about a height: tests/truth/unseen.py and tests/truth/families.py.

    Parameters
    ----------
    height_cells : int, cells
        Side of the square over which heights are averaged: the noise of a height is an asymmetry.
    border_cells : int, cells
        Width of the border of the frame, where the focus window sees one side only and heights lean to it.
    window_cells : int, cells
        Side of the square over which asymmetry and symmetry are summed.
    symmetry_sigmas : float
        Least symmetry that tells anything, in standard deviations of its noise.
    asymmetry_sigmas : float
        Least asymmetry that counts, in standard deviations of its noise.
    least_asymmetry : float
        Least asymmetry that counts, relative to the symmetry: slopes leave less.
    around_cells : int, cells
        Distance over which squares are counted.
    asymmetric_share : float
        Largest share of asymmetric squares, of those that tell anything, around print.
    enough_share : float
        Smallest share of squares that tell anything.
    """

    height_cells: int = 3
    border_cells: int = 2
    window_cells: int = 3
    symmetry_sigmas: float = 6.0
    asymmetry_sigmas: float = 6.0
    least_asymmetry: float = 0.005
    around_cells: int = 6
    asymmetric_share: float = 0.1
    enough_share: float = 0.1


MIRROR = MirrorParameters()
_STRIPE_CELLS = 16
"""Rows of cells that one task processes."""


class Symmetry(NamedTuple):
    """Sums over pairs of frames, in variances of the noise: asymmetry, symmetry, and the variance of either."""

    asymmetry: Float32s
    symmetry: Float32s
    variance: Float32s


def mirrored_light(
    frames: Frames,
    heights_um: NDArray[np.float32],
    reach_frames: int,
    camera: CameraNoise,
    threads: int | None = None,
) -> NDArray[np.bool_]:
    """Return the cells around which the light is symmetric about the heights, bool [row / 4, col / 4].

    heights_um: of the cells, NaN where unknown or not of interest; reach_frames: largest distance of a pair of frames
    from the height.
    """
    return _is_symmetric(mirror_sums(frames, _settled(heights_um), reach_frames, camera, threads))


def mirror_sums(
    frames: Frames,
    heights_um: NDArray[np.float32],
    reach_frames: int,
    camera: CameraNoise,
    threads: int | None = None,
) -> Symmetry:
    """Return the sums over pairs of frames about heights of cells [row / 4, col / 4], 0 where they are NaN."""
    found = Symmetry(*(np.zeros(heights_um.shape, np.float32) for _ in Symmetry._fields))
    z_um, step_um = frames.z_um, frames.step_um

    def add_parts(todo: Iterator[StackWindow]) -> None:
        line = np.empty(COARSE_PX * heights_um.shape[1], np.int32)
        grey = np.empty((frames.n_frames, heights_um.shape[1]), np.float32)
        for (rows, *_), block in developed(frames, todo, 0):
            first = rows.start // COARSE_PX
            cells = slice(first, -(-rows.stop // COARSE_PX))
            part = Symmetry(*(layer[cells] for layer in found))
            size = rows.stop - rows.start, frames.shape[1]
            _symmetry(
                block, size, z_um, step_um, heights_um[cells], reach_frames, camera.gain_counts, camera.floor_counts2,
                line, grey, part,
            )  # fmt: skip

    on_threads(add_parts, stripes(frames.shape, _STRIPE_CELLS * COARSE_PX), threads)
    return found


def _settled(heights_um: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the heights averaged over their neighbours; NaN at the border of the frame."""
    known, border = np.isfinite(heights_um), MIRROR.border_cells
    found = np.full_like(heights_um, np.nan)
    inner = slice(border, -border), slice(border, -border)
    averaged_um = mean_of_valid(heights_um, known, MIRROR.height_cells)
    found[inner] = np.where(known, averaged_um, np.float32(np.nan))[inner]
    return found


def around_cells(found: Symmetry) -> Symmetry:
    """Return the sums of the squares of cells in which symmetry is judged."""
    return Symmetry(*(np.float32(MIRROR.window_cells**2) * mean(layer, MIRROR.window_cells) for layer in found))


def _is_symmetric(found: Symmetry) -> NDArray[np.bool_]:
    asymmetry, symmetry, variance = around_cells(found)
    sigma = np.sqrt(variance)
    tells = (found.variance > 0) & (symmetry > MIRROR.symmetry_sigmas * sigma)
    asymmetric = (asymmetry > MIRROR.least_asymmetry * symmetry) & (asymmetry > MIRROR.asymmetry_sigmas * sigma)
    size = 2 * MIRROR.around_cells + 1
    telling, against = mean(tells, size), mean(tells & asymmetric, size)
    return (telling > MIRROR.enough_share) & (against < MIRROR.asymmetric_share * telling)


@lean_kernel
def _symmetry(
    source: StackSource,
    size: tuple[Int, Int],
    z_um: Float64s,
    step_um: Real,
    heights_um: Float32s,
    reach: Int,
    gain: Real,
    floor: Real,
    line: Int32s,
    grey: Float32s,
    out: Symmetry,
) -> None:
    """Write the sums of the cells of a block of `size` pixels; line, grey: work memory, [column] and [k, cell]."""
    for i in range(heights_um.shape[0]):
        cells, near = _near(heights_um[i], z_um, (reach + 1) * step_um)
        if cells[0] < cells[1]:
            _grey_row(source, size, COARSE_PX * i, cells, near, line, grey)
        for j in range(cells[0], cells[1]):
            if heights_um[i, j] == heights_um[i, j]:
                _add_pairs(grey, z_um, step_um, heights_um[i, j], reach, gain, floor, i, j, out)


@lean_part
def _grey_row(
    source: StackSource, size: tuple[Int, Int], top: Int, cells: tuple[Int, Int], frames: tuple[Int, Int], line: Int32s,
    grey: Float32s,
) -> None:  # fmt: skip
    """Compute the mean grey of a range of cells of a row in some frames; beyond the block its border repeats."""
    i, first, last_row = np.int32, COARSE_PX * cells[0], size[0] - 1
    n, n_cols = cells[1] - cells[0], min(COARSE_PX * cells[1], size[1]) - COARSE_PX * cells[0]
    for k in range(frames[0], frames[1]):
        image, out = source.images[source.slots[k]], grey[k, cells[0] :]
        line[: COARSE_PX * n] = 0
        for r in range(top, top + COARSE_PX):
            row = image[source.top + min(r, last_row), source.left + first :]
            for x in range(n_cols):
                line[x] = i(line[x] + i(row[x]))
        for x in range(n_cols, COARSE_PX * n):
            line[x] = line[n_cols - 1]
        for j in range(n):
            total = i(0)
            for c in range(COARSE_PX):
                total = i(total + line[COARSE_PX * j + c])
            out[j] = np.float32(total) * np.float32(1 / COARSE_PX**2)


@lean_part
def _near(heights_um: Float32s, z_um: Float64s, reach_um: Real) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the ranges of the cells of a row whose height is known, and of the frames within reach of any."""
    first, stop, low, high = heights_um.size, 0, 0, z_um.size
    lowest, highest = np.inf, -np.inf
    for j in range(heights_um.size):
        if heights_um[j] == heights_um[j]:
            first, stop = min(first, j), j + 1
            lowest, highest = min(lowest, np.float64(heights_um[j])), max(highest, np.float64(heights_um[j]))
    while low + 1 < z_um.size and z_um[low + 1] < lowest - reach_um:
        low += 1
    while high > 1 and z_um[high - 2] > highest + reach_um:
        high -= 1
    return (first, stop), (low, high)


@lean_part
def _add_pairs(
    grey: Float32s,
    z_um: Float64s,
    step_um: Real,
    middle_um: Real,
    reach: Int,
    gain: Real,
    floor: Real,
    i: Int,
    j: Int,
    out: Symmetry,
) -> None:
    """Sum the pairs of frames at equal distances from a height; both are interpolated alike."""
    last = z_um.size - 1
    below, above, n, total = 0, 0, 0, 0.0
    asymmetry, square, weights, variance = 0.0, 0.0, 0.0, 0.0
    while above < last and z_um[above] < middle_um:
        above += 1
    below = above
    for d in range(1, reach + 1):
        low_um, high_um = middle_um - d * step_um, middle_um + d * step_um
        if low_um < z_um[0] or high_um > z_um[last]:
            break
        while z_um[below] > low_um:
            below -= 1
        while z_um[above] < high_um:
            above += 1
        p = (low_um - z_um[below]) / (z_um[below + 1] - z_um[below])
        q = (z_um[above] - high_um) / (z_um[above] - z_um[above - 1])
        one = (1 - p) * grey[below, j] + p * grey[below + 1, j]
        other = (1 - q) * grey[above, j] + q * grey[above - 1, j]
        weight = (1 - p) ** 2 + p**2 + (1 - q) ** 2 + q**2
        n += 1
        total += one + other
        square += (one + other) ** 2
        asymmetry += (one - other) ** 2
        weights += weight
        variance += 2 * weight**2
    if n < 3:
        return
    noise = (gain * total / (2 * n) + floor) / COARSE_PX**2
    out.asymmetry[i, j] = asymmetry / noise - weights
    out.symmetry[i, j] = (square - total**2 / n) / noise - weights
    out.variance[i, j] = variance
