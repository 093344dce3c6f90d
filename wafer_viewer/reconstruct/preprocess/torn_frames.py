"""Torn frames: a part of the image belongs to another frame, or is displaced.

Cameras and drivers that lose packets or overwrite a buffer while it is read deliver frames of which a band of rows is
stale, early or shifted. Between neighbouring frames a sound image changes less than between the two frames beside it,
unless it is sharper than both, at its focus. A band that differs far more, while the other bands of the frame do not,
is torn when it is no sharper than the same rows beside it, or when it looks like another frame. Rows that equal those
of another frame to the last count are stale, because no two frames have the same noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.row_sums import cell_sums, native_copy, slope_energies
from wafer_viewer.numerics.jit import Float32s, Greys, bare_kernel

Floats = NDArray[np.float32]
LEAST_FRAMES = 6
"""In fewer frames a sharp detail of the sample may look torn."""


@dataclass(frozen=True, slots=True)
class TearParameters:
    """Sample of a stack and limits of a torn band.

    Parameters
    ----------
    bands : int
        Bands of rows of a frame.
    sampled : tuple[int, int]
        Largest number of sampled rows of a band, and of sampled columns.
    least_ratio : float
        Smallest mean square difference from both neighbours, relative to that between the neighbours.
    clear_ratio : float
        Such a ratio of a single band makes a frame torn; trembling by a pixel stays below.
    whole_ratio : float
        Largest such ratio of the other bands of a torn frame, as a median; a displaced frame exceeds it everywhere.
    enough_bands : int
        Smallest number of torn bands of a frame without such a band.
    sharper : float
        Largest focus energy of a displaced band relative to the same rows beside it.
    alike : float
        Largest mean square difference from another frame, relative to that from the neighbours.
    least_share_of_white : float
        Smallest root mean square difference, as a fraction of white.
    most_stale : int
        Largest number of pairs of frames that share bands; more are a stack without noise.
    most_torn : float
        Largest fraction of torn frames; with more, the differences are the sample's.
    dark : float
        Smallest mean grey of a frame relative to the stack: a darker one is dead, not torn.
    """

    bands: int = 16
    sampled: tuple[int, int] = (8, 512)
    least_ratio: float = 3.0
    clear_ratio: float = 6.0
    whole_ratio: float = 1.5
    enough_bands: int = 3
    sharper: float = 1.1
    alike: float = 0.3
    least_share_of_white: float = 0.004
    most_stale: int = 2
    most_torn: float = 0.2
    dark: float = 0.25


TEAR = TearParameters()


class SampledBands(NamedTuple):
    """Sample of each band of rows of a frame, [band, row, col], with its mean, [band, 1, 1], and a print of its pixels.

    Empty where the frame is smaller than the bands.
    """

    grey: Greys
    level: Floats
    prints: tuple[tuple[int, int], ...]


Change = Callable[[int, int], Floats]
"""Function that returns the `relative_change` between the frames in two slots."""


def torn_frames(
    bands: Sequence[SampledBands], slots: NDArray[np.intp], white_counts: int, change: Change
) -> dict[int, str]:
    """Return what is wrong with each torn frame among `slots`, in the order of z; none where there are many.

    bands: from `sampled_bands` of these frames.
    """
    if len(slots) < LEAST_FRAMES or not bands[0].grey.size:
        return {}
    torn = _torn(bands, slots, white_counts, change)
    if len(torn) > TEAR.most_torn * len(slots):
        return {}
    return {
        int(slots[k]): f"is torn, about {share:.0%} of its rows do not belong to the frames beside it"
        for k, share in torn
    }


def _torn(
    sampled: Sequence[SampledBands], slots: NDArray[np.intp], white_counts: int, change: Change
) -> list[tuple[int, float]]:
    """Return the index along z and the torn fraction of each torn frame."""
    level = np.stack([frame.level for frame in sampled])
    bands = _Bands([frame.grey for frame in sampled], level, level.mean() / np.maximum(level, 1.0))
    found = _stale(bands, [frame.prints for frame in sampled])
    others = np.delete(np.arange(len(sampled)), list(found))
    if len(others) >= LEAST_FRAMES:
        lit = level[others].mean(axis=(1, 2, 3)) >= TEAR.dark * level.mean()
        unlike = _unlike(bands.of_frames(others), lit, slots[others].tolist(), white_counts, change)
        found |= {int(others[k]): share for k, share in unlike.items()}
    return sorted(found.items())


@dataclass(frozen=True, slots=True, eq=False)
class _Bands:
    """Samples of the bands of all frames, [k][band, row, col], brought to one mean: flicker is no tear."""

    raw: Sequence[Greys]
    level: Floats
    factor: Floats

    def __len__(self) -> int:
        return len(self.raw)

    def __getitem__(self, k: int) -> Floats:
        return (self.raw[k].astype(np.float32) - self.level[k]) * self.factor[k]

    def of_band(self, band: int) -> Floats:
        """Return one band of all frames, [k, row, col]."""
        raw = np.stack([frame[band] for frame in self.raw])
        return (raw.astype(np.float32) - self.level[:, band]) * self.factor[:, band]

    def of_frames(self, frames: NDArray[np.intp]) -> _Bands:
        """Return the bands of some frames."""
        raw = [self.raw[k] for k in frames]
        return self if len(frames) == len(self) else _Bands(raw, self.level[frames], self.factor[frames])


def _unlike(
    bands: _Bands, lit: NDArray[np.bool_], slots: list[int], white_counts: int, change: Change
) -> dict[int, float]:
    """Return the torn fraction of frames of which some bands alone differ from the frames beside them."""
    n_bands, scale = bands.level.shape[1], bands.level.mean() ** 2
    off = scale * np.stack([change(*pair) for pair in pairwise(slots)])
    across = scale * np.stack([change(*pair) for pair in zip(slots, slots[2:], strict=False)])
    own = np.minimum(off[1:], off[:-1])
    ratio = own / np.maximum(across, 1e-6)
    suspect = (ratio > TEAR.least_ratio) & (own > (TEAR.least_share_of_white * white_counts) ** 2)
    suspect &= lit[1:-1, None]
    found: dict[int, float] = {}
    for k in np.flatnonzero(suspect.any(axis=1)):
        torn = [b for b in np.flatnonzero(suspect[k]) if _is_torn(bands, int(b), int(k) + 1, own[k, b])]
        clear = len(torn) >= TEAR.enough_bands or bool(np.any(ratio[k, torn] > TEAR.clear_ratio))
        whole = np.delete(ratio[k], torn)
        if clear and whole.size and np.median(whole) <= TEAR.whole_ratio:
            found[int(k) + 1] = len(torn) / n_bands
    return found


def _stale(bands: _Bands, prints: Sequence[tuple[tuple[int, int], ...]]) -> dict[int, float]:
    """Return the torn fraction of frames that share some bands, to the last count, with another frame.

    Noise makes that impossible, so a stack without noise is not tested. Of the two frames the one is stale to which the
    bands fit worse.
    """
    shared: dict[tuple[int, int], list[int]] = {}
    n_bands = bands.level.shape[1]
    for b in range(n_bands):
        seen: dict[tuple[int, int], int] = {}
        for k, band in enumerate(frame[b] for frame in bands.raw):
            first = seen.setdefault(prints[k][b], k)
            if first != k and np.array_equal(band, bands.raw[first][b]) and band.std() > 1:
                shared.setdefault((first, k), []).append(b)
    if len(shared) > TEAR.most_stale or any(len(alike) == n_bands for alike in shared.values()):
        return {}
    found: dict[int, float] = {}
    for (one, other), alike in shared.items():
        worse = _misfit(bands, alike, one, other) > _misfit(bands, alike, other, one)
        found[one if worse else other] = len(alike) / n_bands
    return found


def _misfit(bands: _Bands, alike: list[int], k: int, twin: int) -> float:
    """Return how much bands of a frame differ from the frame beside it, relative to the next two further on.

    twin: the frame with the same bands, which does not count; the better of both sides is taken.
    """
    sides = [(k + d, k + 2 * d) for d in (-1, 1) if 0 <= k + 2 * d < len(bands) and twin not in (k + d, k + 2 * d)]
    return min((_change(bands, alike, k, i) / max(1e-6, _change(bands, alike, i, j)) for i, j in sides), default=1.0)


def _change(bands: _Bands, alike: list[int], one: int, other: int) -> float:
    return float(np.sum((bands[one][alike] - bands[other][alike]) ** 2))


def _is_torn(bands: _Bands, b: int, k: int, off: float) -> bool:
    """Return whether band b of frame k is no sharper than beside it, or looks like another frame."""
    band = bands.of_band(b)
    energy = np.mean(np.diff(band[k - 1 : k + 2], axis=2) ** 2, axis=(1, 2))
    if energy[1] <= TEAR.sharper * max(energy[0], energy[2]):
        return True
    others = np.delete(np.arange(len(band)), (k - 1, k, k + 1))
    return bool(others.size) and float(_mean_square(band[others], band[k]).min()) < TEAR.alike * off


def _mean_square(one: Floats, other: Floats) -> Floats:
    return np.mean((one - other) ** 2, axis=(-2, -1))


def relative_change(one: SampledBands, other: SampledBands) -> Floats:
    """Return the mean square difference between sampled bands of two frames, each relative to its mean, [band]."""
    change = np.empty(len(one.grey), np.float32)
    _mean_squares(one.grey, other.grey, one.level.ravel(), other.level.ravel(), change)
    return change


@bare_kernel
def _mean_squares(one: Greys, other: Greys, level: Float32s, other_level: Float32s, change: Float32s) -> None:
    """Write the mean square of the difference of relative deviations from the mean, of each band."""
    for b in range(change.size):
        total, least = 0.0, np.float32(1)
        first, second = level[b], other_level[b]
        part, other_part = least / max(first, least), least / max(second, least)
        for r in range(one.shape[1]):
            row, beside, squares = one[b, r], other[b, r], np.float32(0)
            for x in range(row.size):
                off = (np.float32(row[x]) - first) * part - (np.float32(beside[x]) - second) * other_part
                squares += off * off
            total += squares
        change[b] = total / (one.shape[1] * one.shape[2])


def sampled_bands(frame: Image) -> SampledBands:
    """Return a sample of each band of rows of a frame."""
    n_bands = TEAR.bands
    if min(frame.shape) < n_bands:
        return SampledBands(np.empty((n_bands, 0, 0), np.uint8), np.empty((n_bands, 1, 1), np.float32), ())
    high = len(frame) // n_bands
    n_rows = min(high, TEAR.sampled[0])
    rows = (np.arange(n_bands)[:, None] * high + np.linspace(0, high - 1, n_rows).astype(int)).ravel()
    every = -(-frame.shape[1] // TEAR.sampled[1])
    grey = native_copy(frame[rows, ::every])
    sums, energies = cell_sums(grey, (n_rows, grey.shape[1]), 0)[0][:, 0], slope_energies(grey, 1)
    prints = tuple(zip(sums.tolist(), energies.reshape(n_bands, -1).sum(axis=1).tolist(), strict=True))
    level = (sums / (n_rows * grey.shape[1])).astype(np.float32)
    return SampledBands(grey.reshape(n_bands, n_rows, -1), level[:, None, None], prints)
