"""How far a field lies from where the stage says, beside its neighbour: found in their overlap, and when to doubt it.

The pictures are compared first: the normalised correlation of the true overlap at every shift within reach, at a
quarter of the resolution; then the best of them are refined to a small part of a pixel. Where nothing is to be seen the
heights are compared instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.progress import Progress
from wafer_viewer.model.surface.field_poses import ObservationSource, RejectionReason, Shifts
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.focus.field_blocks import on_threads
from wafer_viewer.reconstruct.registration.overlap_matching import Match, match
from wafer_viewer.reconstruct.registration.overlap_strips import OverlapWindow, height_of, picture_of

REACH_PX, WIDE_REACH_PX, WIDE_FRACTION = 40.0, 120.0, 0.125
"""Without a reach of its own a neighbour is looked for within 40 px of the stage's word, four deviations of a good
stage; where the two show enough but do not fit there, within 120 px or an eighth of the shorter side of a field."""
LEAST_MEASURED = 0.1
"""Where hardly a height was found nothing was ever sharp: pictures are noise there, and may well differ."""
_LOST = (RejectionReason.UNLIKE, RejectionReason.END_OF_SEARCH)


@dataclass(frozen=True, slots=True)
class PairShift:
    """What one overlap says; the fields of `Shifts` have the meaning."""

    x_um: float
    y_um: float
    u_x_um: float
    u_y_um: float
    correlation: float
    by: ObservationSource
    doubt: RejectionReason


def register(
    heights: Sequence[HeightMap],
    pairs: NDArray[np.int32],
    reach_um: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Shifts:
    """How each pair of fields (their places in the list, int32 [n, 2]) lies beside what the stage says.

    reach_um: how far from the stage's word a neighbour is looked for; as `REACH_PX` says without one. Only what may
    overlap is read. progress is told the finished share (0 ... 1); what it raises ends the work. threads: all cores
    without one.
    """
    found: list[PairShift] = [_by_stage(RejectionReason.BLANK)] * len(pairs)
    done = 0

    def one(n: int) -> None:
        nonlocal done
        first, second = heights[pairs[n, 0]], heights[pairs[n, 1]]
        found[n] = register_pair(first, second, None if reach_um is None else reach_um / first.pixel_um)
        done += 1
        if progress is not None:
            progress(done / len(pairs))

    on_threads(one, range(len(pairs)), threads)
    return _table(pairs, found)


def register_pair(first: HeightMap, second: HeightMap, reach_px: float | None = None) -> PairShift:
    """How the second field lies beside the first, against what the stage says.

    reach_px: how far off it may be along x and along y; as `REACH_PX` says without one. What fits nowhere keeps its
    best place and correlation, with a doubt; it must not be used.
    """
    found = _within(first, second, REACH_PX if reach_px is None else reach_px)
    wide_px = min(WIDE_REACH_PX, WIDE_FRACTION * min(*first.shape, *second.shape))
    if reach_px is not None or found.doubt not in _LOST or wide_px <= REACH_PX:
        return found
    wider = _within(first, second, wide_px)
    return wider if wider.doubt is RejectionReason.NONE else found


def _within(first: HeightMap, second: HeightMap, reach_px: float) -> PairShift:
    """By the pictures, by the heights where those are blank, or by the stage."""
    seen = match(first, second, reach_px, picture_of)
    if seen.doubt in _LOST and _measured_share(first, second) < LEAST_MEASURED:
        return _by_stage(RejectionReason.BLANK)
    if seen.doubt is not RejectionReason.BLANK:
        return _told(seen, first.pixel_um, ObservationSource.PICTURE)
    felt = match(first, second, reach_px, height_of)
    if felt.doubt is RejectionReason.NONE:
        return _told(felt, first.pixel_um, ObservationSource.HEIGHT)
    return _by_stage(RejectionReason.BLANK)


def _measured_share(first: HeightMap, second: HeightMap) -> float:
    """How much of an overlap has heights, in the field that has fewer of them there."""
    common = OverlapWindow.of(first, second, 0, 1).common
    shares = (np.isfinite(h.z_raw_um[part]).mean() for h, part in zip((first, second), common, strict=True))
    return min(map(float, shares))


def _told(found: Match, pixel_um: float, by: ObservationSource) -> PairShift:
    down, right = found.off_px
    u_down, u_right = found.u_px
    return PairShift(
        right * pixel_um, -down * pixel_um, u_right * pixel_um, u_down * pixel_um, found.correlation, by, found.doubt
    )


def _by_stage(doubt: RejectionReason) -> PairShift:
    return PairShift(0.0, 0.0, float("inf"), float("inf"), 0.0, ObservationSource.STAGE, doubt)


def _table(pairs: NDArray[np.int32], found: Sequence[PairShift]) -> Shifts:
    told = np.array([(f.x_um, f.y_um, f.u_x_um, f.u_y_um) for f in found], np.float64).reshape(-1, 4)
    doubt = np.array([f.doubt for f in found], np.uint8)
    return Shifts(
        first=np.array(pairs[:, 0], np.int32),
        second=np.array(pairs[:, 1], np.int32),
        x_um=told[:, 0].copy(),
        y_um=told[:, 1].copy(),
        u_x_um=told[:, 2].copy(),
        u_y_um=told[:, 3].copy(),
        correlation=np.array([f.correlation for f in found], np.float32),
        by=np.array([f.by for f in found], np.uint8),
        doubt=doubt,
        weight=(doubt == RejectionReason.NONE).astype(np.float32),
        residual_x_um=np.zeros(len(pairs)),
        residual_y_um=np.zeros(len(pairs)),
    )
