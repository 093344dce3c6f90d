"""Measurement of image motion between frames, in a few tiles of the field.

A tile is compared with itself in another frame by the correlation of its gradients, (d/dx + i d/dy) of the grey,
clipped to twice the median. Its texture then dominates, rather than the edge of a bright trench, whose light moves with
the focus where a wall hides a part of the aperture. Only frames in which a tile is sharp are compared, because strongly
defocused light has no defined position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image

TILES = (3, 4)
TILE_PX = (64, 192)
"""Limits of the tile size; a tile is a third of the field high and a quarter wide."""
LAGS = (1, 4)
"""Distances between compared frames: neighbours look most alike, distant pairs accumulate less error."""
LEAST_PEAK = 9.0
"""Minimum correlation peak, in standard deviations of the correlation."""
LEAST_SHARPNESS = 0.3
"""Minimum fraction of the sharpness range of a tile; 12 to 36 of its sharpest frames are used."""
FRAMES = (12, 36)

_BIN = 2
_STEEPEST = 2.0
_SMOOTH_PX = 1.0
_EVERY_ROW = 8

ReadTile = Callable[[slice, slice], Image]
"""Function that reads the pixels [k, row, col] of a rectangle of all frames."""
Complex = NDArray[np.complex64]


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Displacements of tiles between two frames, one entry each.

    first[n] and second[n] are the frames, at_px[n] the position of the tile's middle from that of the field,
    moved_px[n] the displacement of its content from the first to the second, (rows, cols); weight[n].
    """

    tile: NDArray[np.intp]
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    at_px: NDArray[np.float64]
    moved_px: NDArray[np.float64]
    weight: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.first)

    def where(self, keep: NDArray[np.bool_]) -> Sightings:
        """Return the selected entries."""
        return Sightings(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


def measure_displacements(read: ReadTile, shape: tuple[int, int], n_frames: int) -> Sightings:
    """Measure the motion between the frames of a field of `shape` in all tiles."""
    side = _side_px(shape)
    corners = [(r, c) for r in _starts(shape[0], side, TILES[0]) for c in _starts(shape[1], side, TILES[1])]
    found = [
        _of_tile(n, read(slice(r, r + side), slice(c, c + side)), _middle((r, c), side, shape))
        for n, (r, c) in enumerate(corners if min(shape) >= side and n_frames > 1 else [])
    ]
    return _joined([one for of_tile in found for one in of_tile])


def _side_px(shape: tuple[int, int]) -> int:
    least, most = TILE_PX
    return int(np.clip(min(shape[0] // TILES[0], shape[1] // TILES[1]), least, most)) // _BIN * _BIN


def _starts(length: int, side: int, most: int) -> list[int]:
    """Return evenly spaced tile starts; fewer tiles where they would overlap."""
    count = min(most, max(1, length // side))
    return [round((i + 0.5) * length / count - side / 2) for i in range(count)]


def _middle(corner: tuple[int, int], side: int, shape: tuple[int, int]) -> NDArray[np.float64]:
    return np.array([corner[i] + (side - 1) / 2 - (shape[i] - 1) / 2 for i in (0, 1)])


def _joined(parts: list[Sightings]) -> Sightings:
    none = np.zeros(0, np.intp)
    empty = Sightings(none, none, none, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    names = Sightings.__dataclass_fields__
    return Sightings(*(np.concatenate([getattr(part, name) for part in [empty, *parts]]) for name in names))


def _of_tile(tile: int, images: Image, at_px: NDArray[np.float64]) -> list[Sightings]:
    frames = _sharp_frames(images)
    if len(frames) < 2:
        return []
    spectra = _spectra(images[frames])
    place = np.full(len(images), -1)
    place[frames] = np.arange(len(frames))
    return [_of_pairs(tile, spectra, place, lag, at_px) for lag in LAGS if lag < len(images)]


def _of_pairs(tile: int, spectra: Complex, place: NDArray[np.intp], lag: int, at_px: NDArray[np.float64]) -> Sightings:
    """Measure the displacements between frames `lag` apart in which a tile is sharp."""
    first = np.flatnonzero((place[:-lag] >= 0) & (place[lag:] >= 0))
    moved, height = _moved(spectra[place[first]], spectra[place[first + lag]])
    many = Sightings(
        np.full(len(first), tile), first, first + lag, np.tile(at_px, (len(first), 1)), moved, (height / 10) ** 2
    )
    return many.where(height > LEAST_PEAK)


def _sharp_frames(images: Image) -> NDArray[np.intp]:
    """Return the frames in which a tile is sharp, by the gradients along some of its rows."""
    rows = images[:, ::_EVERY_ROW].astype(np.float32)
    slopes = rows[:, :, 2:] - rows[:, :, :-2]
    sharpness = np.einsum("kyx,kyx->k", slopes, slopes)
    if not sharpness.any():
        return np.zeros(0, np.intp)
    low, high = float(sharpness.min()), float(sharpness.max())
    order = np.argsort(-sharpness, kind="stable")
    enough = np.count_nonzero(sharpness >= low + LEAST_SHARPNESS * (high - low))
    return np.sort(order[: int(np.clip(enough, *FRAMES))])


def _spectra(images: Image) -> Complex:
    """Return the gradient spectrum of each frame of a tile, at half the resolution."""
    import scipy.fft

    grey = _binned(images)
    side = grey.shape[1]
    slope = np.zeros(grey.shape, np.complex64)
    slope.real[:, :, 1:-1] = grey[:, :, 2:] - grey[:, :, :-2]
    slope.imag[:, 1:-1] = grey[:, 2:] - grey[:, :-2]
    steep = np.abs(slope)
    usual = _STEEPEST * np.median(steep[:, 1::3, 1::3], axis=(1, 2))[:, None, None] + np.float32(1e-6)
    fade = np.hanning(side + 2)[1:-1].astype(np.float32)
    slope *= fade[:, None] * fade / np.maximum(steep, usual)
    frequency = np.fft.fftfreq(side)
    smooth = np.exp(-((np.pi * _SMOOTH_PX * frequency) ** 2)).astype(np.float32)
    spectra: Any = scipy.fft.fft2(slope, axes=(1, 2))
    return spectra * (smooth[:, None] * smooth)


def _binned(images: Image) -> NDArray[np.float32]:
    """Return sums of 2 x 2 pixels."""
    two = images[:, ::2].astype(np.uint32) + images[:, 1::2]
    return (two[:, :, ::2] + two[:, :, 1::2]).astype(np.float32)


def _moved(first: Complex, second: Complex) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the displacement in pixels, [n, (rows, cols)], and the height of the correlation peak."""
    import scipy.fft

    products: Any = scipy.fft.ifft2(np.conj(first) * second, axes=(1, 2))
    correlation = products.real
    n, side = np.arange(len(correlation)), correlation.shape[1]
    flat = np.ascontiguousarray(correlation).reshape(len(n), side * side)
    row, col = np.divmod(flat.argmax(axis=1), side)
    top = correlation[n, row, col]
    part_row = _vertex(correlation[n, row - 1, col], top, correlation[n, (row + 1) % side, col])
    part_col = _vertex(correlation[n, row, col - 1], top, correlation[n, row, (col + 1) % side])
    half = side // 2
    moved = np.stack([(row + half) % side - half + part_row, (col + half) % side - half + part_col], axis=1)
    return _BIN * moved.astype(np.float64), top / np.maximum(flat.std(axis=1), 1e-9).astype(np.float64)


def _vertex(before: NDArray[np.float32], top: NDArray[np.float32], after: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the offset of the maximum of a Gaussian through three points, from the middle one."""
    low, high, right = (np.log(np.maximum(v, 1e-3 * top + 1e-30)) for v in (before, top, after))
    bend = low - 2 * high + right
    return np.where(bend < 0, 0.5 * (low - right) / np.minimum(bend, -1e-12), 0)
