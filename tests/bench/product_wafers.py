"""Patterned wafers drawn by seed: lattices, streets, patterns, films and rims as wide as those of products.

A wafer has 1 x 2 to 16 x 16 dies, each of one pattern (pads, lines, memory, bumps, random logic), turned by up to 4.5
degrees. Its film and brightness vary from die to die and smoothly; dies may be missing, and the rim may be round.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from tests.support.surfaces import height_map
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.surface.height_map import HeightMap, Origin

Floats = NDArray[np.float64]
Dice = np.random.Generator
Pattern = Literal["pads", "lines", "memory", "bumps", "logic"]
PATTERNS: tuple[Pattern, ...] = ("pads", "lines", "memory", "bumps", "logic")
MOST_PIXELS = 900_000
FINE = 2
"""Samples of a die's pattern along a pixel of the surface."""


@dataclass(frozen=True, slots=True)
class Product:
    """A drawn wafer: its true lattice, the axes along which streets show, and what it was drawn with."""

    surface: HeightMap
    grid: DieGrid
    shown: tuple[bool, bool]
    """Streets part neighbours along x, along y."""
    missing: frozenset[tuple[int, int]]
    whole: frozenset[tuple[int, int]]
    """(col, row) of the dies that lie completely on the wafer and on the surface, missing ones included."""
    pattern: Pattern
    round_rim: bool

    @property
    def kind(self) -> str:
        """Shape of the array, as the table of the benchmark groups it."""
        n = sorted((self.grid.cols, self.grid.rows))
        if n[0] == 1:
            return "1 x 2" if n[1] == 2 else "one row or column"
        return "2 x 2 to 3 x 3" if n[1] <= 3 else "round rim" if self.round_rim else "larger"


def product(seed: int) -> Product:
    """Return the wafer of a seed."""
    dice = np.random.default_rng((seed, 41))
    cols, rows = _counts(dice)
    round_rim = min(cols, rows) >= 4 and dice.random() < 0.4
    pixel_um = float(np.exp(dice.uniform(np.log(0.3), np.log(3.0))))
    pitch = _pitch_px(dice, cols, rows)
    street = [max(3.0, float(dice.uniform(0.03, 0.16)) * p) for p in pitch]
    size = pitch[0] - street[0], pitch[1] - street[1]
    angle = float(dice.uniform(-4.5, 4.5) if dice.random() < 0.3 else dice.uniform(-0.5, 0.5))
    margin = dice.uniform(0.0, 0.5, 4) * np.array([pitch[0], pitch[0], pitch[1], pitch[1]]) + 2
    window = min(cols, rows) >= 3 and not round_rim and dice.random() < 0.4
    if window:  # a window on a larger array: dies are cut at its border
        margin = -dice.uniform(0.0, 0.45, 4) * np.array([pitch[0], pitch[0], pitch[1], pitch[1]])
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    array = (cols - 1) * pitch[0] + size[0], (rows - 1) * pitch[1] + size[1]
    shape_x = array[0] * c + array[1] * abs(s) + margin[0] + margin[1]
    shape_y = array[1] * c + array[0] * abs(s) + margin[2] + margin[3]
    n_cols, n_rows = math.ceil(shape_x), math.ceil(shape_y)
    x0 = margin[0] + (array[1] * s if s > 0 else 0.0)
    y0 = margin[2] + (-array[0] * s if s < 0 else 0.0)
    grid = DieGrid(
        pitch_x_um=pitch[0] * pixel_um,
        pitch_y_um=pitch[1] * pixel_um,
        width_um=size[0] * pixel_um,
        height_um=size[1] * pixel_um,
        x0_um=x0 * pixel_um,
        y0_um=y0 * pixel_um,
        angle_rad=math.radians(angle),
        cols=cols,
        rows=rows,
    )
    shown = (True, True)
    if not (dice.random() < 0.8 or min(cols, rows) == 1):
        shown = ((True, False), (False, True))[dice.integers(2)]
    pattern = PATTERNS[int(dice.integers(len(PATTERNS)))]
    many = cols * rows >= 9 and min(cols, rows) >= 3 and dice.random() < 0.5
    share = float(dice.uniform(0.01, 0.1)) if many else 0.0
    missing = frozenset((i, j) for i in range(cols) for j in range(rows) if dice.random() < share)
    drawn = _Drawing(dice, grid, pixel_um, (n_rows, n_cols), shown, missing, window, round_rim)
    surface, on_wafer = drawn.surface(die_pattern(pattern, dice, size))
    inside = {at for at in np.ndindex(cols, rows) if _inside(grid, at, pixel_um, (n_rows, n_cols), on_wafer)}
    return Product(surface, grid, shown, missing, frozenset(inside), pattern, round_rim)


