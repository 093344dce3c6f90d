"""One frame of a prepared field: for every pixel the light of both sheets, each blurred as its own distance asks.

Where the other sheet is far away only one sheet is read. Near a wall the front sheet hides part of the back one. How
much depends on how the two covers, each blurred in its own way, go together: rho is the correlation of the two blur
spots (+1 both sheets on one side of the focus, -1 on opposite sides). For a straight edge the result is exact at
rho = -1, 0 and 1; compositing without it would darken edges twice.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel
from wafer_viewer.rigs.virtual.optics_blur import REACH_SIGMA, Plane
from wafer_viewer.rigs.virtual.optics_levels import COVER, LATTICE_PX, LIGHT_A, LIGHT_B, WHITE, Law, Levels
from wafer_viewer.rigs.virtual.optics_stretches import STRETCH_PX, Stretches

ZERO, ONE = np.float32(0), np.float32(1)
LEAST_COVER = np.float32(1e-4)
WALL = np.float32(0.02)  # radiance of the dark wall between the sheets
UNPACK = np.float32(1 / WHITE)
REACH = np.float32(REACH_SIGMA)
Flags = np.ndarray


@fast_kernel
def compose(
    z: np.float32, law: Law, levels: Levels, height_a: Plane, height_b: Plane, stretches: Stretches, out: Plane
) -> None:
    """Fill `out` [row, col] with the radiance of a frame whose focus lies at z um."""
    rows, cols = out.shape
    lines = np.empty((3, law.variance_px2.size, cols), np.float32)
    ready = np.empty((3, law.variance_px2.size), np.bool_)
    light = np.empty((4, STRETCH_PX), np.float32)
    for y in range(rows):
        ready[:] = False
        for s in range(stretches.to_a_px.shape[1]):
            start = s * STRETCH_PX
            stop = min(start + STRETCH_PX, cols)
            a, b = height_a[y, start:stop], height_b[y, start:stop]
            lo_a, hi_a, widest_a = level_range(z, law, stretches.lowest_a[y, s], stretches.highest_a[y, s])
            lo_b, hi_b, widest_b = level_range(z, law, stretches.lowest_b[y, s], stretches.highest_b[y, s])
            reach = REACH * math.sqrt(max(widest_a, widest_b))
            if stretches.to_b_px[y, s] > reach:
                make_ready(levels, law, LIGHT_A, lo_a, hi_a, y, lines, ready)
                look_through(z, law, lines[LIGHT_A], a, start, lo_a, hi_a, out[y, start:stop])
                continue
            make_ready(levels, law, LIGHT_B, lo_b, hi_b, y, lines, ready)
            if stretches.to_a_px[y, s] > reach:
                look_through(z, law, lines[LIGHT_B], b, start, lo_b, hi_b, out[y, start:stop])
                continue
            make_ready(levels, law, LIGHT_A, lo_a, hi_a, y, lines, ready)
            make_ready(levels, law, COVER, lo_a, hi_a, y, lines, ready)
            make_ready(levels, law, COVER, lo_b, hi_b, y, lines, ready)
            look_through(z, law, lines[LIGHT_A], a, start, lo_a, hi_a, light[0])
            look_through(z, law, lines[LIGHT_B], b, start, lo_b, hi_b, light[1])
            look_through(z, law, lines[COVER], a, start, lo_a, hi_a, light[2])
            look_through(z, law, lines[COVER], b, start, lo_b, hi_b, light[3])
            mingle(z, law, a, b, light, out[y, start:stop])


@fast_kernel
def level_range(z: np.float32, law: Law, lowest: np.float32, highest: np.float32) -> tuple[int, int, np.float32]:
    """(lowest level, highest level, greatest variance) that heights between two need; each reads the next level too."""
    one, other = z - lowest, z - highest
    most = max(abs(one), abs(other))
    least = ZERO if one * other <= ZERO else min(abs(one), abs(other))
    widest = law.sharpest_px2 + law.widening * most * most
    return level_below(law, law.sharpest_px2 + law.widening * least * least), level_below(law, widest), widest


@fast_kernel
def level_below(law: Law, variance: np.float32) -> int:
    """The last level that is no wider than a variance, and has one after it."""
    level = 0
    while level < law.variance_px2.size - 2 and variance >= law.variance_px2[level + 1]:
        level += 1
    return level


@fast_kernel
def make_ready(
    levels: Levels, law: Law, channel: int, lo: int, hi: int, y: int, lines: Plane, ready: np.ndarray
) -> None:
    """Read row y of the levels lo to hi + 1 of a channel, if no stretch of this row has needed them before."""
    for level in range(lo, hi + 2):
        if not ready[channel, level]:
            ready[channel, level] = True
            if level < law.n_fine:
                read_fine(levels, channel, level, y, lines[channel, level])
            else:
                read_coarse(levels, channel, level - law.n_fine, y, lines[channel, level])


@fast_kernel
def read_fine(levels: Levels, channel: int, level: int, y: int, out: Plane) -> None:
    """Row y of a fine level."""
    row = levels.fine[channel, level, y]
    for x in range(out.size):
        out[x] = np.float32(row[x]) * UNPACK


@fast_kernel
def read_coarse(levels: Levels, channel: int, level: int, y: int, out: Plane) -> None:
    """Row y of a coarse level, by straight lines between the samples of its lattice."""
    scale, width = levels.scale[level], levels.width[level]
    place = (y + levels.row0_px) / (LATTICE_PX << scale)
    row = int(place)
    below = np.float32(place - row)
    start = levels.start[level] + row * width + levels.first[scale]
    count = levels.index[scale, out.size - 1] + 2
    upper = levels.coarse[channel, start : start + count]
    lower = levels.coarse[channel, start + width : start + width + count]
    samples = np.empty(count, np.float32)
    for i in range(count):
        samples[i] = upper[i] + below * (lower[i] - upper[i])
    index, weight = levels.index[scale], levels.weight[scale]
    for x in range(out.size):
        i = index[x]
        out[x] = samples[i] + weight[x] * (samples[i + 1] - samples[i])


@fast_kernel
def look_through(
    z: np.float32, law: Law, lines: Plane, height: Plane, start: int, lo: int, hi: int, out: Plane
) -> None:
    """A stretch of one channel as seen with the focus at z: between levels, straight in variance."""
    if lo == hi:
        near, far = lines[lo, start : start + height.size], lines[lo + 1, start : start + height.size]
        begins, per = law.variance_px2[lo], law.per_px2[lo]
        for i in range(height.size):
            d = z - height[i]
            share = min(ONE, (law.sharpest_px2 + law.widening * d * d - begins) * per)
            out[i] = near[i] + share * (far[i] - near[i])
        return
    for i in range(height.size):
        d = z - height[i]
        variance = law.sharpest_px2 + law.widening * d * d
        level = lo
        while level < hi and variance >= law.variance_px2[level + 1]:
            level += 1
        share = min(ONE, (variance - law.variance_px2[level]) * law.per_px2[level])
        near_value, far_value = lines[level, start + i], lines[level + 1, start + i]
        out[i] = near_value + share * (far_value - near_value)


@fast_kernel
def mingle(z: np.float32, law: Law, height_a: Plane, height_b: Plane, light: Plane, out: Plane) -> None:
    """The two sheets together; `light` holds the light of A and of B, and the cover blurred as A and as B is."""
    for i in range(out.size):
        a, b = z - height_a[i], z - height_b[i]
        a_in_front = a <= b
        cover_a, cover_b = light[2, i], ONE - light[3, i]
        front_light, back_light = (light[0, i], light[1, i]) if a_in_front else (light[1, i], light[0, i])
        front, back = (cover_a, cover_b) if a_in_front else (cover_b, cover_a)
        rho = law.widening * a * b / math.sqrt(
            (law.sharpest_px2 + law.widening * a * a) * (law.sharpest_px2 + law.widening * b * b)
        )
        free = ONE - front
        unrelated = back * free
        extreme = min(back, free) if rho > ZERO else max(ZERO, back - front)
        visible = unrelated + abs(rho) * (extreme - unrelated)
        wall = WALL * max(ZERO, free - visible)
        out[i] = front_light + back_light * (visible / max(back, LEAST_COVER)) + wall
