"""Solved positions, heights and tilts of fields, and the overlap measurements they come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]


class ObservationSource(IntEnum):
    """Source of an overlap measurement: image, heights or stage."""

    PICTURE = 0
    HEIGHT = 1
    STAGE = 2


class RejectionReason(IntEnum):
    """Reason for the rejection of an overlap; codes are never reused."""

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
"""Words after a count of overlaps: 24 ambiguous (repeating pattern), 2 blank."""


N_CANDIDATE = 6
"""Length of a row of `Shifts.candidates`."""
N_DRIFT = 5
"""Length of a row of `Shifts.drift`."""
N_BEND = 13
"""Length of a row of `Shifts.bend`."""


@dataclass(frozen=True, slots=True, eq=False)
class Shifts:
    """Lateral overlap measurements, all [n]; fields by their list index, lengths in um.

    x_um, y_um: offset of the second from the first to the right and up, relative to the stage; u_x_um, u_y_um: standard
    uncertainty, infinite without information; correlation: of the two pictures (or heights) at the best fit, -1 ... 1;
    by: `ObservationSource`; doubt: `RejectionReason`, from the overlap alone until the poses are solved; weight: 0 ...
    1, in the solution; residual_x_um, residual_y_um: measured minus solved; covariance_um2: of the errors along x and
    y; candidates: float32 [n, k, 6], where a repeating pattern fits at several offsets, for each of them x_um, y_um,
    its precision (xx, xy, yy in 1/um^2) and its misfit above the best one, in nats; NaN in unused rows; drift: [n, 5],
    squares of u_x_um and u_y_um without drift, variances along x and y of the shifts of parts of the overlap against
    each other, less that of noise (um^2), and the degrees of freedom of these; NaN where they are unknown.
    bend: [n, 13], change of the offset, down and right, from the middle of an overlap to its ends along rows, the same
    along columns, and its curvature along the longer side (coefficient of the Legendre polynomial of second degree);
    then the standard uncertainties of these six, all in pixels, and the `RejectionReason` besides the bend; NaN where
    they are unknown.
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
    covariance_um2: Numbers
    candidates: NDArray[np.float32]
    drift: Numbers
    bend: Numbers

    @property
    def repeats(self) -> NDArray[np.bool_]:
        """Mask of the overlaps in which a pattern fits at several offsets."""
        return np.asarray(np.isfinite(self.candidates[:, :, 0]).any(axis=1), np.bool_)

    @property
    def believed(self) -> NDArray[np.bool_]:
        """Mask of the accepted overlaps."""
        return self.doubt == RejectionReason.NONE


