"""Search for the focus from scores of single frames over z, with the drive to the place and its exposure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.auto_exposure import exposure_at
from wafer_viewer.acquire.commanded_frames import CommandedFrames, commanded_frames
from wafer_viewer.acquire.motion import device_errors, drive, move
from wafer_viewer.acquire.pass_runner import rig_at_rest
from wafer_viewer.model.acquisition.devices import Position, Rig
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.procedure import ProcedureControl, ProcedureStep
from wafer_viewer.model.errors import RigError

# --------------------------------------------------------------------------------------------------------------- search


@dataclass(frozen=True, slots=True)
class FocusSearchParameters:
    """Extent and steps of the search; lengths are in depths of field.

    Parameters
    ----------
    half_range : float
        First window to either side of the start: 6 depths of field take about a second.
    widening : float
        Factor of the second window, if nothing is in focus within the first.
    coarse_step : float
        Step of the coarse search. The score of a flat sample (virtual scene plane) falls to half within 0.45 depths of
        field.
    fine_range : float
        Extent of the fine search to either side of the best coarse frame.
    fine_step : float
        Step of the fine search.
    most_extensions : int
        Number of times that a window is extended if its sharpest frame is the last one.
    prominence : float
        Least rise of the score from the dullest to the sharpest frame. Camera noise spreads the scores of twelve
        featureless frames of the virtual camera over 2 %.
    fit_above : float
        Frames of the fine search that are fitted, by their score as a fraction of the best one.
    """

    half_range: float = 6.0
    widening: float = 4.0
    coarse_step: float = 0.75
    fine_range: float = 1.25
    fine_step: float = 0.2
    most_extensions: int = 3
    prominence: float = 0.05
    fit_above: float = 0.6


FOCUS_SEARCH = FocusSearchParameters()
FEWEST_FITTED = 5
"""Fewest frames that a parabola is fitted to: two more than it has parameters."""


@dataclass(frozen=True, slots=True)
class FocusFound:
    """Position of the focus, and all scores of the search.

    z_um, u_um: position of the peak and its standard uncertainty (k = 1) from the residuals of the fit; score: at the
    best frame; curve: (z in um, score) by z.
    """

    z_um: float
    u_um: float
    score: float
    curve: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class GoToFocus:
    """Procedure that finds the sharpest z at the current place and moves there.

    exposure_us: of its frames. highest_um: highest known z of the sample, which the objective stays clear of; None if
    nothing is known, then only the range of the axis counts. z_range_um: lowest and highest z that the search looks at;
    None for a few depths of field about the start, and farther if nothing is in focus there.
    """

    exposure_us: float
    highest_um: float | None = None
    z_range_um: tuple[float, float] | None = None
    parameters: FocusSearchParameters = FOCUS_SEARCH

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Go to focus"

    def run(self, rig: Rig, control: ProcedureControl) -> FocusFound:
        """Find the focus and move there.

        Raises RigError if nothing is in focus within the window, or the peak lies beyond the limits of z; the stage is
        then back at its start. MotionStopped if stopped.
        """
        with device_errors("stage"):
            start_um = rig.stage.position().z_um
        try:
            with rig_at_rest(rig), commanded_frames(rig, self.exposure_us) as frames:
                found = _Search(self, rig, frames, control, start_um).run()
        except NothingInFocus as fault:
            with device_errors("stage"):
                move(rig, {"z": start_um}, control.should_stop)
            raise RigError(str(fault)) from None
        with device_errors("stage"):
            move(rig, {"z": found.z_um}, control.should_stop)
        return found


class NothingInFocus(RigError):
    """The search found no focus."""


class _Search:
    def __init__(
        self, order: GoToFocus, rig: Rig, frames: CommandedFrames, control: ProcedureControl, start_um: float
    ) -> None:
        self._order, self._rig, self._frames, self._control = order, rig, frames, control
        self._start_um = start_um
        low_um, high_um = order.z_range_um or (-math.inf, math.inf)
        self._low_um = max(rig.limits.lowest_z_um(order.highest_um), low_um)
        self._high_um = min(rig.limits.z.high_um, high_um)
        self._dof_um = rig.limits.depth_of_field_um
        self._scores: dict[float, float] = {}

    def run(self) -> FocusFound:
        """Search coarsely, wider if needed, then finely; fit the peak."""
        p, dof_um = self._order.parameters, self._dof_um
        for low_um, high_um in self._windows_um:
            if (peak_um := self._coarse(low_um, high_um)) is not None:
                break
        else:
            raise self._nothing()
        self._score(_steps(peak_um - p.fine_range * dof_um, peak_um + p.fine_range * dof_um, p.fine_step * dof_um))
        z_um, u_um = self._fit(max(self._scores, key=self._scores.__getitem__))
        curve = tuple(sorted(self._scores.items()))
        return FocusFound(z_um, u_um, max(self._scores.values()), curve)

    @property
    def _windows_um(self) -> tuple[tuple[float, float], ...]:
        """Windows of z that are searched one after the other; one for a given range."""
        if self._order.z_range_um is not None:
            return ((self._low_um, self._high_um),)
        near_um = self._order.parameters.half_range * self._dof_um
        reaches_um = near_um, near_um * self._order.parameters.widening
        return tuple((self._start_um - reach_um, self._start_um + reach_um) for reach_um in reaches_um)

    def _coarse(self, low_um: float, high_um: float) -> float | None:
        """Return z of the sharpest frame of a window, which is extended if that is the last one; None if none is."""
        p = self._order.parameters
        step_um, reach_um = p.coarse_step * self._dof_um, (high_um - low_um) / 2
        self._score(_steps(low_um, high_um, step_um))
        for _ in range(p.most_extensions):
            if not self._stands_out:
                return None
            best_um = max(self._scores, key=self._scores.__getitem__)
            if best_um < min(self._scores) + step_um / 2 and best_um > self._low_um:
                self._score(_steps(best_um - reach_um, best_um - step_um, step_um))
            elif best_um > max(self._scores) - step_um / 2 and best_um < self._high_um:
                self._score(_steps(best_um + step_um, best_um + reach_um, step_um))
            else:
                return best_um
        return max(self._scores, key=self._scores.__getitem__) if self._stands_out else None

    @property
    def _stands_out(self) -> bool:
        scores = self._scores.values()
        return max(scores) >= (1 + self._order.parameters.prominence) * min(scores) > 0

    def _score(self, z_um: Sequence[float]) -> None:
        """Score frames at positions within the limits, upwards; those scored already are left out."""
        reachable = [z for z in z_um if self._low_um <= z <= self._high_um and z not in self._scores]
        for done, (z, score) in enumerate(self._scored(reachable), 1):
            self._scores[z] = score
            self._control.report(ProcedureStep(0.9 * done / len(reachable), f"z {z:+.1f} um"))
        if not self._scores:
            raise self._nothing()

    def _scored(self, z_um: Sequence[float]) -> Iterator[tuple[float, float]]:
        from wafer_viewer.numerics.filters.frame_focus import frame_focus

        for position_um in z_um:
            with device_errors("stage"):
                move(self._rig, {"z": position_um}, self._control.should_stop)
            taken = self._frames.take()
            if taken is not None:
                yield taken.position.z_um, frame_focus(taken.image)

    def _fit(self, best_um: float) -> tuple[float, float]:
        """Return position and standard uncertainty of the peak.

        The energy of a gradient goes as 1 / v^2 with the variance v of the blur, which grows with the square of the
        distance from focus: 1 / sqrt(score) is a parabola over z.
        """
        p = self._order.parameters
        reach_um, least = p.fine_range * self._dof_um, p.fit_above * self._scores[best_um]
        near = [(z, s) for z, s in self._scores.items() if abs(z - best_um) <= reach_um]
        fitted = sorted(near, key=lambda point: -point[1])
        used = [point for point in fitted if point[1] >= least]
        used = used if len(used) >= FEWEST_FITTED else fitted[:FEWEST_FITTED]
        if len(used) < FEWEST_FITTED:
            raise self._at_limit(best_um)
        peak = parabola_vertex(np.array([z - best_um for z, _ in used]), np.array([s**-0.5 for _, s in used]))
        if peak is None or abs(peak[0]) > reach_um or not self._low_um <= best_um + peak[0] <= self._high_um:
            raise self._at_limit(best_um)
        return best_um + peak[0], peak[1]

    def _nothing(self) -> NothingInFocus:
        scores = self._scores.values()
        if not scores:
            return NothingInFocus(
                f"The focus cannot be searched at z {self._start_um:.1f} um: z is limited to {self._low_um:.1f} to "
                f"{self._high_um:.1f} um, or the camera gives no frames. Check its trigger, and move z into the range."
            )
        rise = max(scores) / max(min(scores), 1e-12) - 1
        return NothingInFocus(
            f"Nothing is in focus from z {min(self._scores):.1f} to {max(self._scores):.1f} um: the sharpest frame is "
            f"only {rise:.1%} sharper than the dullest. Move to a place with structure, set the exposure, or start "
            "nearer to the sample."
        )

    def _at_limit(self, best_um: float) -> NothingInFocus:
        mend = "Check the highest known point of the sample" if self._order.z_range_um is None else "Widen the range"
        return NothingInFocus(
            f"The sharpest frame is at z {best_um:.1f} um, but no peak lies between {self._low_um:.1f} and "
            f"{self._high_um:.1f} um, where z stops. {mend}, or move to another place."
        )


def parabola_vertex(z_um: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the minimum of a parabola through points and its standard uncertainty; None if it has no minimum.

    Parameters
    ----------
    z_um : float64 [n]
        Positions, at least four.
    values : float64 [n]
        Values of equal variance, which is estimated from the residuals.

    Returns
    -------
    tuple of float, or None
        Position and standard uncertainty (k = 1), in um.
    """
    design = np.stack([z_um**2, z_um, np.ones_like(z_um)], axis=1)
    (a, b, c), *_ = np.linalg.lstsq(design, values, rcond=None)
    if a <= 0:
        return None
    residuals = values - design @ np.array([a, b, c])
    variance = float(residuals @ residuals) / (len(values) - 3)
    covariance = variance * np.linalg.inv(design.T @ design)
    gradient = np.array([b / (2 * a**2), -1 / (2 * a), 0.0])
    return float(-b / (2 * a)), float(np.sqrt(gradient @ covariance @ gradient))


