"""Patterned surfaces with a lattice of dies that is known: for the tests of what finds dies and defects."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.support.surfaces import height_map
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Origin


@dataclass(frozen=True)
class Wafer:
    """A made-up patterned wafer: rows x cols px of dies in streets, heights in um, grey 0 ... 255."""

    rows: int = 600
    cols: int = 720
    pixel_um: float = 2.0
    pitch_x_um: float = 201.3
    pitch_y_um: float = 147.7
    width_um: float = 173.0
    height_um: float = 121.0
    x0_um: float = 31.7
    y0_um: float = 22.9
    angle_deg: float = 0.0
    die_over_street_um: float = 3.0
    street_grey: float = 180.0
    die_grey: float = 90.0
    noise_um: float = 0.3
    noise_grey: float = 6.0
    bow_um: float = 10.0
    unmeasured_fraction: float = 0.02
    seed: int = 1

    @property
    def grid(self) -> DieGrid:
        return DieGrid(
            pitch_x_um=self.pitch_x_um,
            pitch_y_um=self.pitch_y_um,
            x0_um=self.x0_um,
            y0_um=self.y0_um,
            width_um=self.width_um,
            height_um=self.height_um,
            angle_rad=math.radians(self.angle_deg),
        )


def made(
    wafer: Wafer = Wafer(), gap: Region | None = None, no_die: tuple[tuple[int, int], ...] = (), printed=None
) -> HeightMap:
    """The surface of a made-up wafer; gap: no field was taken there; no_die: (col, row) where the street goes on.

    printed: what is on a die, 0 ... 1, by the share of its width and height; `pattern` by default.
    """
    rng = np.random.default_rng(wafer.seed)
    x_um = np.arange(wafer.cols) * wafer.pixel_um
    y_um = (wafer.rows - 1 - np.arange(wafer.rows)) * wafer.pixel_um
    x, y = np.meshgrid(x_um, y_um)
    die, shape = covered(wafer, x, y, no_die, printed or pattern)
    far = ((x - x.mean()) / np.ptp(x_um)) ** 2 + ((y - y.mean()) / np.ptp(y_um)) ** 2
    z = wafer.bow_um * far + 0.002 * x + wafer.die_over_street_um * (die + 0.3 * shape)
    z += wafer.noise_um * rng.standard_normal(z.shape)
    z[rng.random(z.shape) < wafer.unmeasured_fraction] = np.nan
    grey = wafer.street_grey + die * (wafer.die_grey - wafer.street_grey) + 40 * shape
    grey += wafer.noise_grey * rng.standard_normal(grey.shape)
    origin = np.where(np.isfinite(z), Origin.MEASURED, Origin.NO_TEXTURE).astype(np.uint8)
    if gap is not None:
        missing = gap.contains(x, y)
        origin[missing], z[missing], grey[missing] = Origin.NOT_COVERED, np.nan, 0
    seen = np.clip(grey, 0, 255).astype(np.uint8)
    return height_map(z, wafer.pixel_um, y0_um=float(y_um[0]), grey=seen, origin=origin, simulated=True)


def covered(wafer: Wafer, x, y, no_die, printed):
    """The share of each pixel that is die, and how much is printed on it: means of 3 x 3 places, each by chance.

    Without chance a whole edge would be off by the same part of a pixel.
    """
    rng, parts = np.random.default_rng(wafer.seed), (np.arange(3) - 1) / 3
    total = np.zeros((2, *x.shape))
    for dx in parts:
        for dy in parts:
            at_x, at_y = np.array([dx, dy])[:, None, None] + rng.uniform(-1 / 6, 1 / 6, (2, *x.shape))
            col, row, u, v = wafer.grid.to_die(x + at_x * wafer.pixel_um, y + at_y * wafer.pixel_um)
            die = (u > 0) & (u < wafer.width_um) & (v > 0) & (v < wafer.height_um)
            for at in no_die:
                die &= (col != at[0]) | (row != at[1])
            total += die, die * printed(u / wafer.width_um, v / wafer.height_um)
    return total / 9


def pattern(u, v):
    """What is printed on a die, 0 ... 1, by the share of its width and height."""
    pads = ((u * 8) % 1 < 0.5) & ((v * 6) % 1 < 0.5) & (u > 0.1) & (u < 0.6) & (v > 0.3) & (v < 0.9)
    block = (u > 0.66) & (u < 0.9) & (v > 0.15) & (v < 0.7)
    return pads * 1.0 + block * 0.6
