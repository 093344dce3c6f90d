"""Bumps on a tilted die whose tops and heights are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.support.surfaces import PIXEL_UM, calibration, coordinates, noise_of, surface_of
from wafer_viewer.model.surface.height_map import HeightMap

PITCH_UM, FOOT_UM, HEIGHT_UM, SPREAD_UM = 40.0, 12.0, 15.0, 0.2


@dataclass(frozen=True)
class Bumped:
    """A surface with bumps; tops: x, y, z of each, [n, 3], the tilt of the die in z; tilt: along x."""

    surface: HeightMap
    tops: np.ndarray
    tilt: float = 0.0

    @property
    def range_um(self) -> float:
        """From the lowest to the highest top over the plane of least squares."""
        design = np.column_stack([self.tops[:, :2], np.ones(len(self.tops))])
        left = self.tops[:, 2] - design @ np.linalg.lstsq(design, self.tops[:, 2], rcond=None)[0]
        return float(np.ptp(left))

    def nearest(self, places_um: Sequence[tuple[float, float]]) -> Bumped:
        """Only the bumps that are nearest to places x, y."""
        away = np.linalg.norm(self.tops[None, :, :2] - np.asarray(places_um)[:, None], axis=2)
        return replace(self, tops=self.tops[away.argmin(axis=1)])


def bumped(
    side=10,
    tall_um=3.0,
    seed=0,
    noise_um=0.1,
    correlation_px=3.0,
    tilt=2e-3,
    pitch_um=PITCH_UM,
    holes=False,
    high_um=HEIGHT_UM,
) -> Bumped:
    """side x side bumps, one of them tall, on a die tilted by 2 mrad; holes: tops of some are not measured."""
    rng = np.random.default_rng(seed)
    cells = round((side + 1) * pitch_um / PIXEL_UM)
    x_um, y_um = np.meshgrid(*coordinates(cells, cells))
    heights = high_um + rng.normal(0, SPREAD_UM, (side, side))
    heights[side // 3, side // 2] += tall_um
    radius_um = (FOOT_UM**2 + high_um**2) / (2 * high_um)
    z, tops = np.zeros(x_um.shape), []
    for (row, col), height in np.ndenumerate(heights):
        at = (col - (side - 1) / 2) * pitch_um, ((side - 1) / 2 - row) * pitch_um
        rows, cols = (np.flatnonzero(np.abs(um) < FOOT_UM) for um in (y_um[:, 0] - at[1], x_um[0] - at[0]))
        near = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        away2 = (x_um[near] - at[0]) ** 2 + (y_um[near] - at[1]) ** 2
        cap = np.sqrt(np.maximum(radius_um**2 - away2, 0)) - radius_um + height
        z[near] = np.where(away2 < FOOT_UM**2, np.maximum(cap, 0), z[near])
        tops.append((*at, height + tilt * at[0]))
    z = z + tilt * x_um + noise_of(seed, z.shape, noise_um, correlation_px)
    if holes:
        z[(x_um < -pitch_um / 2) & (z > 10)] = np.nan
    held = calibration(u_z_scale=1e-6)
    return Bumped(surface_of(z, calibration=held, z_step_um=0.0), np.array(tops), tilt)
