"""Where straight edges run across search lines, and how much they stand out of everything else. Pure.

All slopes up to a limit are tried: along an edge's own slope the responses of all lines add up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.robust_plane import SIGMA_OF_MAD
from wafer_viewer.measure.edges.search_strip import SearchStrip
from wafer_viewer.measure.edges.subpixel_edges import SEARCH_SIGMA_PX, Responses, responses

MOST_SLOPE = 0.12
"""Edges are looked for up to this slope against the crossing of search lines: 6.8 degrees."""
SLOPE_STEP_PX = 4.0
"""From one slope to the next the ends of an edge move by half of this against each other."""
BANDS = 64
"""Search lines are averaged to so many before slopes are tried."""
STANDS_OUT = 5.0
"""Robust deviations of all places by which an edge stands out of them."""
LEAST_STEEP, LEAST_REST = 0.05, 16
"""Grey values a pixel below which nothing is an edge; places apart from an edge that say what noise is."""
SEEN, ALL_ALONG = 0.4, 0.8
"""Of an edge's mean steepness: what of it each band must have, and how many bands."""
HALF_WAY, BESIDE_PX = 0.5, 10
"""Down to this share of its top a peak is one edge, and no less than so far to either side."""
Sign = Literal[-1, 1]
"""1: from dark to bright along the search lines."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeScores:
    """How steep a straight edge is at each place of the middle line: best over all slopes, [place], with that slope.

    bands: means of neighbouring lines, [band, place], and how far the middle of each lies from the middle line.
    """

    best: Floats
    slope: Floats
    n_lines: int
    bands: Responses
    middles: Floats

    def expected(self, place: int) -> Floats:
        """Where the edge through a place of the middle line crosses each line."""
        line = np.arange(self.n_lines, dtype=np.float64)
        return place + float(self.slope[place]) * (line - (self.n_lines - 1) / 2)

    def top(self) -> int:
        """The place of the strongest edge."""
        return int(np.argmax(self.best))

    def first(self, share: float) -> int:
        """The place of the first edge that has this share of the strongest."""
        strong = self.best >= share * float(self.best.max())
        start = int(np.argmax(strong))
        weak = np.flatnonzero(~strong[start:])
        return start + int(np.argmax(self.best[start : start + int(weak[0]) if len(weak) else None]))

    def besides(self, place: int, after: int = 0, up_to: int | None = None) -> float:
        """The strongest edge anywhere else, or between two places."""
        low, high = self._extent(place)
        return max(float(part.max(initial=0.0)) for part in (self.best[after:low], self.best[high:up_to]))

    def stands_out(self, place: int, only_before: bool = False) -> bool:
        """Whether an edge is seen all along, and is more than the noise of places well apart from it.

        only_before: of those that come before it, where what comes behind is printed.
        """
        if not self._all_along(place):
            return False
        low, high = self._extent(place)
        wide = high - low
        behind = self.best[:0] if only_before else self.best[high + wide :]
        rest = np.concatenate([self.best[: max(0, low - wide)], behind])
        if len(rest) < LEAST_REST:
            return bool(self.best[place] > LEAST_STEEP)
        middle = float(np.median(rest))
        spread = SIGMA_OF_MAD * float(np.median(np.abs(rest - middle)))
        return bool(self.best[place] > max(middle + STANDS_OUT * spread, LEAST_STEEP))

    def _all_along(self, place: int) -> bool:
        """Whether an edge runs all through the lines: noise that happens to add up does not."""
        at = np.round(place + float(self.slope[place]) * self.middles).astype(np.intp)
        seen = self.bands[np.arange(len(at)), np.clip(at, 0, self.bands.shape[1] - 1)]
        return bool(np.mean(seen > SEEN * self.best[place]) >= ALL_ALONG)

    def _extent(self, place: int) -> tuple[int, int]:
        """The first place of a peak, and the first behind it; no less than the filter makes of a sharp edge."""
        below = self.best < HALF_WAY * self.best[place]
        low, high = np.flatnonzero(below[:place]), np.flatnonzero(below[place:])
        first = int(low[-1]) + 1 if len(low) else 0
        last = place + int(high[0]) if len(high) else len(self.best)
        return max(0, min(first, place - BESIDE_PX)), max(last, place + BESIDE_PX + 1)


def scores_of(strip: SearchStrip, sign: Sign) -> EdgeScores:
    """How strong a straight edge of a sign is at every place of the middle search line, whatever its slope."""
    middles, bands = _bands(responses(strip.grey, strip.there, SEARCH_SIGMA_PX), sign)
    n_lines = len(strip.grey)
    slopes = np.linspace(-MOST_SLOPE, MOST_SLOPE, 2 * math.ceil(MOST_SLOPE * n_lines / SLOPE_STEP_PX / 2) + 1)
    found = np.stack([_along(bands, np.round(slope * middles).astype(np.intp)) for slope in slopes])
    which = np.argmax(found, axis=0)
    return EdgeScores(
        found[which, np.arange(found.shape[1])].astype(np.float64), slopes[which], n_lines, bands, middles
    )


def _bands(response: Responses, sign: Sign) -> tuple[Floats, Responses]:
    """Means of neighbouring lines, and how far the middle of each lies from the middle line."""
    cuts = np.linspace(0, len(response), min(BANDS, len(response)) + 1).astype(np.intp)
    sums = np.add.reduceat(response, cuts[:-1], axis=0)
    middles = (cuts[:-1] + cuts[1:] - 1) / 2 - (len(response) - 1) / 2
    return middles, (sign * sums / np.diff(cuts)[:, None]).astype(np.float32)


def _along(bands: Responses, shifts: NDArray[np.intp]) -> Floats:
    """The mean over the bands, each moved back by its shift; what would lie outside counts as even."""
    width = bands.shape[1]
    place = np.arange(width)[None, :] + shifts[:, None]
    found = np.take_along_axis(bands, np.clip(place, 0, width - 1), axis=1)
    return np.where((place >= 0) & (place < width), found, 0.0).mean(axis=0)