@dataclass(frozen=True, slots=True, eq=False)
class HeightOffsets:
    """Height offsets in the overlaps at known x and y, all [n] except `information`.

    In the overlap, the height of the second minus that of the first is z_um + slope_x (x - mid_x_um) + slope_y (y -
    mid_y_um), with the inverse covariance `information`, float64 [n, 3, 3], of (z_um, slope_x, slope_y); zero without
    common heights. n_pixels: number compared; weight: 0 ... 1, in the solution; step_um: median difference after the
    poses are applied, rms_um: root mean square of the residuals, NaN without common heights.
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
    """Form terms that overlaps cannot separate from errors of the stage, and that are constrained to the stage.

    names: terms over the whole surface, lowest first (height, tilt along x and y, bow, twist, saddle); u_um: expanded
    uncertainty (k = 2) of each at the rim of the surface, from the errors of the stage; camera_turn, camera_scale:
    rotation of the camera axes (rad, anticlockwise) and relative excess of its pixel size against the stage;
    camera_stretch, camera_skew: what is more along x and less along y (relative), and the turn of each axis of the
    stage towards the other (rad); all with standard uncertainties; middle_um: (x, y) where camera and stage coordinates
    agree; field_form_um: sag common to all fields (x^2, x y, y^2, in um at the corner of a field); field_size_um:
    (width, height) of that field.
    """

    names: tuple[str, ...] = ()
    u_um: tuple[float, ...] = ()
    camera_turn: float = 0.0
    u_camera_turn: float = float("inf")
    camera_scale: float = 0.0
    u_camera_scale: float = float("inf")
    camera_stretch: float = 0.0
    u_camera_stretch: float = float("inf")
    camera_skew: float = 0.0
    u_camera_skew: float = float("inf")
    middle_um: tuple[float, float] = (0.0, 0.0)
    field_form_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    field_size_um: tuple[float, float] = (1.0, 1.0)

    def sag_um(self, dx_um: Numbers, dy_um: Numbers) -> Numbers:
        """Return the excess height of a field at (dx_um, dy_um) from its centre, besides its offset and tilt."""
        x, y = 2 * dx_um / self.field_size_um[0], 2 * dy_um / self.field_size_um[1]
        xx, xy, yy = self.field_form_um
        return xx * x**2 + xy * x * y + yy * y**2


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Poses of fields in list order, all [n_fields]; lengths in um, at field centres.

    numbers: numbers of the fields; marks: of the placed surfaces, to detect one that was reconstructed again.
    stage_x_um, stage_y_um: positions by the stage; x_um, y_um: solved positions. Heights of a field are too high by
    z_um + tilt_x (x - x_um) + tilt_y (y - y_um) + form.sag_um(x - x_um, y - y_um). u_x_um, u_y_um, u_z_um: standard
    uncertainties of the pose (of z at the centre of the field). group: equal for fields connected by accepted overlaps;
    left_out: fields that fit none of their neighbours and are not in the mosaic. stage_error_um, z_error_um: estimated
    standard deviation of the stage errors in the plane and along z. final: True if all fields were solved together,
    False if some were placed relative to fixed ones. period_odds_nats: log odds of the chosen period of a field against
    any other, infinite where no pattern repeats; empty where none does anywhere.
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
    period_odds_nats: Numbers = field(default_factory=lambda: np.zeros(0))

    @property
    def period_probability(self) -> Numbers:
        """Probability of the chosen period of each field, [n_fields]; NaN where no pattern repeats."""
        if not self.period_odds_nats.size:
            return np.full(self.numbers.size, np.nan)
        sure = 1 / (1 + np.exp(-np.clip(self.period_odds_nats, 0, 500)))
        return np.where(np.isfinite(self.period_odds_nats), sure, np.nan)

    @property
    def overlap_period_probability(self) -> Numbers:
        """The same of each overlap with a pattern that repeats: of the less sure of its two fields; NaN for others."""
        of_fields, shifts = self.period_probability, self.shifts
        both = np.fmin(of_fields[shifts.first], of_fields[shifts.second])
        return np.where(shifts.repeats, both, np.nan)

    def excess_um(self, n: int, dx_um: Numbers, dy_um: Numbers) -> Numbers:
        """Return how much too high field n is at (dx_um, dy_um) from its centre."""
        offset_um, tilt_x, tilt_y = self.z_um[n], self.tilt_x[n], self.tilt_y[n]
        return offset_um + tilt_x * dx_um + tilt_y * dy_um + self.form.sag_um(dx_um, dy_um)


@runtime_checkable
class HasPoses(Protocol):
    """A surface stitched from fields with known poses."""

    @property
    def poses(self) -> Poses | None:
        """Poses of its fields; None if unknown."""
        ...


T = TypeVar("T", Shifts, HeightOffsets)


def selected(table: T, rows: NDArray[Any]) -> T:
    """Return rows of a table, selected by number or by a mask."""
    return replace(table, **{item.name: getattr(table, item.name)[rows] for item in fields(table)})


def joined(tables: Sequence[T]) -> T:
    """Concatenate tables, at least one."""
    columns = {item.name: _stacked([getattr(t, item.name) for t in tables]) for item in fields(tables[0])}
    return replace(tables[0], **columns)


def _stacked(columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Concatenate columns; candidates of overlaps with fewer of them are padded."""
    if columns[0].ndim < 3 or len({column.shape[1:] for column in columns}) == 1:
        return np.concatenate(columns)
    return padded_candidates([rows for column in columns for rows in column])


def padded_candidates(each: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return lists of candidates, [k, 6] each, in one array [n, most, 6], with NaN in unused rows."""
    most = max((len(rows) for rows in each), default=0)
    table = np.full((len(each), most, N_CANDIDATE), np.nan, np.float32)
    for padded, rows in zip(table, each, strict=True):
        padded[: len(rows)] = rows
    return table


def no_shifts() -> Shifts:
    """Return an empty table."""
    integers, floats = np.zeros(0, np.int32), np.zeros(0)
    code, share = np.zeros(0, np.uint8), np.zeros(0, np.float32)
    measured = (floats, floats, floats, floats, share, code, code, share, floats, floats, floats)
    return Shifts(integers, integers, *measured, no_candidates(0), unknown_drift(0), unknown_bend(0))


def no_candidates(n: int) -> NDArray[np.float32]:
    """Return `Shifts.candidates` of n overlaps that fit at one offset only."""
    return np.zeros((n, 0, N_CANDIDATE), np.float32)


def unknown_drift(n: int) -> Numbers:
    """Return `Shifts.drift` of n overlaps whose drift is unknown."""
    return np.full((n, N_DRIFT), np.nan)


def unknown_bend(n: int) -> Numbers:
    """Return `Shifts.bend` of n overlaps whose bend is unknown."""
    return np.full((n, N_BEND), np.nan)


def no_seams() -> HeightOffsets:
    """Return an empty table."""
    integers, floats = np.zeros(0, np.int32), np.zeros(0)
    share = np.zeros(0, np.float32)
    return HeightOffsets(
        integers, integers, floats, floats, floats, floats, floats, np.zeros((0, 3, 3)), integers, share, floats, floats
    )
