"""Blur levels of one field, by a Gaussian with exact discrete variance.

Blur levels are computed from one another, so an error in the variance of one would propagate to the next.

Three channels are blurred: the light of sheet A where it covers, the light of sheet B where A does not, and the cover
itself. Fine levels are uint16 to save memory. Coarse ones are float32 on lattices that are anchored to the stage and
not to the frame, so that neighbouring fields read the same values.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.scenes.catalogue import SceneWindow
from wafer_viewer.rigs.virtual.scenes.drawing import SceneSheets

Plane = NDArray[np.float32]
REACH_SIGMA = 3.3


def gaussian_half(variance_px2: float) -> Plane:
    """Return the weights of a symmetric Gaussian from its centre outwards, of exactly this discrete variance.

    The number of outer weights is even (the last may be 0), because the kernel processes them in pairs.
    """
    sigma = math.sqrt(max(variance_px2, 1e-6))
    reach = max(1, math.ceil(REACH_SIGMA * sigma))
    offset = np.arange(reach + 1)
    twice = np.where(offset == 0, 1.0, 2.0)
    weights = np.ones(reach + 1)
    for _ in range(12):
        weights = np.exp(-(offset**2) / (2 * sigma**2))
        weights /= np.sum(twice * weights)
        sigma *= math.sqrt(variance_px2 / np.sum(twice * weights * offset**2))
    return np.pad(weights, (0, reach % 2)).astype(np.float32)


def blurred(plane: Plane, variance_px2: float) -> Plane:
    """Return the plane [row, col] blurred by a Gaussian of a variance in px^2, with edge values repeated outside."""
    out = np.empty_like(plane)
    convolve(plane, gaussian_half(variance_px2), out)
    return out


@fast_kernel
def convolve(plane: Plane, half: Plane, out: Plane) -> None:
    """Blur row by row, first along the columns and then along the row while it is in the cache."""
    rows, cols = plane.shape
    reach = half.size - 1
    line = np.empty(cols + 2 * reach, np.float32)
    for y in range(rows):
        down_columns(plane, y, half, line[reach : reach + cols])
        for x in range(reach):
            line[x] = line[reach]
            line[reach + cols + x] = line[reach + cols - 1]
        along_row(line, half, out[y])


@fast_part
def down_columns(plane: Plane, y: int, half: Plane, out: Plane) -> None:
    """Blur one row of the plane along the columns."""
    last = plane.shape[0] - 1
    centre = plane[y]
    for x in range(out.size):
        out[x] = half[0] * centre[x]
    for d in range(1, half.size, 2):
        up, down = plane[max(y - d, 0)], plane[min(y + d, last)]
        farther_up, farther_down = plane[max(y - d - 1, 0)], plane[min(y + d + 1, last)]
        near, far = half[d], half[d + 1]
        for x in range(out.size):
            out[x] += near * (up[x] + down[x]) + far * (farther_up[x] + farther_down[x])


@fast_part
def along_row(line: Plane, half: Plane, out: Plane) -> None:
    """Blur a line that has a margin on both sides."""
    reach = half.size - 1
    for x in range(out.size):
        out[x] = half[0] * line[x + reach]
    for d in range(1, half.size, 2):
        near, far = half[d], half[d + 1]
        left, right = line[reach - d :], line[reach + d :]
        farther_left, farther_right = line[reach - d - 1 :], line[reach + d + 1 :]
        for x in range(out.size):
            out[x] += near * (left[x] + right[x]) + far * (farther_left[x] + farther_right[x])


LIGHT_A, LIGHT_B, COVER = range(3)
FINE_SIGMA_PX = (0.98, 1.1, 1.25, 1.45, 1.7, 2.0, 2.4, 2.9, 3.5, 4.2)
COARSE_SIGMA_PX = (5, 6, 7.2, 8.6, 10.4, 12.5, 15, 18, 21.6, 26, 31, 37, 45, 54, 64, 77, 92, 110, 132, 158)
CASCADE_FROM_PX = 1.6  # below it a level comes from the raster: the step from the last would be too small a Gaussian
FINE_MARGIN = 16  # px round the frame that the fine levels are made from
LATTICE_PX = 2  # spacing of the finest coarse lattice; the others have 4, 8 and 16 px
SCALES = 4
ANCHOR_PX = 32  # coarse lattices begin at multiples of this
BOX_VARIANCE = 1 / 12  # of a sample's footprint, in steps of its lattice
WHITE = np.float32(16384)  # what a fine level holds for radiance 1


class Law(NamedTuple):
    """Blur law in pixels: variance = sharpest_px2 + widening * (z - h)^2, and the levels that sample it."""

    sharpest_px2: np.float32
    widening: np.float32
    n_fine: int
    variance_px2: Plane
    per_px2: Plane
    """Reciprocal of the variance step from each level to the next."""


class BlurLevels(NamedTuple):
    """Blurred channels. Levels are numbered consecutively, fine ones first."""

    fine: NDArray[np.uint16]
    """[channel, level, row, col]"""
    coarse: Plane
    """[channel, sample]: all lattices, concatenated"""
    start: NDArray[np.int64]
    """Index of the first sample of each coarse level."""
    width: NDArray[np.int64]
    """Number of lattice columns of each coarse level."""
    scale: NDArray[np.int64]
    """Lattice spacing of each coarse level as LATTICE_PX << scale."""
    row0_px: float
    """Position of frame row 0 on the lattice, in px."""
    first: NDArray[np.int64]
    """Lattice column left of frame column 0, for each scale."""
    left: NDArray[np.int32]
    """[scale, col]: lattice column left of each frame column, relative to first"""
    weight: Plane
    """[scale, col]: interpolation weight of the lattice column on its right"""


def blur_law(sharpest_px: float, widening: float, farthest_um: float) -> Law:
    """Return the law with levels up to the blur of the farthest sheet; beyond the last level the blur is constant."""
    needed = math.sqrt(sharpest_px**2 + widening * farthest_um**2)
    fine = [sharpest_px, *(s for s in FINE_SIGMA_PX if s > 1.05 * sharpest_px)]
    ladder = [*fine, *COARSE_SIGMA_PX]
    count = max(int(np.searchsorted(ladder, needed)) + 1, len(fine) + 1)
    variance = np.square(ladder[:count]).astype(np.float32)
    per = np.append(1 / np.diff(variance), 0).astype(np.float32)
    return Law(np.float32(sharpest_px**2), np.float32(widening), len(fine), variance, per)


def coarse_window(frame: SceneWindow, law: Law) -> SceneWindow:
    """Return the finest coarse lattice: the frame with a margin for the widest blur, anchored to the stage."""
    margin_px = int(2.6 * math.sqrt(law.variance_px2[-1])) + ANCHOR_PX
    wide = frame.grown(margin_px)
    anchor_um = ANCHOR_PX * frame.step_um
    x0 = math.floor(wide.x0_um / anchor_um) * anchor_um
    y0 = math.ceil(wide.y0_um / anchor_um) * anchor_um
    cells_across = math.ceil((wide.x0_um - x0 + wide.cols * frame.step_um) / anchor_um)
    cells_down = math.ceil((y0 - wide.y0_um + wide.rows * frame.step_um) / anchor_um)
    samples = ANCHOR_PX // LATTICE_PX
    return SceneWindow(x0, y0, LATTICE_PX * frame.step_um, cells_down * samples, cells_across * samples)


def make_levels(frame: SceneWindow, lattice: SceneWindow, near: SceneSheets, far: SceneSheets, law: Law) -> BlurLevels:
    """Return all levels of a field; `near`: its raster with margin FINE_MARGIN, `far`: its raster on the lattice."""
    fine = np.empty((3, law.n_fine, frame.rows, frame.cols), np.uint16)
    for into, channel in zip(fine, channels(near), strict=True):
        fill_fine_levels(channel, law, into)
    coarse = [coarse_levels(channel, law) for channel in channels(far)]
    sizes = np.array([level.size for level in coarse[0]])
    first, left, weight = column_readout((frame.x0_um - lattice.x0_um) / frame.step_um, frame.cols)
    return BlurLevels(
        fine=fine,
        coarse=np.stack([np.concatenate([level.ravel() for level in levels]) for levels in coarse]),
        start=np.cumsum(sizes) - sizes,
        width=np.array([level.shape[1] for level in coarse[0]]),
        scale=np.array([scale_of(sigma) for sigma in coarse_sigmas(law)]),
        row0_px=(lattice.y0_um - frame.y0_um) / frame.step_um,
        first=first,
        left=left,
        weight=weight,
    )


def channels(sheets: SceneSheets) -> tuple[Plane, Plane, Plane]:
    """Return the channels to be blurred: light of A, light of B, cover."""
    return sheets.light_a(), sheets.light_b(), sheets.cover


def fill_fine_levels(channel: Plane, law: Law, into: NDArray[np.uint16]) -> None:
    """Blur one channel to every fine level; the variance of a level includes the raster footprint."""
    if channel.min() == channel.max():
        into[:] = round(float(channel[0, 0]) * float(WHITE))
        return
    level, reached = channel, BOX_VARIANCE
    for variance, out in zip(law.variance_px2[: law.n_fine], into, strict=True):
        if variance < CASCADE_FROM_PX**2:
            level = blurred(channel, float(variance) - BOX_VARIANCE)
        else:
            level = blurred(level, float(variance) - reached)
        reached = float(variance)
        pack(level, FINE_MARGIN, out)


@fast_kernel
def pack(plane: Plane, margin: int, out: NDArray[np.uint16]) -> None:
    """Convert a plane without its margin to uint16."""
    most = np.float32(65535)
    for y in range(out.shape[0]):
        row = plane[y + margin]
        for x in range(out.shape[1]):
            out[y, x] = np.uint16(min(max(row[x + margin], np.float32(0)) * WHITE + np.float32(0.5), most))


def coarse_sigmas(law: Law) -> list[float]:
    """Return the sigma of every coarse level in px."""
    return [math.sqrt(variance) for variance in law.variance_px2[law.n_fine :]]


def scale_of(sigma_px: float) -> int:
    """Return the lattice scale of a blur: a sample spacing of at most 0.45 sigma."""
    return sum(sigma_px > limit for limit in (10, 20, 40))


def coarse_levels(channel: Plane, law: Law) -> list[Plane]:
    """Return one channel at every coarse level, each computed from the one before.

    Linear interpolation on a lattice of spacing s adds a variance of s^2 / 6, which is subtracted here.
    """
    levels: list[Plane] = []
    plane, scale = channel, 0
    reached = LATTICE_PX**2 * BOX_VARIANCE
    for sigma in coarse_sigmas(law):
        while scale < scale_of(sigma):
            plane, scale = np.ascontiguousarray(plane[::2, ::2]), scale + 1
        spacing = LATTICE_PX << scale
        wanted = sigma**2 - spacing**2 / 6
        plane = blurred(plane, (wanted - reached) / spacing**2)
        reached = wanted
        levels.append(plane)
    return levels


def column_readout(col0_px: float, cols: int) -> tuple[NDArray[np.int64], NDArray[np.int32], Plane]:
    """Return (first, left, weight) of BlurLevels; col0_px: frame column 0 from the first lattice sample, px."""
    place = (col0_px + np.arange(cols)) / (LATTICE_PX << np.arange(SCALES))[:, None]
    column = np.floor(place)
    first = column[:, 0].astype(np.int64)
    return first, (column - first[:, None]).astype(np.int32), (place - column).astype(np.float32)
