"""Everything that can go wrong, by who can mend it.

Each message is one sentence: the thing, the value, the limit, the mend.
"""

from __future__ import annotations


class WaferViewerError(Exception):
    """Whatever this program tells a person instead of a traceback."""


class PlanError(WaferViewerError):
    """A plan, a sample or a setting that cannot be."""


class RigError(WaferViewerError):
    """A device that is not there, refuses, or cannot do what is asked."""


class RigTimeout(RigError):
    """A device did not answer in time."""


class MotionStopped(RigError):
    """A motion that a person broke off: no fault, but it did not arrive."""

    @classmethod
    def at(cls, x_um: float, y_um: float, z_um: float) -> MotionStopped:
        """It stands there now."""
        x, y, z = (f"{round(um / 1000, 4) + 0.0:+.4f}" for um in (x_um, y_um, z_um))
        return cls(f"The move was stopped at X {x}, Y {y}, Z {z} mm.")


class MissedPulse(RigError):
    """A pulse that the box should have sent was not sent."""


class WireError(RigError):
    """A line that came over a wire damaged or out of order."""


class DatasetError(WaferViewerError):
    """Files that are missing, damaged, held by another process, or not what they are said to be."""


class ComputeError(WaferViewerError):
    """A reconstruction or a stitch that cannot be made from what there is."""


class MeasureError(WaferViewerError):
    """A measurement that the surface does not allow."""


class DiesNotFound(MeasureError):
    """A surface on which no lattice of dies can be found.

    brief: the reason in a few words, as a note on a result that was compared without dies.
    """

    def __init__(self, message: str, brief: str = "No dies found") -> None:
        super().__init__(message)
        self.brief = brief


class ControlHeldError(WaferViewerError):
    """What only the holder of the controls may ask for."""
