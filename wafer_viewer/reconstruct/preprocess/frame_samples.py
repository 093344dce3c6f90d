"""Measurements of frames on which flashes, torn frames, flicker and drift are judged; each is made once.

They need one or two frames alone, so that those of a live field are taken while its frames arrive.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.reconstruct.preprocess.drift import TileMotions
from wafer_viewer.reconstruct.preprocess.flicker import FlickerCells, flicker_cells
from wafer_viewer.reconstruct.preprocess.sensor_faults import FaultStats, fault_stats
from wafer_viewer.reconstruct.preprocess.torn_frames import SampledBands, relative_change, sampled_bands

Key = TypeVar("Key")
Sample = TypeVar("Sample")


class FrameSamples:
    """Measurements of the frames of one exposure, by slot; made on demand and kept.

    clipped_counts: grey from which a pixel is clipped; motions: of frames without corrections.
    """

    def __init__(self, clipped_counts: int) -> None:
        self.clipped_counts = clipped_counts
        self._stats: dict[int, FaultStats] = {}
        self._bands: dict[int, SampledBands] = {}
        self._cells: dict[int, FlickerCells] = {}
        self._changes: dict[tuple[int, int], NDArray[np.float32]] = {}
        self.motions = TileMotions()

    def take(self, slot: int, frame: Image) -> None:
        """Make all measurements of a frame, and those of it and the frames near it that were taken before."""
        self.stats(slot, frame)
        self.cells(slot, frame)
        if self.bands(slot, frame).grey.size:
            for near in (slot - 2, slot - 1, slot + 1, slot + 2):
                if near in self._bands:
                    self.change(slot, near)

    def stats(self, slot: int, frame: Image) -> FaultStats:
        """Return grey, clipped fraction and focus energy of a frame."""
        return _kept(self._stats, slot, lambda: fault_stats(frame, self.clipped_counts))

    def bands(self, slot: int, frame: Image) -> SampledBands:
        """Return a sample of each band of rows of a frame."""
        return _kept(self._bands, slot, lambda: sampled_bands(frame))

    def change(self, one: int, other: int) -> NDArray[np.float32]:
        """Return how much each band differs between two frames whose bands are sampled, [band]."""
        pair = min(one, other), max(one, other)
        return _kept(self._changes, pair, lambda: relative_change(self._bands[pair[0]], self._bands[pair[1]]))

    def cells(self, slot: int, frame: Image) -> FlickerCells:
        """Return the cells of a frame."""
        return _kept(self._cells, slot, lambda: flicker_cells(frame, self.clipped_counts))


def _kept(known: dict[Key, Sample], key: Key, measure: Callable[[], Sample]) -> Sample:
    if key not in known:
        known[key] = measure()
    return known[key]
