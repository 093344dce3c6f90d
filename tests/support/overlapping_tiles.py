"""Fields cut out of one large random texture at known places, seen by a camera with noise and a stage that errs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.support.surfaces import height_map
from wafer_viewer.model.surface.height_map import HeightMap

PIXEL_UM = 0.5


@dataclass(frozen=True)
class Sample:
    """A picture and its heights, [row, col] on whole pixels; read between them through its spectrum."""

    grey: NDArray
    z_um: NDArray


def a_sample(shape: tuple[int, int] = (400, 420), blur_px: float = 1.3, seed: int = 0) -> Sample:
    rng = np.random.default_rng(seed)
    grey, z = (gaussian_filter(rng.normal(size=shape), blur, mode="wrap") for blur in (blur_px, 3.0))
    return Sample(110 + 18 * grey / grey.std(), 0.8 * z / z.std())


def a_field(
    sample: Sample,
    row: float,
    col: float,
    shape: tuple[int, int],
    *,
    off_px: tuple[float, float] = (0.0, 0.0),
    noise_counts: float = 2.0,
    noise_um: float = 0.05,
    seed: int = 1,
) -> HeightMap:
    """The field whose pixel (0, 0) the stage puts at (row, col) of the sample, and that lies `off_px` further on."""
    rng = np.random.default_rng(seed)
    grey, z = (_read(layer, row + off_px[0], col + off_px[1], shape) for layer in (sample.grey, sample.z_um))
    seen = np.clip(np.rint(grey + rng.normal(0, noise_counts, shape)), 0, 255).astype(np.uint8)
    heights = (z + rng.normal(0, noise_um, shape)).astype(np.float32)
    return height_map(heights, PIXEL_UM, col * PIXEL_UM, -row * PIXEL_UM, grey=seen, z_step_um=2.0)


def _read(layer: NDArray, row: float, col: float, shape: tuple[int, int]) -> NDArray:
    """Read at broken pixels without smoothing anything: a shift of its phases."""
    whole_row, whole_col = int(np.floor(row)), int(np.floor(col))
    down, right = (np.fft.fftfreq(n) for n in layer.shape)
    turn = np.exp(2j * np.pi * (down[:, None] * (row - whole_row) + right * (col - whole_col)))
    moved = np.fft.ifft2(np.fft.fft2(layer) * turn).real
    return moved[whole_row : whole_row + shape[0], whole_col : whole_col + shape[1]]


def with_picture(height: HeightMap, grey: NDArray) -> HeightMap:
    return replace(height, all_in_focus=np.clip(np.rint(grey), 0, 255).astype(np.uint8))


def with_heights(height: HeightMap, z_um: NDArray) -> HeightMap:
    z = z_um.astype(np.float32)
    return replace(height, z_um=z, z_raw_um=z)
