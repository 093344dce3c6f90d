"""Where fields really lie and how they lean, and what their overlaps said about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]


class ObservationSource(IntEnum):
    """What told where a field lies beside its neighbour."""

    PICTURE = 0
    HEIGHT = 1
    STAGE = 2


class RejectionReason(IntEnum):
    """Why an overlap is not believed; codes are never reused."""

    NONE = 0
    BLANK = 1
    UNLIKE = 2
    AMBIGUOUS = 3
    END_OF_SEARCH = 4
    DISAGREES = 5


DOUBT_TITLES: dict[RejectionReason, str] = {
    RejectionReason.NONE: "believed",
    RejectionReason.BLANK: "nothing to compare",
    RejectionReason.UNLIKE: "the two do not look alike",
    RejectionReason.AMBIGUOUS: "it fits at several places",
    RejectionReason.END_OF_SEARCH: "it fits best at the end of the search",
    RejectionReason.DISAGREES: "the other overlaps say otherwise",
}


DOUBT_WORDS: dict[RejectionReason, str] = {
    RejectionReason.BLANK: "blank",
    RejectionReason.UNLIKE: "unlike",
    RejectionReason.AMBIGUOUS: "ambiguous (repeating pattern)",
    RejectionReason.END_OF_SEARCH: "at the end of the search",
    RejectionReason.DISAGREES: "contradicted by others",
}
"""After a number of overlaps: 24 ambiguous (repeating pattern), 2 blank."""


@dataclass(frozen=True, slots=True, eq=False)
class Shifts:
    """What overlaps say about x and y, all [n]: fields by their place in the list, lengths in um.

    x_um, y_um: how much further right and up the second lies from the first than the stage says; u_x_um, u_y_um:
    standard uncertainty, infinite where the overlap tells nothing; correlation: of the two pictures (or heights) where
    they fit, -1 ... 1; by: `ObservationSource`; doubt: `RejectionReason`, as the overlap alone tells it until the poses
    are solved; weight: 0 ... 1, its share in the solution; residual_x_um, residual_y_um: measured minus solved.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    x_um: Numbers
    y_um: Numbers
    u_x_um: Numbers
    u_y_um: Numbers
    correlation: NDArray[np.float32]
    by: NDArray[np.uint8]
    doubt: NDArray[np.uint8]
    weight: NDArray[np.float32]
    residual_x_um: Numbers
    residual_y_um: Numbers

    @property
    def believed(self) -> NDArray[np.bool_]:
        """Which of them count."""
        return self.doubt == RejectionReason.NONE


