"""A flat sample without end for calibrations: a sum of waves, rendered in milliseconds at any position and focus."""

from __future__ import annotations

import numpy as np

ROWS, COLS = 60, 80
PIXEL_UM = 0.46729
NA, SHARPEST_UM = 0.28, 0.41


class WaveRenderer:
    """Fulfils Renderer with its own true pixel size and rotation of the camera.

    distortion: a pixel at the distance r shows what lies at r (1 - distortion (r / corner)^2).
    """

    def __init__(
        self,
        pixel_um=PIXEL_UM,
        rotation_rad=0.0,
        height_um=0.0,
        n_waves=20,
        shape=(ROWS, COLS),
        distortion=0.0,
    ):
        rng = np.random.default_rng(3)
        turn = rng.uniform(0, 2 * np.pi, n_waves)
        wave = np.exp(1j * turn) * 2 * np.pi / np.geomspace(3.0, 40.0, n_waves)
        self._wave, self._phase = wave, rng.uniform(0, 2 * np.pi, n_waves)
        on_camera = wave * np.exp(-1j * rotation_rad)
        rows, cols = ((np.arange(n) - (n - 1) / 2) * pixel_um for n in shape)
        self._down = np.exp(-1j * rows[:, None] * on_camera.imag)
        self._right = np.exp(1j * on_camera.real[:, None] * cols)
        self._height_um = height_um
        self._grid, self._on_camera = None, on_camera
        if distortion:
            grid = cols[None, :] - 1j * rows[:, None]
            self._grid = grid * (1 - distortion * np.abs(grid / np.abs(grid).max()) ** 2)

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        blur_um2 = SHARPEST_UM**2 + (NA * (z_um - self._height_um) / 2) ** 2
        strength = 0.08 * np.exp(-(np.abs(self._wave) ** 2) * blur_um2 / 2)
        at = strength * np.exp(1j * (self._wave.real * x_um + self._wave.imag * y_um + self._phase))
        if self._grid is None:
            grey = 0.45 + np.einsum("rn,nc->rc", self._down * at, self._right).real  # small: no threads of a BLAS
        else:
            grey = np.full(self._grid.shape, 0.45)
            for one, wave in zip(at, self._on_camera, strict=True):
                grey += (one * np.exp(1j * (wave.real * self._grid.real + wave.imag * self._grid.imag))).real
        noise = np.random.default_rng(seed).normal(0, 1.5, grey.shape)
        return np.clip(255 * grey * exposure_us / 125.0 + noise + 0.5, 0, 255).astype(np.uint8)


class ShadedRenderer:
    """Fulfils Renderer as another one through a camera with a sensitivity [row, col] and a dark level."""

    def __init__(self, renderer, sensitivity, black_counts):
        self._renderer, self._sensitivity, self._black_counts = renderer, sensitivity, black_counts

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        light = self._renderer.frame(x_um, y_um, z_um, exposure_us, seed) * self._sensitivity
        dither = np.random.default_rng(seed + 1).uniform(0, 1, light.shape)
        return np.clip(np.floor(light + self._black_counts + dither), 0, 255).astype(np.uint8)


class SteppedRenderer:
    """Fulfils Renderer over a sample that is higher for x < 0, with an upright wall in sharp focus at both heights."""

    def __init__(self, step_um, shape=(ROWS, COLS)):
        self._levels = [WaveRenderer(height_um=height_um, shape=shape) for height_um in (step_um / 2, -step_um / 2)]
        self._x_um = (np.arange(shape[1]) - (shape[1] - 1) / 2) * PIXEL_UM

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        upper, lower = (level.frame(x_um, y_um, z_um, exposure_us, seed) for level in self._levels)
        return np.where(x_um + self._x_um < 0, upper, lower)
