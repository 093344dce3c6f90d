"""Positioners: the motorised settings of an instrument beside x, y and z, each with one of a few roles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

import msgspec

from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.model.spec import Spec

Role = Literal["light", "objective", "zoom", "tilt_a", "tilt_b", "rotation"]
NAMED_WITHIN_FRACTION = 1e-3
"""Distance from a named position within which a positioner is at it, as a fraction of its range."""
ROUND_FRACTION = 1e-6
"""Distance beyond the range that rounding may make, as a fraction of the range."""


@dataclass(frozen=True, slots=True)
class RoleOfPositioner:
    """Descriptor of a role.

    Parameters
    ----------
    title : its name on the page.
    unit : unit of its positions.
    lifts_z : true if z has to be at the safe z before it moves, because it turns over the sample or turns the sample.
    only_named : true if it goes to its named positions only.
    lowest, highest : widest range that has a meaning; None for no bound.
    rest : position of a simulated one when it is switched on.
    digits : decimals of a position in words.
    """

    title: str
    unit: str
    lifts_z: bool = False
    only_named: bool = False
    lowest: float | None = None
    highest: float | None = None
    rest: float = 0.0
    digits: int = 2


ROLES: dict[Role, RoleOfPositioner] = {
    "light": RoleOfPositioner("Light", "%", lowest=0.0, highest=100.0, rest=100.0, digits=1),
    "objective": RoleOfPositioner("Objective", "deg", lifts_z=True, only_named=True),
    "zoom": RoleOfPositioner("Zoom", "x", lowest=0.01, rest=1.0),
    "tilt_a": RoleOfPositioner("Tilt A", "deg", lifts_z=True, lowest=-90.0, highest=90.0, digits=3),
    "tilt_b": RoleOfPositioner("Tilt B", "deg", lifts_z=True, lowest=-90.0, highest=90.0, digits=3),
    "rotation": RoleOfPositioner("Rotation", "deg", lifts_z=True, digits=3),
}
"""Table of the roles: a role is entered here, and nowhere else."""


class PositionerLimits(Spec, frozen=True, kw_only=True):
    """Role, range and named positions of a positioner, in the unit of its role.

    named: positions by name, such as those of the objectives on a nosepiece; lift_z_um: z that clears the sample while
    it moves, beside the safe z of the objective; None if that is enough.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    role: Role
    low: float
    high: float
    named: dict[str, float] = msgspec.field(default_factory=dict)
    lift_z_um: float | None = None

    @property
    def descriptor(self) -> RoleOfPositioner:
        """Descriptor of its role."""
        return ROLES[self.role]

    def name_at(self, position: float) -> str:
        """Return the name of a position; empty if it has none."""
        within = NAMED_WITHIN_FRACTION * (self.high - self.low)
        return next((name for name, at in self.named.items() if abs(at - position) <= within), "")

    def words(self, position: float) -> str:
        """Return a position with its unit, or its name."""
        return self.name_at(position) or f"{position:.{self.descriptor.digits}f} {self.descriptor.unit}"

    def goal(self, name: str, to: float | str) -> float:
        """Return a position that is given by its name or as a number.

        Parameters
        ----------
        name : str
            Name of the positioner, for the error.
        to : float or str
            A position in its unit, or the name of one.

        Returns
        -------
        float
            The position, within the range.

        Raises
        ------
        RigError
            If there is no such name, or the position is out of range or needs a name.
        """
        if isinstance(to, str) and to in self.named:
            return self.named[to]
        number = _number(to)
        names = ", ".join(f"'{one}'" for one in self.named)
        if number is None or (self.descriptor.only_named and not self.name_at(number)):
            wanted = f"one of {names}" if names else f"a number in {self.descriptor.unit}"
            raise RigError(f"The positioner '{name}' cannot go to '{to}': it must be {wanted}.")
        spare = ROUND_FRACTION * (self.high - self.low)
        if not self.low - spare <= number <= self.high + spare:
            raise RigError(
                f"The positioner '{name}' cannot go to {number:g} {self.descriptor.unit}: its range is {self.low:g} to "
                f"{self.high:g} {self.descriptor.unit}."
            )
        return min(max(number, self.low), self.high)


def _number(text: float | str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


class PositionerReading(Spec, frozen=True, kw_only=True):
    """Position of a positioner at one time, as it is recorded with a scan.

    position: None while it does not know where it is; named: name of that position, if it has one.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    name: str
    role: Role
    position: float | None = None
    unit: str
    named: str = ""

    @property
    def words(self) -> str:
        """Position in words."""
        if self.position is None:
            return "not homed"
        return self.named or f"{self.position:.{ROLES[self.role].digits}f} {self.unit}"


@dataclass(frozen=True, slots=True)
class PositionerState:
    """Positioner of a rig as the operator sees it: its limits, and where it is."""

    limits: PositionerLimits
    reading: PositionerReading

    @property
    def words(self) -> str:
        """Title, position, range and named positions in words."""
        limits, role = self.limits, self.limits.descriptor
        names = f", positions {', '.join(limits.named)}" if limits.named else ""
        return f"{role.title}, {self.reading.words}, range {limits.low:g} to {limits.high:g} {role.unit}{names}"


class Positioner(Protocol):
    """One motorised setting of the instrument. A position out of range raises RigError before anything moves."""

    @property
    def limits(self) -> PositionerLimits:
        """Role, range and named positions."""
        ...

    def position(self) -> float:
        """Return the current position in the unit of the role; it means nothing before the positioner is homed."""
        ...

    def move_to(self, position: float, should_stop: ShouldStop | None = None) -> None:
        """Move and wait until it has settled; search its reference before, if need be.

        Raises MotionStopped, with the positioner at rest, when `should_stop` returns True, and RigTimeout when it does
        not arrive in time.
        """
        ...

    def homed(self) -> bool:
        """Return whether it knows where it is."""
        ...

    def stop(self) -> None:
        """Decelerate to a halt. Not an emergency stop."""
        ...


def read_position(name: str, positioner: Positioner) -> PositionerReading:
    """Ask a positioner for its position.

    Parameters
    ----------
    name : str
        Its name.
    positioner : Positioner
        The positioner.

    Returns
    -------
    PositionerReading
        Its position with the unit of its role.

    Raises
    ------
    RigError
        If it does not answer.
    """
    limits = positioner.limits
    position = positioner.position() if positioner.homed() else None
    return PositionerReading(
        name=name,
        role=limits.role,
        position=position,
        unit=limits.descriptor.unit,
        named="" if position is None else limits.name_at(position),
    )