@dataclass(frozen=True, slots=True, eq=False)
class HeightOffsets:
    """What overlaps say about z once x and y are known, all [n] but `information`.

    In the overlap, heights of the second minus heights of the first are z_um + slope_x (x - mid_x_um) + slope_y (y -
    mid_y_um), with the inverse covariance `information`, float64 [n, 3, 3], of (z_um, slope_x, slope_y); zero where
    nothing is to be compared. n_pixels: compared; weight: 0 ... 1, how much the solution believed; step_um: median
    difference that is left after the poses, rms_um: root mean square of what is left, NaN where nothing is compared.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    mid_x_um: Numbers
    mid_y_um: Numbers
    z_um: Numbers
    slope_x: Numbers
    slope_y: Numbers
    information: Numbers
    n_pixels: NDArray[np.int32]
    weight: NDArray[np.float32]
    step_um: Numbers
    rms_um: Numbers


@dataclass(frozen=True, slots=True)
class Form:
    """The part of the form that overlaps cannot tell from errors of the stage, and that is held to the stage.

    names: the terms over the whole surface, lowest first (height, tilt along x and y, bow, twist, saddle); u_um:
    expanded uncertainty (k = 2) of each at the rim of the surface, from the stage's own errors; camera_turn,
    camera_scale: by how much the camera's axes are turned (rad, anticlockwise) and its pixels are too large (fraction)
    against the stage, with standard uncertainties; middle_um: (x, y) where camera and stage coordinates agree;
    field_form_um: sag that all fields share (x^2, x y, y^2, in um at the field's corner); field_size_um: (width,
    height) of the field that this corner is of.
    """

    names: tuple[str, ...] = ()
    u_um: tuple[float, ...] = ()
    camera_turn: float = 0.0
    u_camera_turn: float = float("inf")
    camera_scale: float = 0.0
    u_camera_scale: float = float("inf")
    middle_um: tuple[float, float] = (0.0, 0.0)
    field_form_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    field_size_um: tuple[float, float] = (1.0, 1.0)

    def sag_um(self, dx_um: Numbers, dy_um: Numbers) -> Numbers:
        """By how much every field is too high at (dx_um, dy_um) from its centre, beside its own offset and tilt."""
        x, y = 2 * dx_um / self.field_size_um[0], 2 * dy_um / self.field_size_um[1]
        xx, xy, yy = self.field_form_um
        return xx * x**2 + xy * x * y + yy * y**2


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Fields in the order of their list, all [n_fields]; lengths in um, field centres.

    numbers: running numbers of the fields; marks: of the surfaces that were placed, to tell one that was made again.
    stage_x_um, stage_y_um: where the stage says they are; x_um, y_um: where they are. Heights of a field are too high
    by z_um + tilt_x (x - x_um) + tilt_y (y - y_um) + form.sag_um(x - x_um, y - y_um). u_x_um, u_y_um, u_z_um: standard
    uncertainties of the pose (of z at the field's centre). group: fields joined by believed overlaps have one number;
    left_out: fields that fit none of their neighbours and are not in the mosaic. stage_error_um, z_error_um: standard
    deviation of the stage's errors in the plane and along z, as found. final: all fields were solved for together, not
    some of them placed beside others as these lay.
    """

    numbers: NDArray[np.int32]
    marks: NDArray[np.int64]
    stage_x_um: Numbers
    stage_y_um: Numbers
    x_um: Numbers
    y_um: Numbers
    z_um: Numbers
    tilt_x: Numbers
    tilt_y: Numbers
    u_x_um: Numbers
    u_y_um: Numbers
    u_z_um: Numbers
    group: NDArray[np.int32]
    left_out: NDArray[np.bool_]
    shifts: Shifts
    seams: HeightOffsets
    form: Form = Form()
    stage_error_um: float = 0.0
    z_error_um: float = 0.0
    final: bool = True
    notes: tuple[str, ...] = ()


@runtime_checkable
class HasPoses(Protocol):
    """A surface stitched from fields, which can tell where they lie."""

    @property
    def poses(self) -> Poses | None:
        """Where its fields lie; None where nobody knows."""
        ...


T = TypeVar("T", Shifts, HeightOffsets)


def selected(table: T, rows: NDArray[Any]) -> T:
    """Some rows of a table, by number or by a mask."""
    return replace(table, **{item.name: getattr(table, item.name)[rows] for item in fields(table)})


def joined(tables: Sequence[T]) -> T:
    """Tables below one another, at least one."""
    columns = {item.name: np.concatenate([getattr(t, item.name) for t in tables]) for item in fields(tables[0])}
    return replace(tables[0], **columns)


def no_shifts() -> Shifts:
    """A table without rows."""
    whole, real = np.zeros(0, np.int32), np.zeros(0)
    code, share = np.zeros(0, np.uint8), np.zeros(0, np.float32)
    return Shifts(whole, whole, real, real, real, real, share, code, code, share, real, real)


def no_seams() -> HeightOffsets:
    """A table without rows."""
    whole, real = np.zeros(0, np.int32), np.zeros(0)
    share = np.zeros(0, np.float32)
    return HeightOffsets(whole, whole, real, real, real, real, real, np.zeros((0, 3, 3)), whole, share, real, real)
