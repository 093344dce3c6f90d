"""Imaging model of the virtual microscope: the image of one field of a scene at any focus height.

A point out of focus spreads to a Gaussian of
    sigma(z)^2 = (0.21 wavelength / NA)^2 + (NA (z - h) / 2)^2
so a field is blurred in advance at some thirty levels (blur_levels), and a frame is read from the two levels next to
each pixel's own sigma (frame_composition). Light bleeds over walls as in a microscope, because each sheet is blurred
together with the dark area that the other sheet covers.

Most stretches see one sheet only, at nearly one height, and knowing this in advance saves most of a frame's work.

Where the other sheet is far away only one sheet is read. Near a wall the front sheet hides part of the back one. The
hidden share depends on the relation of the two blurred covers: rho is the correlation of the two blur spots (+1 both
sheets on one side of the focus, -1 on opposite sides). For a straight edge the result is exact at rho = -1, 0 and 1;
compositing without it would darken edges twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.optics.blur import (
    COVER,
    FINE_MARGIN,
    LATTICE_PX,
    LIGHT_A,
    LIGHT_B,
    REACH_SIGMA,
    WHITE,
    BlurLevels,
    Law,
    Plane,
    blur_law,
    coarse_window,
    make_levels,
)
from wafer_viewer.rigs.virtual.scenes.catalogue import Scene, SceneWindow
from wafer_viewer.rigs.virtual.scenes.drawing import Integer, SceneSheets

# ---------------------------------------------------------------------------------------------------- frame composition


STRETCH_PX = 48
BLOCK = 4  # lattice samples along a side of a block that is wholly A, wholly B or mixed
NOWHERE_PX = 1e6


class Stretches(NamedTuple):
    """float32 [row, stretch] each: height range of each sheet in um, distance in px to the nearest point of each."""

    lowest_a: Plane
    highest_a: Plane
    lowest_b: Plane
    highest_b: Plane
    to_a_px: Plane
    to_b_px: Plane


def make_stretches(
    frame: SceneWindow, height_a: Plane, height_b: Plane, lattice: SceneWindow, cover: Plane
) -> Stretches:
    """Return the stretches of a frame; `cover` is on the lattice, which extends beyond the frame."""
    blocks = cover.reshape(lattice.rows // BLOCK, BLOCK, lattice.cols // BLOCK, BLOCK)
    some_a, some_b = blocks.max((1, 3)) > 0.001, blocks.min((1, 3)) < 0.999
    block_px = BLOCK * round(lattice.step_um / frame.step_um)
    return Stretches(
        *extremes(height_a),
        *extremes(height_b),
        nearest(distance_px(some_a, block_px), frame, lattice, block_px),
        nearest(distance_px(some_b, block_px), frame, lattice, block_px),
    )


def extremes(height: Plane) -> tuple[Plane, Plane]:
    """Return the least and the greatest value of every stretch of a plane."""
    rows, cols = height.shape
    padded = np.pad(height, ((0, 0), (0, -cols % STRETCH_PX)), mode="edge").reshape(rows, -1, STRETCH_PX)
    return padded.min(2), padded.max(2)


def distance_px(there: NDArray[np.bool_], block_px: int) -> Plane:
    """Return a lower bound in px of the distance from a block to the nearest block that is `there`."""
    if not there.any():
        return np.full(there.shape, NOWHERE_PX, np.float32)
    blocks = np.asarray(distance_transform_edt(~there))
    return (blocks * block_px - 2 * block_px).astype(np.float32)


def nearest(distance: Plane, frame: SceneWindow, lattice: SceneWindow, block_px: int) -> Plane:
    """Return the least distance of the blocks that each stretch of the frame touches."""
    row0_px = (lattice.y0_um - frame.y0_um) / frame.step_um
    col0_px = (frame.x0_um - lattice.x0_um) / frame.step_um
    rows = ((np.arange(frame.rows) + row0_px) / block_px).astype(int)
    starts = np.arange(0, frame.cols, STRETCH_PX)[:, None] + np.arange(0, STRETCH_PX + block_px, block_px)
    cols = np.minimum(((starts + col0_px) / block_px).astype(int), distance.shape[1] - 1)
    return distance[:, cols].min(2)[rows]


ZERO, ONE = np.float32(0), np.float32(1)
LEAST_COVER = np.float32(1e-4)
WALL = np.float32(0.02)  # radiance of the dark wall between the sheets
UNPACK = np.float32(1 / WHITE)
REACH = np.float32(REACH_SIGMA)
SEES_A, SEES_B, SEES_BOTH = np.arange(1, 4)  # numpy integers: numba compiles a kernel anew for every literal


class CompositionPlan(NamedTuple):
    """Lowest and highest blur level of each sheet, and visible sheets, for each stretch of one row.

    A pixel is interpolated between two levels, so the level after the highest is needed too.
    """

    lowest_a: NDArray[np.int64]
    highest_a: NDArray[np.int64]
    lowest_b: NDArray[np.int64]
    highest_b: NDArray[np.int64]
    sees: NDArray[np.int64]


class VisibleScene(NamedTuple):
    """One row: the light of A and of B, and the cover of A, blurred as A is and as B is."""

    light_a: Plane
    light_b: Plane
    cover_a: Plane
    cover_b: Plane


class SceneHeights(NamedTuple):
    """Both sheets of a frame in um, [row, col]."""

    a: Plane
    b: Plane


def compose(z_um: float, law: Law, levels: BlurLevels, heights: SceneHeights, stretches: Stretches) -> Plane:
    """Return the radiance [row, col] of a frame with the focus at z_um."""
    rows, cols = heights.a.shape
    plan = CompositionPlan(*np.empty((5, stretches.to_a_px.shape[1]), np.int64))
    lines = np.empty((3, law.variance_px2.size, cols), np.float32)
    seen = VisibleScene(*np.empty((4, cols), np.float32))
    out = np.empty((rows, cols), np.float32)
    compose_rows(np.float32(z_um), law, levels, heights, stretches, plan, lines, seen, out)
    return out


@fast_kernel
def compose_rows(
    z: np.float32,
    law: Law,
    levels: BlurLevels,
    heights: SceneHeights,
    stretches: Stretches,
    plan: CompositionPlan,
    lines: Plane,
    seen: VisibleScene,
    out: Plane,
) -> None:
    """Fill a frame in passes over entire rows; calls per stretch would be dominated by reference counting."""
    for y in range(out.shape[0]):
        a, b = heights.a[y], heights.b[y]
        plan_row(z, law, stretches, y, plan)
        read_row(levels, law, y, plan, lines)
        look_along(z, law, lines[LIGHT_A], a, plan.lowest_a, plan.highest_a, plan.sees, SEES_A, seen.light_a)
        look_along(z, law, lines[LIGHT_B], b, plan.lowest_b, plan.highest_b, plan.sees, SEES_B, seen.light_b)
        look_along(z, law, lines[COVER], a, plan.lowest_a, plan.highest_a, plan.sees, SEES_BOTH, seen.cover_a)
        look_along(z, law, lines[COVER], b, plan.lowest_b, plan.highest_b, plan.sees, SEES_BOTH, seen.cover_b)
        join_row(z, law, a, b, seen, plan.sees, out[y])


@fast_part
def plan_row(z: np.float32, law: Law, stretches: Stretches, y: int, plan: CompositionPlan) -> None:
    """Set the levels and visible sheets of every stretch of row y."""
    for s in range(plan.sees.size):
        lowest_a, highest_a, widest_a = level_range(z, law, stretches.lowest_a[y, s], stretches.highest_a[y, s])
        lowest_b, highest_b, widest_b = level_range(z, law, stretches.lowest_b[y, s], stretches.highest_b[y, s])
        plan.lowest_a[s], plan.highest_a[s] = lowest_a, highest_a
        plan.lowest_b[s], plan.highest_b[s] = lowest_b, highest_b
        reach = REACH * math.sqrt(max(widest_a, widest_b))
        if stretches.to_b_px[y, s] > reach:
            plan.sees[s] = SEES_A
        elif stretches.to_a_px[y, s] > reach:
            plan.sees[s] = SEES_B
        else:
            plan.sees[s] = SEES_BOTH


@fast_part
def level_range(z: np.float32, law: Law, lowest: np.float32, highest: np.float32) -> tuple[int, int, np.float32]:
    """Return (lowest level, highest level, greatest variance) for a range of heights."""
    one, other = z - lowest, z - highest
    most = max(abs(one), abs(other))
    least = ZERO if one * other <= ZERO else min(abs(one), abs(other))
    widest = law.sharpest_px2 + law.widening * most * most
    return level_below(law, law.sharpest_px2 + law.widening * least * least), level_below(law, widest), widest


@fast_part
def level_below(law: Law, variance: np.float32) -> int:
    """Return the last level that is no wider than a variance and is not the last of all."""
    level = 0
    while level < law.variance_px2.size - 2 and variance >= law.variance_px2[level + 1]:
        level += 1
    return level


@fast_part
def read_row(levels: BlurLevels, law: Law, y: int, plan: CompositionPlan, lines: Plane) -> None:
    """Read row y of every needed level, each once."""
    needed = np.zeros((lines.shape[0], lines.shape[1]), np.bool_)
    for s in range(plan.sees.size):
        for level in range(plan.lowest_a[s], plan.highest_a[s] + 2):
            needed[LIGHT_A, level] |= plan.sees[s] & SEES_A != 0
            needed[COVER, level] |= plan.sees[s] == SEES_BOTH
        for level in range(plan.lowest_b[s], plan.highest_b[s] + 2):
            needed[LIGHT_B, level] |= plan.sees[s] & SEES_B != 0
            needed[COVER, level] |= plan.sees[s] == SEES_BOTH
    for channel in range(3):
        for level in range(needed.shape[1]):
            if needed[channel, level] and level < law.n_fine:
                read_fine(levels, channel, level, y, lines[channel, level])
            elif needed[channel, level]:
                read_coarse(levels, channel, level - law.n_fine, y, lines[channel, level])


@fast_part
def read_fine(levels: BlurLevels, channel: int, level: int, y: int, out: Plane) -> None:
    """Read row y of a fine level."""
    row = levels.fine[channel, level, y]
    for x in range(out.size):
        out[x] = np.float32(row[x]) * UNPACK


@fast_part
def read_coarse(levels: BlurLevels, channel: int, level: int, y: int, out: Plane) -> None:
    """Read row y of a coarse level, by linear interpolation between its lattice samples."""
    scale, width = levels.scale[level], levels.width[level]
    place = (y + levels.row0_px) / (LATTICE_PX << scale)
    row = int(place)
    below = np.float32(place - row)
    start = levels.start[level] + row * width + levels.first[scale]
    count = levels.left[scale, out.size - 1] + 2
    upper = levels.coarse[channel, start : start + count]
    lower = levels.coarse[channel, start + width : start + width + count]
    samples = np.empty(count, np.float32)
    for i in range(count):
        samples[i] = upper[i] + below * (lower[i] - upper[i])
    left, weight = levels.left[scale], levels.weight[scale]
    for x in range(out.size):
        i = left[x]
        out[x] = samples[i] + weight[x] * (samples[i + 1] - samples[i])


@fast_part
def look_along(
    z: np.float32,
    law: Law,
    lines: Plane,
    height: Plane,
    lowest: NDArray[np.int64],
    highest: NDArray[np.int64],
    sees: NDArray[np.int64],
    wanted: Integer,
    out: Plane,
) -> None:
    """Interpolate one row of a channel for the focus at z, in the stretches that see the wanted sheets.

    Between levels the light is linear in the variance.
    """
    for s in range(sees.size):
        if sees[s] & wanted != wanted:
            continue
        start, stop = s * STRETCH_PX, min((s + 1) * STRETCH_PX, out.size)
        lo, hi = lowest[s], highest[s]
        if lo == hi:
            near, far, begins, per = lines[lo], lines[lo + 1], law.variance_px2[lo], law.per_px2[lo]
            for x in range(start, stop):
                d = z - height[x]
                share = min(ONE, (law.sharpest_px2 + law.widening * d * d - begins) * per)
                out[x] = near[x] + share * (far[x] - near[x])
        else:
            for x in range(start, stop):
                d = z - height[x]
                variance = law.sharpest_px2 + law.widening * d * d
                level = lo
                while level < hi and variance >= law.variance_px2[level + 1]:
                    level += 1
                share = min(ONE, (variance - law.variance_px2[level]) * law.per_px2[level])
                out[x] = lines[level, x] + share * (lines[level + 1, x] - lines[level, x])


@fast_part
def join_row(
    z: np.float32, law: Law, height_a: Plane, height_b: Plane, seen: VisibleScene, sees: NDArray[np.int64], out: Plane
) -> None:
    """Compose one row of the frame from the contributions of both sheets."""
    light_a, light_b, cover_a, cover_b = seen
    for s in range(sees.size):
        start, stop = s * STRETCH_PX, min((s + 1) * STRETCH_PX, out.size)
        if sees[s] != SEES_BOTH:
            only = light_a if sees[s] == SEES_A else light_b
            for x in range(start, stop):
                out[x] = only[x]
        else:
            for x in range(start, stop):
                a, b = z - height_a[x], z - height_b[x]
                rho = correlation(law.sharpest_px2, law.widening, a, b)
                if a <= b:
                    out[x] = over(light_a[x], cover_a[x], light_b[x], ONE - cover_b[x], rho)
                else:
                    out[x] = over(light_b[x], ONE - cover_b[x], light_a[x], cover_a[x], rho)


@fast_part
def correlation(sharpest: np.float32, widening: np.float32, a: np.float32, b: np.float32) -> np.float32:
    """Return the correlation of the blur spots of two points, a and b um out of focus: 1 alike, -1 mirrored."""
    return widening * a * b / math.sqrt((sharpest + widening * a * a) * (sharpest + widening * b * b))


@fast_part
def over(
    front_light: np.float32, front: np.float32, back_light: np.float32, back: np.float32, rho: np.float32
) -> np.float32:
    """Return the light of a front sheet and of the visible part of the back one; front and back are their covers."""
    free = ONE - front
    unrelated = back * free
    extreme = min(back, free) if rho > ZERO else max(ZERO, back - front)
    visible = unrelated + abs(rho) * (extreme - unrelated)
    return front_light + back_light * (visible / max(back, LEAST_COVER)) + WALL * max(ZERO, free - visible)


# --------------------------------------------------------------------------------------------------------------- optics


@dataclass(frozen=True, slots=True)
class Optics:
    """Objective, light and pixel of the virtual microscope; by default 10x / 0.28 in green light."""

    na: float = 0.28
    wavelength_um: float = 0.55
    pixel_um: float = 0.46729

    @property
    def depth_of_field_um(self) -> float:
        """Depth of field lambda / NA^2 + e / (M NA) in air; e / M is the pixel size on the sample."""
        return self.wavelength_um / self.na**2 + self.pixel_um / self.na

    @property
    def sharpest_um(self) -> float:
        """Sigma of a point in focus."""
        return 0.21 * self.wavelength_um / self.na

    def sigma_um(self, defocus_um: float) -> float:
        """Return the sigma of a point defocus_um out of focus."""
        return math.hypot(self.sharpest_um, self.na * defocus_um / 2)


class FieldPicture:
    """Field of view, prepared for fast rendering of frames at any z.

    (x_um, y_um) is the centre of a frame of rows x cols. Frames outside z_range_um may have too little blur. A field of
    1080 x 1440 takes about 170 MB.
    """

    def __init__(
        self,
        scene: Scene,
        optics: Optics,
        x_um: float,
        y_um: float,
        rows: int,
        cols: int,
        z_range_um: tuple[float, float],
    ) -> None:
        frame = centred_window(x_um, y_um, rows, cols, optics.pixel_um)
        near = scene.raster(frame.grown(FINE_MARGIN))
        inner = SceneSheets(
            *(np.ascontiguousarray(p[FINE_MARGIN:-FINE_MARGIN, FINE_MARGIN:-FINE_MARGIN]) for p in near)
        )
        law = law_for(optics, inner, z_range_um)
        lattice = coarse_window(frame, law)
        far = scene.raster(lattice)
        self._law = law
        self._heights = SceneHeights(inner.height_a, inner.height_b)
        self._surface_um = inner.surface_um()
        self._levels = make_levels(frame, lattice, near, far, law)
        self._stretches = make_stretches(frame, inner.height_a, inner.height_b, lattice, far.cover)

    def radiance(self, z_um: float) -> Plane:
        """Return the image with the focus at z_um, float32 [row, col]; 1 is white at the scene's gain."""
        return compose(z_um, self._law, self._levels, self._heights, self._stretches)

    def truth(self) -> Plane:
        """Return the true height in um of every pixel, as seen from straight above. For tests only."""
        return self._surface_um


def centred_window(x_um: float, y_um: float, rows: int, cols: int, pixel_um: float) -> SceneWindow:
    """Return the window of a frame with a given centre."""
    return SceneWindow(x_um - (cols - 1) / 2 * pixel_um, y_um + (rows - 1) / 2 * pixel_um, pixel_um, rows, cols)


def law_for(optics: Optics, sheets: SceneSheets, z_range_um: tuple[float, float]) -> Law:
    """Return the blur law in pixels, with enough levels for every height of a field over a range of z."""
    lowest = min(sheets.height_a.min(), sheets.height_b.min())
    highest = max(sheets.height_a.max(), sheets.height_b.max())
    farthest = max(z_range_um[1] - lowest, highest - z_range_um[0])
    per_um = optics.na / 2 / optics.pixel_um
    return blur_law(optics.sharpest_um / optics.pixel_um, per_um**2, float(farthest))
