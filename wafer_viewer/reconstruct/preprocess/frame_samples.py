"""Measurements of single frames on which flashes, torn frames and flicker are judged; each frame is measured once.

They need one frame alone, so that those of a live field are taken while its frames arrive.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.jit import Greys
from wafer_viewer.reconstruct.preprocess.flicker import FlickerCells, flicker_cells
from wafer_viewer.reconstruct.preprocess.sensor_faults import FaultStats, fault_stats
from wafer_viewer.reconstruct.preprocess.torn_frames import sampled_bands

Sample = TypeVar("Sample")


class FrameSamples:
    """Measurements of the frames of one exposure, by slot; made on demand and kept.

    clipped_counts: grey from which a pixel is clipped.
    """

    def __init__(self, clipped_counts: int) -> None:
        self.clipped_counts = clipped_counts
        self._stats: dict[int, FaultStats] = {}
        self._bands: dict[int, Greys] = {}
        self._cells: dict[int, FlickerCells] = {}

    def take(self, slot: int, frame: Image) -> None:
        """Make all measurements of a frame."""
        self.stats(slot, frame)
        self.bands(slot, frame)
        self.cells(slot, frame)

    def stats(self, slot: int, frame: Image) -> FaultStats:
        """Return grey, clipped fraction and focus energy of a frame."""
        return _kept(self._stats, slot, lambda: fault_stats(frame, self.clipped_counts))

    def bands(self, slot: int, frame: Image) -> Greys:
        """Return a sample of each band of rows of a frame, [band, row, col]."""
        return _kept(self._bands, slot, lambda: sampled_bands(frame))

    def cells(self, slot: int, frame: Image) -> FlickerCells:
        """Return the cells of a frame."""
        return _kept(self._cells, slot, lambda: flicker_cells(frame, self.clipped_counts))


def _kept(known: dict[int, Sample], slot: int, measure: Callable[[], Sample]) -> Sample:
    if slot not in known:
        known[slot] = measure()
    return known[slot]
