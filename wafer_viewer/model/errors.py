"""Exceptions of the package, grouped by cause.

Each message is one sentence: the object, the value, the limit and the remedy.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager


class WaferViewerError(Exception):
    """Base of all errors that are shown to the user instead of a traceback."""


class PlanError(WaferViewerError):
    """An invalid plan, sample or setting."""


class RigError(WaferViewerError):
    """A device is missing, refuses a command or cannot carry it out."""


class RigTimeout(RigError):
    """A device did not answer in time."""


class MotionStopped(RigError):
    """A motion was stopped by the user before it reached its goal. Not a fault."""

    @classmethod
    def at(cls, x_um: float, y_um: float, z_um: float) -> MotionStopped:
        """Return the error for a stage stopped at a position."""
        x, y, z = (f"{round(um / 1000, 4) + 0.0:+.4f}" for um in (x_um, y_um, z_um))
        return cls(f"The move was stopped at X {x}, Y {y}, Z {z} mm.")


class PulseBoxRestarted(RigError):
    """The pulse box restarted: its run, its counts and its clock are lost."""


class PulseBoxDisarmed(RigError):
    """The pulse box disarmed itself, as without a heartbeat."""


class MissedPulse(RigError):
    """The pulse box did not send a pulse that it should have sent."""


class WireError(RigError):
    """A line received over a wire is damaged or out of order."""


class DatasetError(WaferViewerError):
    """Files are missing, damaged, locked by another process or of the wrong kind."""


class DiskFullError(DatasetError):
    """The disk, or the quota of the user, has no space for what is to be written."""


class ComputeError(WaferViewerError):
    """A reconstruction or stitching is impossible with the given data."""


class MeasureError(WaferViewerError):
    """A measurement is impossible on the given surface."""


class DiesNotFound(MeasureError):
    """No lattice of dies was found on a surface, or too few dies to compare them."""


class ControlHeldError(WaferViewerError):
    """A command that requires the controls came from a client that does not hold them."""


class RoleError(WaferViewerError):
    """An action that only an engineer may do was asked for by somebody in another role."""


@contextmanager
def parser_errors_as(refusal: Callable[[Exception], WaferViewerError]) -> Generator[None]:
    """Run a parser of foreign bytes: whatever it raises becomes the error that `refusal` makes of it.

    Libraries raise errors of any kind for damage that their authors did not expect. Errors of the program itself pass
    unchanged.

    Parameters
    ----------
    refusal : Callable[[Exception], WaferViewerError]
        Makes the error to raise from what the parser raised.

    Yields
    ------
    None
        The parser runs here.

    Raises
    ------
    WaferViewerError
        The parser failed; what it raised is the cause.
    """
    try:
        yield
    except WaferViewerError:
        raise
    except Exception as fault:
        raise refusal(fault) from fault


def detail(fault: Exception) -> str:
    """Return the message of a parser in brackets, on one line and shortened; empty if it has none."""
    text = "".join(filter(str.isprintable, " ".join(str(fault).split()))).rstrip(".")
    return f" ({text[:_LONGEST_DETAIL]})" if text else ""


_LONGEST_DETAIL = 160
