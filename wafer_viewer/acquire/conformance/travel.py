"""Ranges in which the axes move during the checks, within the soft limits and away from the objective."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from wafer_viewer.acquire.motion import at_um
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.rig_limits import RUN_UP_SPARE_S, AxisLimits, RigLimits
from wafer_viewer.model.errors import RigError

ORDER: tuple[Axis, ...] = ("z", "x", "y")
"""Order of motions: the objective first."""
N_PULSES = 64
"""Pulses of a pass: half a second of frames at 120 frames/s, and fewer than the records of any pulse box."""
PULSE_PERIOD_S = 0.001
"""Time between two pulses of a pass at any speed, s: ten times the shortest that a pulse of 50 us allows."""


@dataclass(frozen=True, slots=True)
class TravelLimits:
    """Ranges requested for the checks.

    longest_um: longest motion of x and y in um; None for as much as their full speed needs.
    z_um: range of z in um; None for below its position, away from the objective.
    """

    longest_um: float | None = None
    z_um: tuple[float, float] | None = None

    def require_reachable(self, limits: RigLimits) -> None:
        """Raise RigError for a range that is empty or that z cannot reach, and for a motion of no length."""
        if self.longest_um is not None and self.longest_um <= 0:
            raise RigError(f"The longest motion of x and y is {self.longest_um:g} um: it must be over 0.")
        if self.z_um is None:
            return
        for end_um in self.z_um:
            limits.z.require_reachable("z", end_um)
        if self.z_um[1] <= self.z_um[0]:
            raise RigError(
                f"The range of z from {self.z_um[0]:g} to {self.z_um[1]:g} um is empty: give the lower end first."
            )


@dataclass(frozen=True, slots=True)
class TravelWindow:
    """Range of one axis during the checks, and the fastest speed of a pass of N_PULSES in it."""

    axis: Axis
    low_um: float
    high_um: float
    speed_um_s: float
    limits: AxisLimits = field(repr=False)

    @property
    def length_um(self) -> float:
        """Length of the range."""
        return self.high_um - self.low_um

    @property
    def words(self) -> str:
        """Range, length and speed as a sentence."""
        return (
            f"{self.axis} moves by {self.length_um:.1f} um at the most, between {self.low_um:.1f} and "
            f"{self.high_um:.1f} um, with pulses at up to {self.speed_um_s:.0f} um/s"
        )

    def at_um(self, fraction: float) -> float:
        """Return the position at a fraction of the range."""
        return self.low_um + fraction * self.length_um


def travel_windows(limits: RigLimits, here: Position, travel: TravelLimits) -> dict[Axis, TravelWindow]:
    """Return the range of every axis round a position.

    x and y move to both sides. z moves below its position; where there is no room below, it moves up from its lower
    end by no more than it needs, and never over the safe height.
    """
    return {axis: _window(limits, axis, at_um(here, axis), travel) for axis in ORDER}


def speed_within_um_s(limits: AxisLimits, length_um: float, fastest_um_s: float) -> float:
    """Return the highest speed at which run-up, N_PULSES and run-out fit into a length."""
    constant_s = 2 * RUN_UP_SPARE_S + N_PULSES * PULSE_PERIOD_S
    # v^2 / a + constant v = length
    a = limits.acceleration_um_s2
    return min(fastest_um_s, (math.sqrt((constant_s * a) ** 2 + 4 * a * length_um) - constant_s * a) / 2)


def _window(limits: RigLimits, axis: Axis, here_um: float, travel: TravelLimits) -> TravelWindow:
    one, fastest_um_s = limits.axis(axis), limits.pass_speed_um_s(axis)
    needed_um = 2 * one.run_up_um(fastest_um_s) + N_PULSES * PULSE_PERIOD_S * fastest_um_s
    low_um, high_um = one.low_um, one.high_um
    if axis != "z":
        low_um, high_um = _placed(low_um, high_um, here_um, min(needed_um, travel.longest_um or needed_um), 0.5)
    elif travel.z_um is None:
        low_um, high_um = _placed(low_um, min(high_um, limits.objective.safe_z_um), here_um, needed_um, 1.0)
    else:
        low_um, high_um = travel.z_um
    return TravelWindow(axis, low_um, high_um, speed_within_um_s(one, high_um - low_um, fastest_um_s), one)


def _placed(low_um: float, high_um: float, here_um: float, length_um: float, below: float) -> tuple[float, float]:
    """Return a range with a fraction `below` of it under a position, shifted into the limits."""
    bottom_um = max(low_um, min(here_um - below * length_um, high_um - length_um))
    return bottom_um, min(high_um, bottom_um + length_um)


def words_of(windows: Mapping[Axis, TravelWindow]) -> tuple[str, ...]:
    """Return the ranges as sentences."""
    return tuple(window.words for window in windows.values())
