"""A wafer without end as a formula: dies, trenches, pads, texture, form; its height and grey at any place, exactly.

Textures are cubic B-splines over random numbers, so that a place between two pixels has a true value as well. Vertical
trenches are bright and horizontal ones dark; walls are steep, dark and have no texture.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

import wafer_viewer.numerics.jit  # noqa: F401 - says where compiled kernels are kept

Floats = NDArray[np.float32]
KNOTS = 1024
"""The textures repeat after so many knots: over a millimetre, further than a neighbour is ever looked for."""
DIE_WIDTH_UM, DIE_HEIGHT_UM, TRENCH_UM, WALL_UM, DEPTH_UM = 420.0, 370.0, 40.0, 3.0, 30.0
PADS, PAD_WALL_UM = 6, 1.5
FINE_UM, COARSE_UM, ROUGH_UM, WAVE_UM = 1.2, 7.3, 2.1, 97.0
FINE_GREY, COARSE_GREY, ROUGHNESS_UM, WAVINESS_UM = 6.0, 4.0, 0.15, 0.6
SHIVER_PX = 90.0
DIE_GREY, BRIGHT_GREY, DARK_GREY, WALL_GREY, PAD_GREY = 70.0, 165.0, 28.0, 12.0, 22.0
BLANK_MARGIN_UM = 6.0


@dataclass(frozen=True, slots=True)
class Wafer:
    """What there is to see.

    bow_um: how far the wafer has sunk `bow_radius_um` from its centre; textured_fraction: of the cells of a die;
    blank_um: rectangles (x low, y low, x high, y high) where nothing is to be seen; seed: which wafer.
    """

    textured_fraction: float = 1.0
    bow_um: float = 0.0
    bow_radius_um: float = 5000.0
    seed: int = 1
    blank_um: tuple[tuple[float, float, float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Lattice:
    """Pixels [row, col] at (x, y) = first + col * along + row * down, in um; float64 pairs.

    shiver_um: deviation of a smooth displacement of pixels about these places, another for every `shiver_first`; as an
    all-in-focus picture has it, whose parts come from frames that the stage did not hold quite still for.
    """

    shape: tuple[int, int]
    first_um: tuple[float, float]
    along_um: tuple[float, float]
    down_um: tuple[float, float]
    shiver_um: float = 0.0
    shiver_first: tuple[float, float] = (0.0, 0.0)

    @property
    def last_um(self) -> tuple[float, float]:
        """Where the last pixel lies."""
        rows, cols = self.shape[0] - 1, self.shape[1] - 1
        x, y = (f + cols * a + rows * d for f, a, d in zip(self.first_um, self.along_um, self.down_um, strict=True))
        return x, y


def look(wafer: Wafer, lattice: Lattice) -> tuple[Floats, Floats, Floats]:
    """Height in um, grey in counts, and how sure of its height a microscope is (0 ... 1), of every pixel."""
    layers = tuple(np.empty(lattice.shape, np.float32) for _ in range(3))
    place = np.array([*lattice.first_um, *lattice.along_um, *lattice.down_um, lattice.shiver_um, *lattice.shiver_first])
    form = np.array([wafer.bow_um / wafer.bow_radius_um**2, wafer.textured_fraction])
    _look(place, form, knots(wafer.seed), _blanks_near(wafer, lattice), *layers)
    return layers


@functools.lru_cache(maxsize=4)
def knots(seed: int) -> Floats:
    """The random numbers that the textures go by, float32 [KNOTS, KNOTS]; a spline over them has deviation 1."""
    return (np.random.default_rng(seed).standard_normal((KNOTS, KNOTS), np.float32) / 0.479).astype(np.float32)


def _blanks_near(wafer: Wafer, lattice: Lattice) -> NDArray[np.float64]:
    """The blank rectangles that a lattice may touch, [n, 4]."""
    blanks = np.array(wafer.blank_um, np.float64).reshape(-1, 4)
    (xa, ya), (xb, yb) = lattice.first_um, lattice.last_um
    near_x = (blanks[:, 0] < max(xa, xb) + 50) & (blanks[:, 2] > min(xa, xb) - 50)
    near_y = (blanks[:, 1] < max(ya, yb) + 50) & (blanks[:, 3] > min(ya, yb) - 50)
    return blanks[near_x & near_y]


@numba.njit(cache=True, nogil=True)
def _look(place, form, texture, blanks, z_um, grey, sure):
    for row in range(z_um.shape[0]):
        for col in range(z_um.shape[1]):
            x = place[0] + col * place[2] + row * place[4]
            y = place[1] + col * place[3] + row * place[5]
            if place[6] > 0:
                u, v = place[7] + row / SHIVER_PX, place[8] + col / SHIVER_PX
                x += place[6] * _spline(texture, u, v)
                y += place[6] * _spline(texture, v, u + 500.5)
            z, g, s = _at(x, y, form[1], texture)
            blank = _blank(x, y, blanks)
            z_um[row, col] = z * (1 - blank) - form[0] * (x * x + y * y)
            grey[row, col] = g + (DIE_GREY - g) * blank
            sure[row, col] = s + (0.3 - s) * blank


@numba.njit(cache=True, nogil=True)
def _at(x, y, textured_fraction, texture):
    """Height, grey and sureness of a place, but for the form of the wafer."""
    u, v = (x + TRENCH_UM / 2) % DIE_WIDTH_UM - TRENCH_UM / 2, (y + TRENCH_UM / 2) % DIE_HEIGHT_UM - TRENCH_UM / 2
    across = _inside(u, DIE_WIDTH_UM - TRENCH_UM, WALL_UM)
    along = _inside(v, DIE_HEIGHT_UM - TRENCH_UM, WALL_UM)
    die = across * along
    wall = 4 * die * (1 - die)
    pad, textured = _pad(u, v, textured_fraction)
    coarse = _spline(texture, x / COARSE_UM, y / COARSE_UM)
    fine = _spline(texture, y / FINE_UM + 400.3, x / FINE_UM) * textured
    rough = _spline(texture, x / ROUGH_UM, y / ROUGH_UM + 700.7)
    wave = _spline(texture, x / WAVE_UM + 200.2, y / WAVE_UM)
    ground = BRIGHT_GREY * along + DARK_GREY * (1 - along)
    grey = (DIE_GREY + PAD_GREY * pad) * die + ground * (1 - die)
    grey += (FINE_GREY * fine + COARSE_GREY * coarse * textured) * (0.35 + 0.65 * die)
    z = (1.5 * pad + DEPTH_UM) * die + ROUGHNESS_UM * rough + WAVINESS_UM * wave
    sure = 0.9 * die + (0.65 * along + 0.25 * (1 - along)) * (1 - die)
    sure *= 0.45 + 0.55 * textured
    return z, grey + (WALL_GREY - grey) * 0.8 * wall, sure * (1 - 0.8 * wall)


@numba.njit(cache=True, nogil=True)
def _inside(u, width, soft):
    """1 within 0 ... width, 0 outside, smooth over `soft` at both ends."""
    t = min(1.0, max(0.0, min(u, width - u) / soft + 0.5))
    return t * t * (3 - 2 * t)


@numba.njit(cache=True, nogil=True)
def _pad(u, v, textured_fraction):
    """How much of a pad lies at a place of a die, and whether its cell has texture: the same on every die."""
    width, height = (DIE_WIDTH_UM - TRENCH_UM) / PADS, (DIE_HEIGHT_UM - TRENCH_UM) / PADS
    i, j = int(u / width), int(v / height)
    dice = ((i * 73856093) ^ (j * 19349663)) % 1009 / 1009
    shape = _inside(u - (i + 0.2) * width, 0.6 * width, PAD_WALL_UM)
    shape *= _inside(v - (j + 0.2) * height, 0.6 * height, PAD_WALL_UM)
    textured = 1.0 if (dice * 7.77) % 1.0 < textured_fraction else 0.0
    return (shape * (2 * dice - 0.7) if i < PADS and j < PADS else 0.0), textured


@numba.njit(cache=True, nogil=True)
def _blank(x, y, blanks):
    """How blank a place is, 0 ... 1."""
    most = 0.0
    for n in range(blanks.shape[0]):
        width, height = blanks[n, 2] - blanks[n, 0], blanks[n, 3] - blanks[n, 1]
        across = _inside(x - blanks[n, 0], width, BLANK_MARGIN_UM)
        most = max(most, across * _inside(y - blanks[n, 1], height, BLANK_MARGIN_UM))
    return most


@numba.njit(cache=True, nogil=True)
def _spline(texture, u, v):
    """The cubic B-spline over the knots at (u, v), which repeat."""
    i, j = int(np.floor(u)), int(np.floor(v))
    a0, a1, a2, a3 = _weights(u - i)
    b0, b1, b2, b3 = _weights(v - j)
    total = 0.0
    for n, b in enumerate((b0, b1, b2, b3)):
        line = texture[(j + n) & (KNOTS - 1)]
        total += b * (
            a0 * line[i & (KNOTS - 1)]
            + a1 * line[(i + 1) & (KNOTS - 1)]
            + a2 * line[(i + 2) & (KNOTS - 1)]
            + a3 * line[(i + 3) & (KNOTS - 1)]
        )
    return total


@numba.njit(cache=True, nogil=True)
def _weights(t):
    s = 1 - t
    return s * s * s / 6, (4 - 6 * t * t + 3 * t * t * t) / 6, (4 - 6 * s * s + 3 * s * s * s) / 6, t * t * t / 6


@numba.njit(cache=True, nogil=True)
def stain(texture, shape, grain_px, first, out):
    """Smooth random patches over a frame, deviation 1, grains of `grain_px`: what differs from field to field."""
    for row in range(shape[0]):
        for col in range(shape[1]):
            out[row, col] = _spline(texture, first[0] + col / grain_px, first[1] + row / grain_px)
