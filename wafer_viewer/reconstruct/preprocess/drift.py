"""Image motion between frames, and from it lateral drift and a magnification that changes with focus.

A tile is compared with itself in another frame by the correlation of its gradients, (d/dx + i d/dy) of the grey,
clipped to twice the median. Its texture then dominates, rather than the edge of a bright trench, whose light moves with
the focus where a wall hides a part of the aperture. Only frames in which a tile is sharp are compared, because strongly
defocused light has no defined position.

All displacement measurements of all tiles are solved at once by robust least squares (Cauchy weights), so that errors
do not accumulate from frame to frame. Frames without sharp content follow the measured ones, at a constant rate if the
drift is steady. All frames are registered to their mean, as is usual where a lens focuses by moving.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.row_sums import native_copy, slope_energies
from wafer_viewer.numerics.grids.resampling import REACH as TAPS_REACH
from wafer_viewer.numerics.grids.resampling import Taps, resampled
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.frame_blocks import Correction, FramePixels, Window


@dataclass(frozen=True, slots=True)
class DisplacementParameters:
    """Tiles and frames in which displacements are measured, and the limits of a measurement.

    Parameters
    ----------
    tiles : tuple[int, int]
        Largest number of tiles along the rows and along the columns of a field.
    tile_px : tuple[int, int], px
        Limits of the tile size; a tile is a third of the field high and a quarter wide.
    lags : tuple[int, int], frames
        Distances between compared frames: neighbours look most alike, distant pairs accumulate less error.
    least_peak : float
        Minimum correlation peak, in standard deviations of the correlation.
    least_sharpness : float
        Minimum fraction of the sharpness range of a tile.
    frames : tuple[int, int]
        Limits of the number of the sharpest frames of a tile that are used.
    every_row : int, px
        Stride of the rows on which the sharpness of a tile is measured.
    steepest : float
        Gradient above which gradients count by their direction alone, in medians of a frame.
    smooth_px : float, summed pixels
        Half width at 1/e of the Gaussian that smooths the gradients.
    """

    tiles: tuple[int, int] = (3, 4)
    tile_px: tuple[int, int] = (64, 192)
    lags: tuple[int, int] = (1, 4)
    least_peak: float = 9.0
    least_sharpness: float = 0.3
    frames: tuple[int, int] = (12, 36)
    every_row: int = 8
    steepest: float = 2.0
    smooth_px: float = 1.0


DISPLACEMENT = DisplacementParameters()
_BIN = 2
"""Side of the squares of pixels that are summed before tiles are compared, in pixels."""

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


class TileMotions:
    """Sharpness and spectra of tiles and displacements between them, by slots; each is computed once.

    Those of a live field are computed while its frames arrive.
    """

    def __init__(self) -> None:
        self._sharpness: dict[tuple[int, int], float] = {}
        self._spectra: dict[tuple[int, int], Complex] = {}
        self._moved: dict[tuple[int, int, int], tuple[NDArray[np.float64], np.float64]] = {}

    def sharpness(self, tile: int, slots: list[int], images: Image) -> NDArray[np.float64]:
        """Return the sharpness of a tile, [n], in frames in these slots."""
        new = [n for n, slot in enumerate(slots) if (tile, slot) not in self._sharpness]
        if new:
            part = images if len(new) == len(slots) else images[new]
            self._sharpness |= {(tile, slots[n]): one for n, one in zip(new, _sharpness(part).tolist(), strict=True)}
        return np.array([self._sharpness[tile, slot] for slot in slots])

    def spectra(self, tile: int, slots: list[int], images: Image) -> Complex:
        """Return the spectra of a tile, [n, row, col], of frames in these slots."""
        new = [n for n, slot in enumerate(slots) if (tile, slot) not in self._spectra]
        if new:
            self._spectra |= {(tile, slots[n]): one for n, one in zip(new, _spectra(images[new]), strict=True)}
        return np.stack([self._spectra[tile, slot] for slot in slots])

    def moved(
        self, tile: int, pairs: list[tuple[int, int]], first: Complex, second: Complex
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the displacement between the slots of each pair, [n, (rows, cols)], and the height of its peak."""
        new = [n for n, pair in enumerate(pairs) if (tile, *pair) not in self._moved]
        if new:
            found = zip(new, *_moved(first[new], second[new]), strict=True)
            self._moved |= {(tile, *pairs[n]): (moved, height) for n, moved, height in found}
        known = [self._moved[tile, *pair] for pair in pairs]
        return np.array([moved for moved, _ in known]).reshape(-1, 2), np.array([height for _, height in known])