def _steps(low_um: float, high_um: float, step_um: float) -> list[float]:
    n = max(1, round((high_um - low_um) / step_um))
    return [low_um + (high_um - low_um) * k / n for k in range(n + 1)]


# ------------------------------------------------------------------------------------------------------------- at place


FEWEST_LOOKED_AT = 5
"""Fewest positions in z of a frame for the exposure; otherwise they are a depth of field apart."""


@dataclass(frozen=True, slots=True)
class FocusedPlace:
    """Focus found at a place of the stage, in um, and the exposure of its frames."""

    x_um: float
    y_um: float
    exposure_us: float
    focus: FocusFound


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusAtPlace:
    """Procedure that drives to a place, finds the exposure if none is given, and goes to the focus.

    x_um, y_um, z_um: place and middle of the search; None for where the stage stands. z_range_um: range of z about it
    that the search looks at; None for a few depths of field, and farther if nothing is in focus there. exposure_us:
    None to find it. highest_um: highest z of the sample, which the objective stays clear of; None for the middle of the
    search.
    """

    x_um: float | None = None
    y_um: float | None = None
    z_um: float | None = None
    z_range_um: float | None = None
    exposure_us: float | None = None
    highest_um: float | None = None

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Go to focus"

    def run(self, rig: Rig, control: ProcedureControl) -> FocusedPlace:
        """Drive to the place, find its exposure and its focus, and end there.

        Raises RigError if nothing is in focus, or the place is out of range or too near to the sample; MotionStopped if
        stopped.
        """
        start = self._start(rig)
        highest_um = start.z_um if self.highest_um is None else self.highest_um
        goal_um: dict[Axis, float] = {"x": start.x_um, "y": start.y_um, "z": start.z_um}
        control.report(ProcedureStep(0.0, "Drive to the place"))
        drive(rig, goal_um, highest_um, control.should_stop)
        half_um = None if self.z_range_um is None else self.z_range_um / 2
        exposure_us = self.exposure_us or _exposure_us(rig, start, half_um, highest_um, control)
        within_um = None if half_um is None else (start.z_um - half_um, start.z_um + half_um)
        found = GoToFocus(exposure_us, highest_um, within_um).run(rig, control)
        return FocusedPlace(start.x_um, start.y_um, exposure_us, found)

    def _start(self, rig: Rig) -> Position:
        """Return the place and the middle of the search. Raises RigError for a lost stage and for an empty range."""
        if self.z_range_um is not None and self.z_range_um <= 0:
            raise RigError(f"z_range_um is {self.z_range_um:g}: it must be more than 0 um.")
        wanted = {"x_um": self.x_um, "y_um": self.y_um, "z_um": self.z_um}
        given = {name: um for name, um in wanted.items() if um is not None}
        if len(given) < len(wanted) and not rig.stage.homed():
            lacking = ", ".join(name for name in wanted if name not in given)
            raise RigError(
                f"The stage is not homed, so that the place where it stands means nothing: give {lacking} too; the "
                "drive there homes it."
            )
        return replace(rig.stage.position(), **given)


def _exposure_us(
    rig: Rig, start: Position, half_um: float | None, highest_um: float, control: ProcedureControl
) -> float:
    """Return the exposure at which the brightest pixels over the nearest range of z are below white."""
    dof_um = rig.limits.depth_of_field_um
    reach_um = FOCUS_SEARCH.half_range * dof_um if half_um is None else half_um
    low_um = max(rig.limits.lowest_z_um(highest_um), start.z_um - reach_um)
    high_um = min(rig.limits.z.high_um, start.z_um + reach_um)
    positions_um = np.linspace(low_um, high_um, max(FEWEST_LOOKED_AT, round((high_um - low_um) / dof_um)))

    def tell(exposure_us: float) -> None:
        control.report(ProcedureStep(0.0, f"Exposure of {exposure_us:.0f} us"))

    return exposure_at(rig, start.x_um, start.y_um, positions_um, control.should_stop, tell)
