"""Pairwise registration of overlapping fields, with uncertainty and rejection reasons.

The images are compared first: the normalised correlation of the true overlap at every shift within reach, at a quarter
of the resolution. The best candidates are then refined to sub-pixel accuracy. Where the images are blank the heights
are compared instead.
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
"""Search reach: 40 px about the stage position by default, four standard deviations of a good stage.

Where both fields have structure but do not match there, the reach is 120 px or an eighth of the shorter side of a
field.
"""
LEAST_MEASURED = 0.1
"""Minimum measured fraction; with fewer heights nothing was in focus, and the images are noise and may differ."""
_LOST = (RejectionReason.UNLIKE, RejectionReason.END_OF_SEARCH)


@dataclass(frozen=True, slots=True)
class PairShift:
    """Lateral shift measured in one overlap; the fields have the meaning of those of `Shifts`."""

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
    """Register each pair of fields (indices, int32 [n, 2]) relative to their stage positions.

    reach_um: largest deviation from the stage position that is searched; by default as `REACH_PX` states. Only the
    possible overlap is read. progress receives the finished fraction (0 ... 1); an exception raised by it ends the
    work. threads: all cores if omitted.
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
    """Return the shift of the second field against the first, relative to their stage positions.

    reach_px: largest deviation along x and along y; by default as `REACH_PX` states. A rejected match retains its best
    shift and correlation, with a doubt; it must not be used.
    """
    found = _within(first, second, REACH_PX if reach_px is None else reach_px)
    wide_px = min(WIDE_REACH_PX, WIDE_FRACTION * min(*first.shape, *second.shape))
    if reach_px is not None or found.doubt not in _LOST or wide_px <= REACH_PX:
        return found
    wider = _within(first, second, wide_px)
    return wider if wider.doubt is RejectionReason.NONE else found


def _within(first: HeightMap, second: HeightMap, reach_px: float) -> PairShift:
    """Register by images, by heights where the images are blank, or else by the stage."""
    seen = match(first, second, reach_px, picture_of)
    if seen.doubt in _LOST and _measured_share(first, second) < LEAST_MEASURED:
        return _by_stage(RejectionReason.BLANK)
    if seen.doubt is not RejectionReason.BLANK:
        return _pair_shift(seen, first.pixel_um, ObservationSource.PICTURE)
    felt = match(first, second, reach_px, height_of)
    if felt.doubt is RejectionReason.NONE:
        return _pair_shift(felt, first.pixel_um, ObservationSource.HEIGHT)
    return _by_stage(RejectionReason.BLANK)


def _measured_share(first: HeightMap, second: HeightMap) -> float:
    """Return the measured fraction of an overlap, in the field that has less."""
    common = OverlapWindow.of(first, second, 0, 1).common
    shares = (np.isfinite(h.z_raw_um[part]).mean() for h, part in zip((first, second), common, strict=True))
    return min(map(float, shares))


def _pair_shift(found: Match, pixel_um: float, by: ObservationSource) -> PairShift:
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
