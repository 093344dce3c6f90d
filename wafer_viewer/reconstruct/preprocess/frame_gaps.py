"""Gaps in a stack, where frames are missing or were left out, and their effect on the heights beside them.

A focus curve that is not sampled over a gap pulls its peak to one side: by up to half of a step where one frame is
missing, and nothing shows it. Only heights whose peak takes frames from both sides of the gap are concerned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.frame_health import gap_u_um

LEAST_GAP = 1.5
"""Smallest distance of neighbouring frames that is a gap, in median distances."""
REACH_DOF = 0.75
"""Distance from the ends of a gap up to which it moves peaks, in depths of field: tests/bench/bench_gaps.py."""
LEAST_CONCERNED = 0.01
"""Smallest fraction of the measured heights that a gap of a field concerns."""


@dataclass(frozen=True, slots=True)
class FrameGap:
    """Heights from low_um to high_um are concerned by a gap; u_um: their standard uncertainty due to it."""

    low_um: float
    high_um: float
    u_um: float

    def concerns(self, z_um: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return which heights a gap concerns."""
        return (z_um >= self.low_um) & (z_um <= self.high_um)


def frame_gaps(frames_um: NDArray[np.float64], depth_of_field_um: float) -> tuple[FrameGap, ...]:
    """Return the gaps between frames at rising z."""
    apart_um = np.diff(frames_um)
    at = np.flatnonzero(apart_um > LEAST_GAP * np.median(apart_um)).tolist()
    reach_um = REACH_DOF * depth_of_field_um
    return tuple(
        FrameGap(frames_um[k] - reach_um, frames_um[k + 1] + reach_um, gap_u_um(apart_um[k], depth_of_field_um))
        for k in at
    )


def worst_gap_u_um(gaps: Sequence[FrameGap], z_um: NDArray[np.float32]) -> float:
    """Return the largest uncertainty by a gap that concerns the heights z_um, NaN where there are none; 0 without."""
    if not gaps:
        return 0.0
    measured = z_um[np.isfinite(z_um)]
    least = max(1.0, LEAST_CONCERNED * measured.size)
    return max((gap.u_um for gap in gaps if np.count_nonzero(gap.concerns(measured)) >= least), default=0.0)


def add_gaps(u_um: NDArray[np.float32], z_um: NDArray[np.float32], gaps: Sequence[FrameGap]) -> NDArray[np.float32]:
    """Return uncertainties of heights, both [row, col], with that by gaps."""
    out = u_um
    for gap in gaps:
        out = np.where(gap.concerns(z_um), np.hypot(out, np.float32(gap.u_um)), out)
    return out
