"""Consistency of the passes of a dataset: pulse box counts, and frame times against pulse counts.

The axis of a pass moves at constant speed, so the device times of its frames are linear in the scale counts of their
pulses. A frame in a neighbour's slot deviates by a full pulse period, which shows in the journal alone, also in
datasets of older programs. The test does not apply to stop and shoot, and does not detect a constant shift of a pass.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.journal import FrameKept, JournalReader, Line, Missed, PassBegun, PassEnded
from wafer_viewer.store.dataset.scan_record import JOURNAL

LEAST_FRAMES = 8
"""Least number of frames from which the speed of a pass is estimated."""
OFF_PERIODS = 0.5
"""Deviation, in pulse periods, above which a frame time belongs to another pulse."""


@dataclass(frozen=True, slots=True)
class PassReport:
    """Consistency report on the passes of a dataset.

    n_passes: passes with frames that count; n_timed: those whose frame times were compared with the pulses;
    doubts: one sentence for each pass whose frames may be in the wrong slots or at the wrong height;
    noted: faults reported by the scan, in order.
    """

    n_passes: int
    n_timed: int
    doubts: tuple[str, ...]
    noted: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """True if no pass is in doubt."""
        return not self.doubts


@dataclass(slots=True)
class _Pass:
    begun: PassBegun
    frames: list[FrameKept] = field(default_factory=list[FrameKept])
    summary: PulseSummary | None = None


def check_passes(data: Dataset) -> PassReport:
    """Compare the frames of every pass with its counts and times. Raises DatasetError for a damaged journal."""
    passes = [one for one in _passes(JournalReader(data.path / JOURNAL).new_lines()) if one.frames]
    moving = data.scan.plan.strategy != "stop_and_shoot"
    timed = [one for one in passes if moving and len(one.frames) >= LEAST_FRAMES]
    doubts = [doubt for one in passes for doubt in (*_count_doubts(one), *(_time_doubts(one) if one in timed else ()))]
    return PassReport(len(passes), len(timed), tuple(doubts), data.faults)


def _passes(lines: Iterable[Line]) -> list[_Pass]:
    """Return the passes with the frames that count."""
    found: list[_Pass] = []
    now: _Pass | None = None
    for line in lines:
        match line:
            case PassBegun():
                if now is not None and now.begun.provisional:
                    found.pop()
                now = _Pass(line)
                found.append(now)
            case FrameKept() if now is not None:
                now.frames.append(line)
            case Missed() if now is not None and now.begun.provisional:
                now.frames = [frame for frame in now.frames if frame.shot != line.shot]
            case PassEnded() if now is not None:
                now.summary, now = line.summary, None
            case _:
                pass
    if now is not None and now.begun.provisional:
        found.pop()
    return found


def _count_doubts(one: _Pass) -> Iterable[str]:
    if (said := one.summary) is None:
        return
    counted = {
        "quadrature errors": said.quadrature_errors,
        "suppressed pulses": said.suppressed,
        "exposures more than pulses": max(0, said.exposures - said.emitted),
    }
    for what, number in counted.items():
        if number:
            yield (
                f"{_name(one)}: {len(one.frames)} frames were kept although the pulse box reported {number} {what}: "
                "their heights may be off; scan these fields again."
            )


def _time_doubts(one: _Pass) -> Iterable[str]:
    frames = sorted(one.frames, key=lambda frame: frame.device_time_us)
    times_us = np.array([frame.device_time_us for frame in frames], np.float64)
    counts = np.array([frame.pulse_count for frame in frames], np.float64)
    gaps_us, ways = np.diff(times_us), np.abs(np.diff(counts))
    if not ways.all():
        yield f"{_name(one)}: two frames have the same scale count: scan these fields again."
        return
    us_per_count = float(np.median(gaps_us / ways))
    off_periods = (gaps_us - us_per_count * ways) / (us_per_count * float(ways.min()))
    wrong = np.flatnonzero(np.abs(off_periods) > OFF_PERIODS)
    if wrong.size:
        first = frames[int(wrong[0]) + 1].shot
        yield (
            f"{_name(one)}: the times of the frames leave their pulses in {wrong.size} places, first at field "
            f"{first.field}, frame {first.k}, by {off_periods[wrong[0]]:+.1f} pulses: frames stand in slots of their "
            "neighbours; scan these fields again."
        )


def _name(one: _Pass) -> str:
    return f"Pass {one.begun.number + 1}, from field {one.frames[0].shot.field}"
