"""Made-up patterned wafers as noisy height maps: dies a little off their places, bow, holes, planted defects."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tests.support.surfaces import height_map
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.surface.height_map import HeightMap

PIXEL_UM = 0.5
SIGMA_UM = 0.05
Kind = Literal["bump", "pit", "scratch"]


@dataclass(frozen=True)
class Planted:
    """One defect: its middle in pixels of the surface, diameter (of a scratch: length) in pixels, height in sigma."""

    kind: Kind
    row: float
    col: float
    size_px: float
    height_sigma: float

    @property
    def x_um(self) -> float:
        return self.col * PIXEL_UM

    @property
    def y_um(self) -> float:
        return -self.row * PIXEL_UM


@dataclass(frozen=True)
class Wafer:
    """A surface, the lattice that was used, and what was planted."""

    surface: HeightMap
    grid: DieGrid
    planted: tuple[Planted, ...]


def wafer(
    seed: int = 0,
    dies: tuple[int, int] = (5, 5),
    die_px: tuple[int, int] = (180, 180),
    planted: tuple[Planted, ...] = (),
    bow_um: float = 10.0,
    off_px: float = 0.5,
    unmeasured: float = 0.02,
    street_px: int = 20,
    angle_rad: float = 0.0,
    no_die: tuple[tuple[int, int], ...] = (),
) -> Wafer:
    """rows x cols of dies of die_px (height, width), streets between them, noise of SIGMA_UM; pixel (0, 0) at 0, 0.

    no_die: places (row, col) from the top left where the street goes on.
    """
    rng = np.random.default_rng(seed)
    pitch = die_px[0] + street_px + 0.37, die_px[1] + street_px + 0.21
    shape = round(dies[0] * pitch[0]), round(dies[1] * pitch[1])
    grid = DieGrid(
        pitch_x_um=pitch[1] * PIXEL_UM,
        pitch_y_um=pitch[0] * PIXEL_UM,
        width_um=die_px[1] * PIXEL_UM,
        height_um=die_px[0] * PIXEL_UM,
        x0_um=street_px / 2 * PIXEL_UM,
        y0_um=-(shape[0] - street_px / 2) * PIXEL_UM,
        rows=dies[0],
        cols=dies[1],
        angle_rad=angle_rad,
    )
    z = np.zeros(shape, np.float32)
    grey = np.zeros(shape, np.float32)
    off = rng.uniform(-off_px, off_px, (dies[0], dies[1], 2))
    _lay_dies(z, grey, pitch, off, die_px, street_px, no_die)
    rows, cols = np.arange(shape[0])[:, None], np.arange(shape[1])[None, :]
    z += (bow_um * (((rows / shape[0]) - 0.5) ** 2 + ((cols / shape[1]) - 0.5) ** 2) * 2).astype(np.float32)
    for each in planted:
        plant(z, each)
    z += rng.standard_normal(shape, np.float32) * np.float32(SIGMA_UM)
    grey += rng.standard_normal(shape, np.float32) * 3
    holes = rng.random(shape, np.float32) < unmeasured
    z[holes] = np.nan
    surface = height_map(z, PIXEL_UM, grey=np.clip(grey, 0, 255).astype(np.uint8))
    return Wafer(surface, grid, planted)


def scattered(seed: int, n: int, shape: tuple[int, int], size_px: float, height_sigma: float) -> tuple[Planted, ...]:
    """Bumps and pits at random places that keep clear of each other and of the border."""
    rng = np.random.default_rng(seed)
    side = math.ceil(math.sqrt(n))
    cells = rng.permutation(side * side)[:n]
    step = shape[0] / side, shape[1] / side
    out: list[Planted] = []
    for k, cell in enumerate(cells.tolist()):
        row, col = (
            (cell // side + rng.uniform(0.35, 0.65)) * step[0],
            (cell % side + rng.uniform(0.35, 0.65)) * step[1],
        )
        kind: Kind = "bump" if k % 2 == 0 else "pit"
        out.append(Planted(kind, row, col, size_px, height_sigma))
    return tuple(out)


def plant(z: NDArray[np.float32], each: Planted) -> None:
    """Add one defect: discs with a soft rim, scratches 4 px wide at 30 degrees."""
    reach = math.ceil(each.size_px / 2) + 6
    r0, c0 = max(0, round(each.row) - reach), max(0, round(each.col) - reach)
    part = z[r0 : round(each.row) + reach + 1, c0 : round(each.col) + reach + 1]
    y = np.arange(part.shape[0])[:, None] + r0 - each.row
    x = np.arange(part.shape[1])[None, :] + c0 - each.col
    if each.kind == "scratch":
        c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
        along, across = np.abs(x * c + y * s) - each.size_px / 2, np.abs(-x * s + y * c) - 2
        beyond = np.maximum(along, across)
    else:
        beyond = np.hypot(x, y) - each.size_px / 2
    sign = 1 if each.kind == "bump" else -1
    part += (sign * each.height_sigma * SIGMA_UM * np.clip(0.5 - beyond, 0, 1)).astype(np.float32)


def _lay_dies(
    z: NDArray[np.float32],
    grey: NDArray[np.float32],
    pitch: tuple[float, float],
    off: NDArray[np.float64],
    die_px: tuple[int, int],
    street_px: int,
    no_die: tuple[tuple[int, int], ...],
) -> None:
    """Every die the same: a mesa 5 um over the street with blocks of 1 um, soft over a pixel or two."""
    rng = np.random.default_rng(7)
    blocks = rng.uniform(0.1, 0.9, (12, 2)) * die_px
    sizes = rng.uniform(0.03, 0.15, (12, 2)) * die_px
    rows, cols = off.shape[:2]
    for r in range(rows):
        for c in range(cols):
            top, left = r * pitch[0], c * pitch[1]
            r0, r1 = round(top), min(z.shape[0], round(top + pitch[0]))
            c0, c1 = round(left), min(z.shape[1], round(left + pitch[1]))
            v = np.arange(r0, r1) - top - street_px / 2 - off[r, c, 0]
            u = np.arange(c0, c1) - left - street_px / 2 - off[r, c, 1]
            mesa = _box(v, 0, die_px[0])[:, None] * _box(u, 0, die_px[1])[None, :]
            raised = np.zeros_like(mesa)
            for (bv, bu), (sv, su) in zip(blocks, sizes, strict=True):
                raised = np.maximum(raised, _box(v, bv - sv, bv + sv)[:, None] * _box(u, bu - su, bu + su)[None, :])
            present = (r, c) not in no_die
            z[r0:r1, c0:c1] = present * (5 * mesa + raised)
            grey[r0:r1, c0:c1] = 60 + present * (60 * mesa + 50 * raised)


def _box(at: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """1 between two edges that are soft over about two pixels."""
    return (1 / (1 + np.exp(-(at - low) / 0.5)) * 1 / (1 + np.exp((at - high) / 0.5))).astype(np.float64)
