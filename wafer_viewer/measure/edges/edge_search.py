"""Detection of straight edges across search lines, and their prominence. Pure.

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
"""Largest slope of an edge against the normal of the search lines: 6.8 degrees."""
SLOPE_STEP_PX = 4.0
"""Step between trial slopes: largest displacement of an edge's ends relative to its centre, px."""
BANDS = 64
"""Largest number of bands to which search lines are averaged before slopes are tried."""
STANDS_OUT = 5.0
"""Smallest prominence of an edge, in robust deviations of all places."""
LEAST_STEEP, LEAST_REST = 0.05, 16
"""Smallest gradient of an edge, in grey values per pixel; smallest number of places for the noise estimate."""
SEEN, ALL_ALONG = 0.4, 0.8
"""Fraction of an edge's mean steepness required in a band, and fraction of the bands that must reach it."""
HALF_WAY, BESIDE_PX = 0.5, 10
"""Fraction of its maximum that bounds a peak, and its smallest half-width in pixels."""
Sign = Literal[-1, 1]
"""1: from dark to bright along the search lines."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeScores:
    """Steepness of a straight edge at each place of the middle line: best over all slopes, [place], and that slope.

    bands: means of neighbouring lines, [band, place]; middles: offsets of their centres from the middle line.
    """

    best: Floats
    slope: Floats
    n_lines: int
    bands: Responses
    middles: Floats

    def expected(self, place: int) -> Floats:
        """Return the crossings of each line with the edge through a place of the middle line."""
        line = np.arange(self.n_lines, dtype=np.float64)
        return place + float(self.slope[place]) * (line - (self.n_lines - 1) / 2)

    def top(self) -> int:
        """Return the place of the strongest edge."""
        return int(np.argmax(self.best))

    def first(self, share: float) -> int:
        """Return the place of the first edge with this fraction of the strongest."""
        strong = self.best >= share * float(self.best.max())
        start = int(np.argmax(strong))
        weak = np.flatnonzero(~strong[start:])
        return start + int(np.argmax(self.best[start : start + int(weak[0]) if len(weak) else None]))

    def strongest_other(self, place: int, after: int = 0, up_to: int | None = None) -> float:
        """Return the strength of the strongest other edge, or of that between two places."""
        low, high = self._extent(place)
        return max(float(part.max(initial=0.0)) for part in (self.best[after:low], self.best[high:up_to]))

    def stands_out(self, place: int, only_before: bool = False) -> bool:
        """Return whether an edge is continuous and exceeds the noise of places well apart from it.

        only_before: noise from the places before it only, where those after it are patterned.
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
        """Return whether an edge is present in most bands; chance alignments of noise are not."""
        at = np.round(place + float(self.slope[place]) * self.middles).astype(np.intp)
        seen = self.bands[np.arange(len(at)), np.clip(at, 0, self.bands.shape[1] - 1)]
        return bool(np.mean(seen > SEEN * self.best[place]) >= ALL_ALONG)

    def _extent(self, place: int) -> tuple[int, int]:
        """Return the first place of a peak and the first after it; at least the width of the filter response."""
        below = self.best < HALF_WAY * self.best[place]
        low, high = np.flatnonzero(below[:place]), np.flatnonzero(below[place:])
        first = int(low[-1]) + 1 if len(low) else 0
        last = place + int(high[0]) if len(high) else len(self.best)
        return max(0, min(first, place - BESIDE_PX)), max(last, place + BESIDE_PX + 1)


def scores_of(strip: SearchStrip, sign: Sign) -> EdgeScores:
    """Return the strength of a straight edge of a sign at every place of the middle line, over all slopes."""
    middles, bands = _bands(responses(strip.grey, strip.there, SEARCH_SIGMA_PX), sign)
    n_lines = len(strip.grey)
    slopes = np.linspace(-MOST_SLOPE, MOST_SLOPE, 2 * math.ceil(MOST_SLOPE * n_lines / SLOPE_STEP_PX / 2) + 1)
    found = np.stack([_along(bands, np.round(slope * middles).astype(np.intp)) for slope in slopes])
    which = np.argmax(found, axis=0)
    return EdgeScores(
        found[which, np.arange(found.shape[1])].astype(np.float64), slopes[which], n_lines, bands, middles
    )


def _bands(response: Responses, sign: Sign) -> tuple[Floats, Responses]:
    """Return the means of neighbouring lines, and the offsets of their centres from the middle line."""
    cuts = np.linspace(0, len(response), min(BANDS, len(response)) + 1).astype(np.intp)
    sums = np.add.reduceat(response, cuts[:-1], axis=0)
    middles = (cuts[:-1] + cuts[1:] - 1) / 2 - (len(response) - 1) / 2
    return middles, (sign * sums / np.diff(cuts)[:, None]).astype(np.float32)


def _along(bands: Responses, shifts: NDArray[np.intp]) -> Floats:
    """Return the mean over the bands, each shifted back; places outside count as zero."""
    width = bands.shape[1]
    place = np.arange(width)[None, :] + shifts[:, None]
    found = np.take_along_axis(bands, np.clip(place, 0, width - 1), axis=1)
    return np.where((place >= 0) & (place < width), found, 0.0).mean(axis=0)
