"""Torn frames: a part of the image belongs to another frame, or is displaced.

Cameras and drivers that lose packets or overwrite a buffer while it is read deliver frames of which a band of rows is
stale, early or shifted. Between neighbouring frames a sound image changes less than between the two frames beside it,
unless it is sharper than both, at its focus. A band that differs far more, while the other bands of the frame do not,
is torn when it is no sharper than the same rows beside it, or when it looks like another frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image

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
        Largest number of frames that share bands with a neighbour; more are a stack without noise.
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


def torn_frames(images: Image, slots: NDArray[np.intp], white_counts: int) -> dict[int, str]:
    """Return what is wrong with each torn frame among `slots`, in the order of z; none where there are many.

    Frames with fewer rows or columns than bands are not tested.
    """
    if len(slots) < LEAST_FRAMES or min(images.shape[1:]) < TEAR.bands:
        return {}
    torn = _torn(images, slots, white_counts)
    if len(torn) > TEAR.most_torn * len(slots):
        return {}
    return {
        int(slots[k]): f"is torn, about {share:.0%} of its rows do not belong to the frames beside it"
        for k, share in torn
    }


def _torn(images: Image, slots: NDArray[np.intp], white_counts: int) -> list[tuple[int, float]]:
    """Return the index along z and the torn fraction of each torn frame."""
    raw = np.stack([_bands(images[slot]) for slot in slots])
    level = raw.mean(axis=(2, 3), keepdims=True)
    bands = (raw - level) * (level.mean() / np.maximum(level, 1.0))  # flicker is no tear
    energy = np.mean(np.diff(bands, axis=3) ** 2, axis=(2, 3))
    off = _mean_square(bands[1:], bands[:-1])
    across = _mean_square(bands[2:], bands[:-2])
    least = (TEAR.least_share_of_white * white_counts) ** 2
    own = np.minimum(off[1:], off[:-1])
    ratio = own / np.maximum(across, 1e-6)
    suspect = (ratio > TEAR.least_ratio) & (own > least)
    suspect[level[1:-1].mean(axis=(1, 2, 3)) < TEAR.dark * level.mean()] = False
    found = _stale(raw)
    for k in np.flatnonzero(suspect.any(axis=1)):
        torn = [b for b in np.flatnonzero(suspect[k]) if _is_torn(bands[:, b], energy[:, b], int(k) + 1, own[k, b])]
        clear = len(torn) >= TEAR.enough_bands or bool(np.any(ratio[k, torn] > TEAR.clear_ratio))
        whole = np.delete(ratio[k], torn)
        if clear and whole.size and np.median(whole) <= TEAR.whole_ratio:
            found[int(k) + 1] = len(torn) / bands.shape[1]
    return sorted(found.items())


def _stale(raw: Floats) -> dict[int, float]:
    """Return the torn fraction of frames that share some bands, to the last count, with a frame beside them.

    Noise makes that impossible, so a stack without noise is not tested. The frame with the larger jump to its other
    neighbour is the stale one.
    """
    same = (raw[1:] == raw[:-1]).all(axis=(2, 3)) & (raw[1:].std(axis=(2, 3)) > 1)
    pairs = np.flatnonzero(same.any(axis=1) & ~same.all(axis=1))
    if len(pairs) > TEAR.most_stale or len(pairs) < np.count_nonzero(same.any(axis=1)):
        return {}
    found: dict[int, float] = {}
    for k in pairs.tolist():
        before, after = (_jump(raw[:, same[k]], near, far) for near, far in ((k, k - 1), (k + 1, k + 2)))
        found[k if before > after else k + 1] = float(same[k].mean())
    return found


def _jump(raw: Floats, near: int, far: int) -> float:
    """Return the difference between two frames relative to that of the next two further on."""
    beyond = 2 * far - near
    if not (0 <= far < len(raw) and 0 <= beyond < len(raw)):
        return 1.0
    return float(np.mean((raw[near] - raw[far]) ** 2) / max(1e-6, np.mean((raw[far] - raw[beyond]) ** 2)))


def _is_torn(band: Floats, energy: Floats, k: int, off: float) -> bool:
    """Return whether a band of frame k is no sharper than beside it, or looks like another frame."""
    if energy[k] <= TEAR.sharper * max(energy[k - 1], energy[k + 1]):
        return True
    others = np.delete(np.arange(len(band)), (k - 1, k, k + 1))
    return bool(others.size) and float(_mean_square(band[others], band[k]).min()) < TEAR.alike * off


def _mean_square(one: Floats, other: Floats) -> Floats:
    return np.mean((one - other) ** 2, axis=(-2, -1))


def _bands(frame: Image) -> Floats:
    """Return a sample of each band of rows, [band, row, col]."""
    n_bands = TEAR.bands
    high = len(frame) // n_bands
    n_rows = min(high, TEAR.sampled[0])
    rows = (np.arange(n_bands)[:, None] * high + np.linspace(0, high - 1, n_rows).astype(int)).ravel()
    every = -(-frame.shape[1] // TEAR.sampled[1])
    return frame[rows, ::every].astype(np.float32).reshape(n_bands, n_rows, -1)
