"""A session that measures shapes: dies with bumps between bright streets, seen on the picture and in the heights."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.special import ndtr

from tests.browser.sessions.measuring_session import CALIBRATION, MeasuringSession
from tests.support.page_stand_in import COLS, PIXEL_UM, ROWS, height_map
from wafer_viewer.model.surface.height_map import HeightMap, Provenance

PITCH_X_UM, PITCH_Y_UM = 150.0, 120.0
DIE_X_UM, DIE_Y_UM, DIE_UM = 112.0, 88.0, 20.0
BUMP_PITCH_UM, BUMP_UM, BUMP_RADIUS_UM, TALL_UM = 22.0, 8.0, 7.0, 1.5
CHIP_AT, CHIP_UM = (12.0, -DIE_Y_UM / 2), 5.0


class ShapedSession(MeasuringSession):
    """Kerf, die, circle, chipping and coplanarity all have an answer on its surface."""

    def __init__(self) -> None:
        super().__init__(bumped_dies)


def bumped_dies() -> HeightMap:
    """x and y from the middle of the field, where a die is; it lacks a half disc at its lower edge."""
    rng = np.random.default_rng(1)
    x = (np.arange(COLS) - (COLS - 1) / 2)[None, :] * PIXEL_UM
    y = ((ROWS - 1) / 2 - np.arange(ROWS))[:, None] * PIXEL_UM
    u, v = _about(x, PITCH_X_UM), _about(y, PITCH_Y_UM)
    inside = np.minimum(DIE_X_UM / 2 - np.abs(u), DIE_Y_UM / 2 - np.abs(v))
    inside = np.minimum(inside, np.hypot(x - CHIP_AT[0], y - CHIP_AT[1]) - CHIP_UM)
    away = np.hypot(_about(u, BUMP_PITCH_UM), _about(v, BUMP_PITCH_UM))
    bumped = (away < BUMP_RADIUS_UM) & (np.abs(u) < 45) & (np.abs(v) < 34)
    tall = TALL_UM * ((np.abs(x - BUMP_PITCH_UM) < 10) & (np.abs(y) < 10))
    z = np.where(inside > 0, DIE_UM, 0.0) + np.where(bumped, (BUMP_UM + tall) * (1 - (away / BUMP_RADIUS_UM) ** 2), 0.0)
    z = z + 0.004 * x + rng.normal(0, 0.05, z.shape)
    grey = 190 - 130 * ndtr(inside / 0.6) + 110 * bumped * ndtr((BUMP_RADIUS_UM - away) / 0.6)
    grey = np.clip(grey + rng.normal(0, 3, z.shape), 0, 255).astype(np.uint8)
    made = height_map(z, PIXEL_UM, float(x[0, 0]), float(y[0, 0]), grey)
    return dataclasses.replace(made, provenance=Provenance(calibration=CALIBRATION, simulated=True))


def _about(um: np.ndarray, pitch_um: float) -> np.ndarray:
    """From the nearest multiple of a pitch."""
    return (um + pitch_um / 2) % pitch_um - pitch_um / 2