def _counts(dice: Dice) -> tuple[int, int]:
    kind = dice.random()
    if kind < 0.1:
        pair = [1, 2]
    elif kind < 0.25:
        pair = [1, int(dice.integers(3, 13))]
    elif kind < 0.4:
        pair = [int(dice.integers(2, 4)), int(dice.integers(2, 4))]
    else:
        pair = [int(dice.integers(3, 17)), int(dice.integers(3, 17))]
    dice.shuffle(pair)
    return pair[0], pair[1]


def _pitch_px(dice: Dice, cols: int, rows: int) -> tuple[float, float]:
    """Return pitches in px; the array fits into MOST_PIXELS."""
    most = math.sqrt(MOST_PIXELS / (cols * rows))
    middle = float(np.exp(dice.uniform(np.log(min(56.0, most)), np.log(min(most, 320.0)))))
    aspect = float(np.exp(dice.uniform(-0.45, 0.45)))
    return max(40.0, middle * math.sqrt(aspect)), max(40.0, middle / math.sqrt(aspect))


@dataclass(frozen=True, slots=True)
class _Drawing:
    dice: Dice
    grid: DieGrid
    pixel_um: float
    shape: tuple[int, int]
    shown: tuple[bool, bool]
    missing: frozenset[tuple[int, int]]
    window: bool
    round_rim: bool

    def surface(self, printed: tuple[Floats, Floats]) -> tuple[HeightMap, NDArray[np.bool_]]:
        """Return the surface, and the mask of the pixels on the wafer."""
        dice, grid, pixel_um, (n_rows, n_cols) = self.dice, self.grid, self.pixel_um, self.shape
        x_um, y_um = np.arange(n_cols) * pixel_um, (n_rows - 1 - np.arange(n_rows)) * pixel_um
        x, y = np.meshgrid(x_um, y_um)
        col, row, u, v = grid.to_die(x, y)
        soft = pixel_um * 0.6
        along = _ramp(np.minimum(u, grid.width_um - u), soft) if self.shown[0] else np.ones(self.shape)
        across = _ramp(np.minimum(v, grid.height_um - v), soft) if self.shown[1] else np.ones(self.shape)
        present = self._present(col, row)
        wafer = self._wafer(x, y)
        die = along * across * present
        at = (v / pixel_um * FINE, u / pixel_um * FINE)
        on = (u > 0) & (u < grid.width_um) & (v > 0) & (v < grid.height_um) & present
        z_print, grey_print = (np.where(on, map_coordinates(p, at, order=1, mode="nearest"), 0.0) for p in printed)
        z = die * float(dice.choice([-1, 1], p=[0.2, 0.8])) * float(dice.uniform(1.0, 9.0))
        z += z_print * float(dice.uniform(0.2, 2.5))
        street, ground = self._greys()
        gain, offset = self._film(col, row)
        grey = street + die * (ground - street + offset) + grey_print * gain * float(dice.uniform(25, 70))
        reach = float(np.hypot(n_rows, n_cols))
        smooth = gaussian_filter(dice.standard_normal(self.shape), reach / 8)
        grey *= 1 + float(dice.uniform(0.0, 0.2)) * smooth / np.abs(smooth).max()
        far = ((x - x.mean()) ** 2 + (y - y.mean()) ** 2) / max(np.ptp(x), np.ptp(y)) ** 2
        z += float(dice.uniform(0, 15)) * far + float(dice.uniform(-10, 10)) * (x - x.mean()) / np.ptp(x)
        z += float(dice.uniform(0.1, 0.3)) * dice.standard_normal(self.shape)
        grey = gaussian_filter(grey, float(dice.uniform(0.3, 0.9))) + float(dice.uniform(2, 5)) * dice.standard_normal(
            self.shape
        )
        z[~wafer] -= 60.0
        grey[~wafer] = 14 + 3 * dice.standard_normal(int((~wafer).sum()))
        holes = gaussian_filter(dice.standard_normal(self.shape), 2.0)
        z[holes > np.quantile(holes, 1 - float(dice.uniform(0.01, 0.1)))] = np.nan
        z[~wafer & (dice.random(self.shape) < 0.5)] = np.nan
        origin = np.where(np.isfinite(z), Origin.MEASURED, Origin.NO_TEXTURE).astype(np.uint8)
        seen = np.clip(grey, 0, 255).astype(np.uint8)
        made = height_map(z, pixel_um, y0_um=float(y_um[0]), grey=seen, origin=origin, simulated=True)
        return made, wafer

    def _present(self, col: NDArray[np.int64], row: NDArray[np.int64]) -> NDArray[np.bool_]:
        inside = np.ones(self.shape, bool)
        if not self.window:
            inside = (col >= 0) & (col < self.grid.cols) & (row >= 0) & (row < self.grid.rows)
        for i, j in self.missing:
            inside &= (col != i) | (row != j)
        return inside

    def _wafer(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        if not self.round_rim:
            return np.ones(self.shape, bool)
        far = np.hypot((x - x.mean()) / np.ptp(x), (y - y.mean()) / np.ptp(y))
        return far < 0.5

    def _greys(self) -> tuple[float, float]:
        street, ground = self.dice.uniform(60, 170, 2)
        apart = 18.0
        if abs(street - ground) < apart:
            ground = street + math.copysign(apart, ground - street)
        return float(street), float(ground)

    def _film(self, col: NDArray[np.int64], row: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return gain and offset of the picture of each pixel's die."""
        spread = float(self.dice.uniform(0.0, 0.12)), float(self.dice.uniform(0.0, 12.0))
        at = row - row.min(), col - col.min()
        shape = at[0].max() + 1, at[1].max() + 1
        gain, offset = (self.dice.standard_normal(shape)[at] for _ in spread)
        return 1.0 + spread[0] * gain, spread[1] * offset


def _ramp(inward_um: Floats, soft_um: float) -> Floats:
    return np.clip(inward_um / soft_um / 2 + 0.5, 0, 1)


def _inside(
    grid: DieGrid, at: tuple[int, int], pixel_um: float, shape: tuple[int, int], wafer: NDArray[np.bool_]
) -> bool:
    u, v = grid.width_um * np.array([0, 1, 1, 0]), grid.height_um * np.array([0, 0, 1, 1])
    x_um, y_um = grid.to_stage(*at, u, v)
    cols, rows = np.rint(x_um / pixel_um).astype(int), np.rint(shape[0] - 1 - y_um / pixel_um).astype(int)
    within = (cols >= 0) & (cols < shape[1]) & (rows >= 0) & (rows < shape[0])
    return bool(within.all() and wafer[rows, cols].all())


# ------------------------------------------------------------------------------------------------------------- patterns


def die_pattern(pattern: Pattern, dice: Dice, size_px: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return what is printed on a die, in height and in grey, -1 to 1; rows count upwards, FINE samples a px."""
    cols, rows = (math.ceil(FINE * n) + 1 for n in size_px)
    drawn = {"pads": _pads, "lines": _lines, "memory": _memory, "bumps": _bumps, "logic": _logic}[pattern](
        dice, rows, cols
    )
    border = max(FINE * 2, round(0.02 * min(rows, cols)))
    inner = np.zeros((rows, cols))
    inner[border:-border, border:-border] = drawn[border:-border, border:-border]
    mark_y, mark_x = rows // 12 + border, cols // 10 + border
    inner[border + 2 : mark_y, border + 2 : mark_x] = float(dice.choice([-1, 1]))
    return inner, inner * float(dice.choice([-1, 1]))


def _periodic(n: int, pitch: float, share: float, low: float, high: float) -> NDArray[np.bool_]:
    k = np.arange(n)
    return ((k - low * n) % pitch < share * pitch) & (k > low * n) & (k < high * n)


def _pads(dice: Dice, rows: int, cols: int) -> Floats:
    """Pads along two or four sides, and two blocks."""
    drawn = np.zeros((rows, cols))
    pitch = float(dice.uniform(7, 12)) * FINE
    deep = max(3 * FINE, round(0.05 * min(rows, cols)))
    edge = round(0.05 * min(rows, cols)) + 2 * FINE
    across = _periodic(cols, pitch, 0.55, 0.08, 0.92)
    drawn[edge : edge + deep, across] = 1
    drawn[-edge - deep : -edge, across] = 1
    if dice.random() < 0.6:
        up = _periodic(rows, pitch, 0.55, 0.12, 0.88)
        drawn[up, edge : edge + deep] = 1
        drawn[up, -edge - deep : -edge] = 1
    for _ in range(2):
        _rectangle(dice, drawn, 0.25, 0.15, 0.5)
    return drawn


def _lines(dice: Dice, rows: int, cols: int) -> Floats:
    """Lines and spaces over most of the die."""
    low, high = dice.uniform(0.05, 0.2), dice.uniform(0.8, 0.95)
    pitch = float(dice.uniform(5, 11)) * FINE
    upright = dice.random() < 0.5
    along, across = (rows, cols) if upright else (cols, rows)
    k = np.arange(along)
    drawn = np.outer((k > low * along) & (k < high * along), _periodic(across, pitch, 0.5, low, high)).astype(float)
    return drawn if upright else drawn.T


def _memory(dice: Dice, rows: int, cols: int) -> Floats:
    """Banks of cells beside each other, with a spine of logic between them."""
    drawn = np.zeros((rows, cols))
    banks_x, banks_y = int(dice.integers(2, 5)), int(dice.integers(2, 5))
    pitch = dice.uniform(5, 9, 2) * FINE
    fine = np.outer(np.arange(rows) % pitch[0] < 0.5 * pitch[0], np.arange(cols) % pitch[1] < 0.6 * pitch[1])
    u, v = (np.arange(cols) / cols * banks_x) % 1, (np.arange(rows) / rows * banks_y) % 1
    bank = np.outer((v > 0.1) & (v < 0.9), (u > 0.08) & (u < 0.92))
    drawn[bank] = 0.3
    drawn[bank & fine] = 0.9
    return drawn


def _bumps(dice: Dice, rows: int, cols: int) -> Floats:
    """A grid of round bumps over the whole die, a few left out."""
    pitch = float(dice.uniform(8, 16)) * FINE
    n_y, n_x = max(2, int(0.94 * rows / pitch)), max(2, int(0.94 * cols / pitch))
    y, x = np.meshgrid(np.arange(rows) - rows / 2, np.arange(cols) - cols / 2, indexing="ij")
    i, j = np.rint(x / pitch - (n_x - 1) / 2 % 1), np.rint(y / pitch - (n_y - 1) / 2 % 1)
    off = np.hypot(x - (i + (n_x - 1) / 2 % 1) * pitch, y - (j + (n_y - 1) / 2 % 1) * pitch)
    on = (off < 0.3 * pitch) & (np.abs(x) < n_x * pitch / 2) & (np.abs(y) < n_y * pitch / 2)
    left_out = (np.hypot(i, j * 1.7) % 5) < 0.4 if dice.random() < 0.5 else np.zeros_like(on)
    return (on & ~left_out).astype(float)


def _logic(dice: Dice, rows: int, cols: int) -> Floats:
    """Random rectangles."""
    drawn = np.zeros((rows, cols))
    for _ in range(int(dice.integers(25, 90))):
        _rectangle(dice, drawn, float(dice.uniform(0.02, 0.3)), 0.05, 0.95)
    return drawn


def _rectangle(dice: Dice, drawn: Floats, size: float, low: float, high: float) -> None:
    rows, cols = drawn.shape
    height, width = (max(2 * FINE, round(float(dice.uniform(0.4, 1.0)) * size * n)) for n in (rows, cols))
    top, left = (round(float(dice.uniform(low, max(low, high - size))) * n) for n in (rows, cols))
    drawn[top : top + height, left : left + width] = float(dice.uniform(-1, 1))


# -------------------------------------------------------------------------------------------------------------- verdict


def judged(found: DieGrid, true: Product) -> tuple[bool, str]:
    """Return whether all whole dies were found with their size, else what is wrong.

    Along an axis whose streets do not show only the pitch is judged; in a single row or column its number of rows.
    """
    grid, pixel_um = true.grid, true.surface.pixel_um
    for axis, n in (("x", grid.cols), ("y", grid.rows)):
        if n == 1 and (found.cols, found.rows)["xy".index(axis)] != 1:
            return False, f"more than one die along {axis}"
        asked, seen = (getattr(g, f"pitch_{axis}_um") for g in (grid, found))
        if n > 1 and abs(seen - asked) * (n - 1) > 1.0 * pixel_um + 0.003 * asked:
            return False, f"pitch {axis} {seen / pixel_um:.2f} for {asked / pixel_um:.2f} px"
    off = []
    for at in true.whole:
        x, y = grid.to_stage(*at, grid.width_um / 2, grid.height_um / 2)
        col, row, _, _ = found.to_die(x, y)
        corners = [(0.0, 0.0), (1.0, 1.0)]
        for i, j in corners:
            there = found.to_stage(col, row, i * found.width_um, j * found.height_um)
            _, _, u, v = _of_die(grid, at, there)
            off.append((abs(u - i * grid.width_um), abs(v - j * grid.height_um)))
    most = np.max(off, axis=0) / pixel_um if off else np.zeros(2)
    for k, axis in enumerate("xy"):
        limit = 2.0 + 0.005 * (grid.pitch_x_um, grid.pitch_y_um)[k] / pixel_um
        if true.shown[k] and most[k] > limit:
            return False, f"edges along {axis} {most[k]:.1f} px off"
    return True, ""


def _of_die(grid: DieGrid, at: tuple[int, int], stage: tuple[Floats, Floats]) -> tuple[int, int, float, float]:
    c, s = math.cos(grid.angle_rad), math.sin(grid.angle_rad)
    dx, dy = float(stage[0]) - grid.x0_um, float(stage[1]) - grid.y0_um
    return *at, c * dx + s * dy - at[0] * grid.pitch_x_um, c * dy - s * dx - at[1] * grid.pitch_y_um


def without_heights(true: Product) -> Product:
    """Return the wafer with nothing measured in height, as a plain picture."""
    nothing = np.full(true.surface.shape, np.nan, np.float32)
    blank = {"z_um": nothing, "z_raw_um": nothing, "origin": np.full(true.surface.shape, Origin.NO_TEXTURE, np.uint8)}
    return dataclasses.replace(true, surface=dataclasses.replace(true.surface, **blank))
