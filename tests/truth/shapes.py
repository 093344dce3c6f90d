"""What scenes are drawn with: textures, and outlines as the distance from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2

Array = NDArray[np.float64]


def blobs(shape: tuple[int, int], sigma_px: float, rng: np.random.Generator) -> Array:
    """Smooth noise of mean 0 and deviation 1."""
    field = _periodic_blur(rng.standard_normal(shape, np.float32), sigma_px)
    return (field - field.mean()) / field.std()


def _periodic_blur(noise: Array, sigma_px: float) -> Array:
    """A Gaussian blur whose cost does not grow with its width."""
    by_row, by_col = np.fft.fftfreq(noise.shape[0])[:, None], np.fft.rfftfreq(noise.shape[1])[None, :]
    passes = np.exp(-2 * (np.pi * sigma_px) ** 2 * (by_row**2 + by_col**2)).astype(np.float32)
    return irfft2(rfft2(noise) * passes, s=noise.shape)


def texture(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Grain of several sizes, mean 0 and deviation 1: fine enough to be seen sharp, coarse enough to survive a blur."""
    grain = 0.8 * blobs(shape, 0.8, rng) + 0.5 * blobs(shape, 1.8, rng) + 0.3 * blobs(shape, 4.0, rng)
    return grain / grain.std()


def patches(shape: tuple[int, int], share: float, size_px: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Irregular patches that cover a share of the lattice."""
    field = blobs(shape, size_px, rng)
    return field > np.quantile(field, 1 - share)


def lattice_um(shape: tuple[int, int], margin_px: int, pixel_um: float) -> tuple[Array, Array]:
    """(down, right): where each point of a lattice with a margin is, from the middle of the frame."""
    rows, cols = (pixel_um * (np.arange(n + 2 * margin_px) - margin_px - (n - 1) / 2) for n in shape)
    down, right = np.meshgrid(rows, cols, indexing="ij")
    return down, right


def turned(down: Array, right: Array, angle_deg: float) -> tuple[Array, Array]:
    """The same points in axes that are turned."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return c * down + s * right, c * right - s * down


def rounded_square(down: Array, right: Array, half_um: float, radius_um: float) -> Array:
    """Signed distance from the outline of a square with rounded corners (at most a disc), negative inside."""
    y, x = np.abs(down) - (half_um - radius_um), np.abs(right) - (half_um - radius_um)
    return np.hypot(np.maximum(y, 0), np.maximum(x, 0)) + np.minimum(np.maximum(y, x), 0) - radius_um


def grid_cells(down: Array, right: Array, pitch_um: float) -> tuple[Array, Array, NDArray[np.intp]]:
    """Points in cells of a square grid: (down, right) from the middle of the cell, and a number for each cell."""
    i, j = np.floor(down / pitch_um).astype(int), np.floor(right / pitch_um).astype(int)
    number = (i - i.min()) * (j.max() - j.min() + 1) + j - j.min()
    return down - (i + 0.5) * pitch_um, right - (j + 0.5) * pitch_um, number