def measure_displacements(
    read: ReadTile, shape: tuple[int, int], slots: NDArray[np.intp], motions: TileMotions | None = None
) -> Sightings:
    """Measure the motion between the frames of a field of `shape` in all tiles.

    slots: of the frames, in the order of z; motions: what is known of them already, and is kept.
    """
    side, motions = _side_px(shape), motions or TileMotions()
    found = [
        _of_tile(n, read(slice(r, r + side), slice(c, c + side)), _middle((r, c), side, shape), slots, motions)
        for n, (r, c) in enumerate(_corners(shape) if len(slots) > 1 else [])
    ]
    return _joined([one for of_tile in found for one in of_tile])


def measure_sharpness(frame: Image, slot: int, motions: TileMotions) -> None:
    """Measure the sharpness of all tiles of one frame, by which those are chosen whose motion is measured."""
    side = _side_px(frame.shape)
    for n, (r, c) in enumerate(_corners(frame.shape)):
        motions.sharpness(n, [slot], frame[None, r : r + side, c : c + side])


def _corners(shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the corners of the tiles, none in a field smaller than a tile."""
    side, (high, wide) = _side_px(shape), DISPLACEMENT.tiles
    if min(shape) < side:
        return []
    return [(r, c) for r in _starts(shape[0], side, high) for c in _starts(shape[1], side, wide)]


def _side_px(shape: tuple[int, ...]) -> int:
    (least, most), (high, wide) = DISPLACEMENT.tile_px, DISPLACEMENT.tiles
    return int(np.clip(min(shape[0] // high, shape[1] // wide), least, most)) // _BIN * _BIN


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


def _of_tile(
    tile: int, images: Image, at_px: NDArray[np.float64], slots: NDArray[np.intp], motions: TileMotions
) -> list[Sightings]:
    frames = _sharp_frames(motions.sharpness(tile, slots.tolist(), images))
    if len(frames) < 2:
        return []
    spectra = motions.spectra(tile, slots[frames].tolist(), images[frames])
    place = np.full(len(images), -1)
    place[frames] = np.arange(len(frames))
    found = list[Sightings]()
    for lag in DISPLACEMENT.lags:
        first = np.flatnonzero((place[:-lag] >= 0) & (place[lag:] >= 0))
        if first.size:
            pairs = list(zip(slots[first].tolist(), slots[first + lag].tolist(), strict=True))
            moved = motions.moved(tile, pairs, spectra[place[first]], spectra[place[first + lag]])
            found.append(_of_pairs(tile, first, first + lag, at_px, *moved))
    return found


def _of_pairs(
    tile: int,
    first: NDArray[np.intp],
    second: NDArray[np.intp],
    at_px: NDArray[np.float64],
    moved: NDArray[np.float64],
    height: NDArray[np.float64],
) -> Sightings:
    """Return the displacements between pairs of frames in which a tile is sharp, where the peak is clear."""
    n = len(first)
    many = Sightings(np.full(n, tile), first, second, np.tile(at_px, (n, 1)), moved, (height / 10) ** 2)
    return many.where(height > DISPLACEMENT.least_peak)


def _sharpness(images: Image) -> NDArray[np.float64]:
    """Return the sharpness of a tile in each frame, by the gradients along some of its rows.

    The sums of squares of integers are exact, so that frames may be measured one by one or together.
    """
    rows = native_copy(images[:, :: DISPLACEMENT.every_row])
    return slope_energies(rows.reshape(-1, rows.shape[2]), 2).reshape(len(rows), -1).sum(axis=1).astype(np.float64)


def _sharp_frames(sharpness: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the frames in which a tile is sharp."""
    if not sharpness.any():
        return np.zeros(0, np.intp)
    low, high = float(sharpness.min()), float(sharpness.max())
    order = np.argsort(-sharpness, kind="stable")
    enough = np.count_nonzero(sharpness >= low + DISPLACEMENT.least_sharpness * (high - low))
    return np.sort(order[: int(np.clip(enough, *DISPLACEMENT.frames))])


def _spectra(images: Image) -> Complex:
    """Return the gradient spectrum of each frame of a tile, at half the resolution."""
    import scipy.fft

    grey = _binned(images)
    side = grey.shape[1]
    slope = np.zeros(grey.shape, np.complex64)
    slope.real[:, :, 1:-1] = grey[:, :, 2:] - grey[:, :, :-2]
    slope.imag[:, 1:-1] = grey[:, 2:] - grey[:, :-2]
    steep = np.abs(slope)
    usual = DISPLACEMENT.steepest * np.median(steep[:, 1::3, 1::3], axis=(1, 2))[:, None, None] + np.float32(1e-6)
    fade = np.hanning(side + 2)[1:-1].astype(np.float32)
    slope *= fade[:, None] * fade / np.maximum(steep, usual)
    frequency = np.fft.fftfreq(side)
    smooth = np.exp(-((np.pi * DISPLACEMENT.smooth_px * frequency) ** 2)).astype(np.float32)
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


@dataclass(frozen=True, slots=True)
class DriftParameters:
    """Limits and weights of the estimate of the drift from displacements.

    Parameters
    ----------
    least_px : float, px
        Smaller drift is not corrected; growth is judged by its rms displacement over the field.
    least_tiles : int
        Fewer tiles cannot distinguish motion from light that bends round an edge.
    steady_share : float
        Minimum fraction of frames that must show the drift rate before it is extrapolated.
    rounds : int
        Number of weighted solutions; the drift rate is estimated in the second half of them.
    scatter_px : float, px
        Smallest residual at which the weight of a measurement has fallen to half.
    shift_tie : float
        Weight of the tie of the shifts of neighbouring frames to the drift rate.
    growth_tie : float
        Weight of the tie of their growth.
    rigid : float
        Weight of the tie of growth that suppresses it.
    sure_errors : float
        Standard errors by which the range of the drift exceeds its lower bound.
    """

    least_px: float = 0.5
    least_tiles: int = 4
    steady_share: float = 0.25
    rounds: int = 8
    scatter_px: float = 0.05
    shift_tie: float = 1e-3
    growth_tie: float = 0.1
    rigid: float = 1e6
    sure_errors: float = 3.0


DRIFT = DriftParameters()
_MEAN_OVER_FIELD = 3**-0.5
"""Ratio of the rms distance from the middle of a rectangle to that of its corner."""

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Drift(Correction):
    """Drift of the frames: a field point p, from the middle, lies at exp(growth[k]) p + shift_px[k] in frame k.

    Coordinates are (rows, cols). shape: (rows, cols) of the field.
    """

    shift_px: Floats
    growth: Floats
    shape: tuple[int, int]

    def places(self, frames: slice, axis: int, points: Ints) -> Floats:
        """Return the positions of some of the field's rows (axis 0) or columns (1) in a range of frames, [n, point]."""
        middle, growth = (self.shape[axis] - 1) / 2, self.growth[frames, None]
        return middle + np.exp(growth) * (points - middle) + self.shift_px[frames, axis, None]

    def covered(self, axis: int) -> slice:
        """Return the range of rows or columns that is covered by every frame."""
        length = self.shape[axis]
        positions = self.places(slice(None), axis, np.arange(length))
        inside = np.flatnonzero(((positions > -0.5) & (positions < length - 0.5)).all(axis=0))
        return slice(int(inside[0]), int(inside[-1]) + 1) if inside.size else slice(0, 0)

    def window(self, frames: slice, wanted: Window) -> Window:
        """Return the pixels within reach of the wanted ones in all of a range of frames, at least the border."""
        rows, cols = (self._reached(frames, axis, part) for axis, part in enumerate(wanted))
        return rows, cols

    def _reached(self, frames: slice, axis: int, part: slice) -> slice:
        places, length = self.places(frames, axis, np.array([part.start, part.stop - 1])), self.shape[axis]
        first, last = math.floor(places.min()) - TAPS_REACH, math.floor(places.max()) + TAPS_REACH
        return slice(min(max(0, first), length - 1), max(1, min(last + 1, length)))

    def applied(self, pixels: FramePixels) -> FramePixels:
        """Resample each frame at the positions of the wanted pixels."""
        (images,), (rows, cols), (down, across) = pixels.layers, pixels.window, pixels.wanted
        down_px = self.places(pixels.frames, 0, np.arange(down.start, down.stop)) - rows.start
        across_px = self.places(pixels.frames, 1, np.arange(across.start, across.stop)) - cols.start
        places = zip(images, down_px, across_px, strict=True)
        resampled_images = np.stack([resampled(image, Taps.at(y), Taps.at(x)) for image, y, x in places])
        return pixels._replace(layers=(resampled_images,))


def drift_of(sightings: Sightings, n_frames: int, shape: tuple[int, int]) -> Drift | None:
    """Estimate the drift from tile displacements; None if it is below half a pixel or undetermined.

    Shift and growth are judged separately, each over runs of frames that are connected by sharp tiles.
    """
    sightings = _agreed(sightings, n_frames)
    radius_px = float(np.hypot(*shape)) / 2
    free = _solve(sightings, n_frames, radius_px, DRIFT.growth_tie)
    grows = _extends(free, sightings, [2], DRIFT.least_px / _MEAN_OVER_FIELD)
    rigid = free if grows else _solve(sightings, n_frames, radius_px, DRIFT.rigid)
    shifts = _extends(rigid, sightings, [0, 1], DRIFT.least_px)
    if not grows and not shifts:
        return None
    return Drift(rigid.moves[:, :2] * shifts, rigid.moves[:, 2] / radius_px * grows, shape)


def drift_note(drift: Drift, pixel_um: float) -> str:
    """Return a one-sentence note on the drift."""
    shift = float(np.hypot(*np.ptp(drift.shift_px, axis=0)))
    growth = float(np.ptp(drift.growth))
    shifts = f"the picture shifts by {shift:.1f} px ({shift * pixel_um:.2f} um)" if shift > 0 else ""
    grows = f"its magnification changes by {growth:.2%}" if growth > 0 else ""
    both = " and ".join(part for part in (shifts, grows) if part)
    return f"{both[0].upper()}{both[1:]} through the stack: its frames were put right."


def _agreed(sightings: Sightings, n_frames: int) -> Sightings:
    """Return the measurements of frame pairs with enough tiles."""
    _, of_pair, count = np.unique(
        sightings.first * n_frames + sightings.second, return_inverse=True, return_counts=True
    )
    return sightings.where(count[of_pair] >= DRIFT.least_tiles) if len(sightings) else sightings


def _runs(sightings: Sightings, n_frames: int) -> list[Ints]:
    """Return the sets of frames connected by measurements, directly or through others."""
    label = np.arange(n_frames)
    for a, b in np.unique(np.stack([sightings.first, sightings.second], axis=1), axis=0):
        label[label == label[b]] = label[a]
    runs = [np.flatnonzero(label == one) for one in np.unique(label)]
    return [run for run in runs if len(run) > 1]


def _extends(solved: _Solved, sightings: Sightings, axes: list[int], least_px: float) -> bool:
    """Return whether a lower bound of the drift range, three jackknife standard errors below it, exceeds `least_px`.

    The jackknife leaves out one tile at a time. Tiles on the two sides of a trench, whose light moves to the two sides
    with defocus, disagree. A steady field, whose range is no larger, needs none.
    """
    for run in _runs(sightings, len(solved.moves)):
        path = solved.moves[run][:, axes]
        extent = float(np.hypot.reduce(np.ptp(path, axis=0)))
        if extent <= least_px:
            continue
        ends = run[[path.sum(axis=1).argmin(), path.sum(axis=1).argmax()]]
        without = np.array([one[ends[1]] - one[ends[0]] for one in solved.without])[:, axes]
        spread = without - without.mean(axis=0)
        error = np.sqrt((len(without) - 1) / len(without) * (spread**2).sum())
        if extent - DRIFT.sure_errors * error > least_px:
            return True
    return False


def _solve(sightings: Sightings, n_frames: int, radius_px: float, growth_tie: float) -> _Solved:
    """Estimate the moves of the frames.

    Each measurement states moves[second] - moves[first] = moved - growth x place. Its place is taken halfway between
    the two frames and relative to the moved middle of the field, so that growth adds up as a logarithm.
    """
    moves = np.zeros((n_frames, 3))
    if not len(sightings):
        return _Solved(moves, lambda trust: moves, sightings)
    problem = _Problem.of(sightings, n_frames, np.array([DRIFT.shift_tie, DRIFT.shift_tie, growth_tie]))
    pace, trust, rows = np.zeros(3), sightings.weight, _rows(sightings, moves, radius_px)
    for n in range(DRIFT.rounds):
        moves = problem.moves(rows, trust, pace)
        rows = _rows(sightings, moves, radius_px)
        off = sightings.moved_px - np.einsum("nab,nb->na", rows, moves[sightings.second] - moves[sightings.first])
        far = np.hypot(off[:, 0], off[:, 1])
        trust = sightings.weight / (1 + (far / max(DRIFT.scatter_px, MAD_TO_SIGMA * float(np.median(far)))) ** 2)
        if n >= DRIFT.rounds // 2:
            pace = problem.pace(moves)
    return _Solved(moves, lambda kept: problem.moves(rows, trust * kept, pace), sightings)


def _rows(sightings: Sightings, moves: Floats, radius_px: float) -> Floats:
    """Return the two equations of each measurement: [n, (rows, cols), (rows, cols, growth)]."""
    carried = (moves[sightings.first, :2] + moves[sightings.second, :2]) / 2
    rows = np.zeros((len(sightings), 2, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = 1
    rows[:, :, 2] = (sightings.at_px + sightings.moved_px / 2 - carried) / radius_px
    return rows


@dataclass(frozen=True, eq=False)
class _Solved:
    """Moves [k, (rows, cols, growth)] in px, growth at the corner; the mean over measured frames is 0.

    of_measurements: returns the moves by some of the measurements, bool [n].
    """

    moves: Floats
    of_measurements: Callable[[NDArray[np.bool_]], Floats]
    sightings: Sightings

    @functools.cached_property
    def without(self) -> list[Floats]:
        """Moves without each of the tiles."""
        tile = self.sightings.tile
        return [self.of_measurements(tile != one) for one in np.unique(tile)]


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Least squares over the measured frames, `tied`; others are interpolated or follow the common rate."""

    sightings: Sightings
    n_frames: int
    tied: Ints
    first: Ints
    second: Ints
    tie: Floats

    @classmethod
    def of(cls, sightings: Sightings, n_frames: int, tie: Floats) -> _Problem:
        tied, places = np.unique(np.concatenate([sightings.first, sightings.second]), return_inverse=True)
        first, second = np.split(places, 2)
        return cls(sightings, n_frames, tied, first, second, tie)

    def moves(self, rows: Floats, trust: Floats, pace: Floats) -> Floats:
        """Return the moves of all frames; neighbours are weakly tied to the common rate."""
        n, gaps = len(self.tied), np.diff(self.tied)
        normal, right = np.zeros((n, n, 3, 3)), np.zeros((n, 3))
        one = np.einsum("n,nab,nac->nbc", trust, rows, rows)
        moved = np.einsum("n,nab,na->nb", trust, rows, self.sightings.moved_px)
        k, loose = np.arange(n - 1), self.tie / gaps[:, None]
        between = loose[:, :, None] * np.eye(3), self.tie * np.tile(pace, (n - 1, 1))
        for first, second, matrix, side in ((self.first, self.second, one, moved), (k, k + 1, *between)):
            for a, b, sign in ((first, first, 1), (second, second, 1), (first, second, -1), (second, first, -1)):
                np.add.at(normal, (a, b), sign * matrix)
            np.add.at(right, second, side)
            np.add.at(right, first, -side)
        normal[0, 0] += np.eye(3)
        tied = np.linalg.solve(normal.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n), right.ravel()).reshape(n, 3)
        return self._all(tied - tied.mean(axis=0), pace)

    def pace(self, moves: Floats) -> Floats:
        """Return the median motion between consecutive measured frames, 0 if too few are measured."""
        near = self.tied[:-1][np.diff(self.tied) == 1]
        if len(near) < DRIFT.steady_share * self.n_frames:
            return np.zeros(3)
        return np.median(moves[near + 1] - moves[near], axis=0)

    def _all(self, tied: Floats, pace: Floats) -> Floats:
        k = np.arange(self.n_frames)
        between = np.stack([np.interp(k, self.tied, tied[:, i]) for i in range(3)], axis=1)
        beyond = k - k.clip(self.tied[0], self.tied[-1])
        return between + beyond[:, None] * pace
