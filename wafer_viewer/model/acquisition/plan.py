"""Scan plans: fields, focus sweep, pulses, legs of motion and priced strategies.

Stage coordinates are in um, right-handed, z towards the objective. A field's (x_um, y_um) is the centre of its frame.
Specs of which a plan has very many hold no references that the collector of cycles would have to follow.
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import msgspec

from wafer_viewer.model.errors import PlanError, RigError, WaferViewerError
from wafer_viewer.model.spec import Count, NonNegative, Positive, Setting, Spec, Within

# ------------------------------------------------------------------------------------------------------ focus following


FOLLOW_FOCUS = "follow_focus"
"""Name of the strategy."""
FOLLOW_TITLE = "Follow the focus"


class FollowFocus(Spec, frozen=True, kw_only=True):
    """Section ``follow_focus`` of a plan: the sweep is the range in which the focus is searched.

    The window of a field reaches from below_um under the lowest to above_um over the highest height that is expected
    in focus, both by the coverage factor times the standard uncertainty of the prediction.
    """

    below_um: NonNegative = 5.0
    above_um: NonNegative = 5.0
    coverage_factor: Annotated[float, Within(1, 4)] = 2.0


class FocusCell(msgspec.Struct, frozen=True, array_like=True):
    """Lowest and highest z in focus of a part of a field, with the centre of the part."""

    x_um: float
    y_um: float
    low_um: float
    high_um: float


class FocusPlace(Spec, frozen=True, kw_only=True):
    """A field of the coarse look, by its parts in focus; without any, no focus was found.

    u_um: standard uncertainty of its heights in focus.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    field: int
    x_um: float
    y_um: float
    cells: tuple[FocusCell, ...] = ()
    u_um: NonNegative = 0.0

    @property
    def found(self) -> bool:
        """True if a focus was found."""
        return bool(self.cells)

    @property
    def low_um(self) -> float:
        """Lowest z in focus."""
        return min(cell.low_um for cell in self.cells)

    @property
    def high_um(self) -> float:
        """Highest z in focus."""
        return max(cell.high_um for cell in self.cells)


class FieldFocus(msgspec.Struct, frozen=True):
    """Range in focus of a field, found or predicted, with the larger standard uncertainty of its ends."""

    field: int
    low_um: float
    high_um: float
    u_um: float

    @property
    def middle_um(self) -> float:
        """Middle of the range."""
        return (self.low_um + self.high_um) / 2


class CoarseLook(Spec, frozen=True, kw_only=True):
    """Findings of a coarse look: its places, and the duration of its motion."""

    error: ClassVar[type[WaferViewerError]] = RigError
    places: tuple[FocusPlace, ...]
    duration_s: NonNegative

    @property
    def found(self) -> tuple[FocusPlace, ...]:
        """Places with a focus."""
        return tuple(place for place in self.places if place.found)


# ----------------------------------------------------------------------------------------------------------------- plan


Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
Overlap = Annotated[float, Within(0, 0.5)]
MOST_FIELDS = 1_000_000
"""Most fields of a grid: plans and datasets are benchmarked up to there (tests/bench/bench_index.py)."""
MIN_FRAMES = 3
"""Fewest frames that can hold a peak with a neighbour on either side."""


FrameCount = Annotated[int, Within(MIN_FRAMES, 65535)]


class Field(Spec, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """One camera position: number from 1, row and column in the grid, centre, and lowest z of its sweep.

    n_frames: length of its own z window; None for the whole sweep.
    """

    number: Count
    row: Annotated[int, Within(0)]
    col: Annotated[int, Within(0)]
    x_um: float
    y_um: float
    z_start_um: float
    n_frames: FrameCount | None = None

    @property
    def name(self) -> str:
        """Name of its files, ``r0000c0000``."""
        return f"r{self.row:04d}c{self.col:04d}"


class FieldGrid(Spec, frozen=True, kw_only=True):
    """A rectangular grid of fields; (x0_um, y0_um) is the centre of the top left field (row 0, col 0)."""

    rows: Count
    cols: Count
    field_width_um: Positive
    field_height_um: Positive
    overlap_x_fraction: Overlap = 0.1
    overlap_y_fraction: Overlap = 0.1
    x0_um: float = 0.0
    y0_um: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rows * self.cols > MOST_FIELDS:
            raise PlanError(
                f"FieldGrid has {self.rows} rows and {self.cols} cols: a plan has at most {MOST_FIELDS} fields, "
                "so take larger fields or several plans."
            )

    @classmethod
    def covering(
        cls,
        width_um: float,
        height_um: float,
        *,
        field_width_um: float,
        field_height_um: float,
        overlap_x_fraction: float = 0.1,
        overlap_y_fraction: float = 0.1,
        center_x_um: float = 0.0,
        center_y_um: float = 0.0,
    ) -> FieldGrid:
        """Return the smallest grid whose fields cover width x height um around a centre."""
        one = cls(
            rows=1,
            cols=1,
            field_width_um=field_width_um,
            field_height_um=field_height_um,
            overlap_x_fraction=overlap_x_fraction,
            overlap_y_fraction=overlap_y_fraction,
        )
        cols = 1 + max(0, math.ceil((width_um - field_width_um) / one.pitch_x_um - 1e-9))
        rows = 1 + max(0, math.ceil((height_um - field_height_um) / one.pitch_y_um - 1e-9))
        return one.resized(rows=rows, cols=cols).centred_on(center_x_um, center_y_um)

    @property
    def pitch_x_um(self) -> float:
        """Distance between the centres of neighbours in a row."""
        return self.field_width_um * (1 - self.overlap_x_fraction)

    @property
    def pitch_y_um(self) -> float:
        """Distance between the centres of neighbours in a column."""
        return self.field_height_um * (1 - self.overlap_y_fraction)

    @property
    def width_um(self) -> float:
        """Distance from the left edge of the first to the right edge of the last field."""
        return self.field_width_um + (self.cols - 1) * self.pitch_x_um

    @property
    def height_um(self) -> float:
        """Distance from the top edge of the first to the bottom edge of the last field."""
        return self.field_height_um + (self.rows - 1) * self.pitch_y_um

    @property
    def center_um(self) -> tuple[float, float]:
        """Centre of the covered rectangle."""
        return (
            self.x0_um + (self.cols - 1) * self.pitch_x_um / 2,
            self.y0_um - (self.rows - 1) * self.pitch_y_um / 2,
        )

    def resized(self, *, rows: int, cols: int) -> FieldGrid:
        """Return the grid with another number of rows and columns and the same first field."""
        return msgspec.structs.replace(self, rows=rows, cols=cols)

    def centred_on(self, x_um: float, y_um: float) -> FieldGrid:
        """Return the grid moved so that its centre is (x_um, y_um)."""
        x, y = self.center_um
        return msgspec.structs.replace(self, x0_um=self.x0_um + x_um - x, y0_um=self.y0_um + y_um - y)

    def fields(self, z_start_um: float = 0.0) -> tuple[Field, ...]:
        """Return all fields, numbered from 1 row by row from the top left, each sweep starting at z_start_um."""
        return tuple(
            Field(
                number=row * self.cols + col + 1,
                row=row,
                col=col,
                x_um=self.x0_um + col * self.pitch_x_um,
                y_um=self.y0_um - row * self.pitch_y_um,
                z_start_um=z_start_um,
            )
            for row in range(self.rows)
            for col in range(self.cols)
        )


class FocusSweep(Spec, frozen=True, kw_only=True):
    """The frames of one field: n_frames, z_step_um apart, upward from the field's z_start_um.

    A field may have a window of its own with fewer frames.
    """

    z_step_um: Annotated[
        Positive,
        Setting("Step, µm", "From frame to frame along z, at most half the depth of field", decimals=3, step=0.05),
    ]
    n_frames: FrameCount

    @property
    def range_um(self) -> float:
        """Distance from the first to the last frame."""
        return self.z_step_um * (self.n_frames - 1)

    def z_um(self, field: Field, k: int) -> float:
        """Return the z of frame k of a field."""
        return field.z_start_um + k * self.z_step_um

    def frames_of(self, field: Field) -> int:
        """Return the number of frames of a field at one exposure."""
        return self.n_frames if field.n_frames is None else field.n_frames

    def top_um(self, field: Field) -> float:
        """Return the z of the last frame of a field."""
        return self.z_um(field, self.frames_of(field) - 1)


class Shot(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Slot of one pulse: field number, frame k of its sweep, index of the exposure."""

    field: int
    k: int
    exposure: int = 0


class PulseTrain(Spec, frozen=True, kw_only=True, gc=False):
    """Pulses sent while an axis moves: the first at a scale count, then one every counts_per_frame."""

    axis: Axis
    first_count: int
    counts_per_frame: Count
    n_frames: Count
    direction: Literal[-1, 1]

    @property
    def last_count(self) -> int:
        """Scale count of the last pulse."""
        return self.first_count + self.direction * self.counts_per_frame * (self.n_frames - 1)


class Leg(Spec, frozen=True, kw_only=True):
    """One continuous motion, with the shot of each of its pulses.

    (x_um, y_um, z_um): position of the first pulse. Speed 0 means stop and shoot: the axis halts and settles at every
    count of the train and the box sends a pulse on command.
    """

    train: PulseTrain
    shots: tuple[Shot, ...]
    x_um: float
    y_um: float
    z_um: float
    speed_um_s: NonNegative

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.shots) != self.train.n_frames:
            self.refuse("shots", f"{self.train.n_frames} shots, one for each pulse of the train")


class Price(Spec, frozen=True, kw_only=True):
    """Predicted cost of one strategy, or the reason why it is ruled out.

    look_s: the part of predicted_s that a coarse look before the scan takes; estimated: the sample decides the number
    of frames, and was not looked at yet.
    """

    strategy: str
    title: str
    predicted_s: NonNegative | None = None
    motions: int = 0
    ruled_out: str | None = None
    n_frames: Annotated[int, Within(0)] = 0
    look_s: NonNegative = 0.0
    estimated: bool = False


IMPORT = "import"
"""Strategy of a plan for images or surfaces taken elsewhere."""
UNKNOWN_EXPOSURE_US = 1.0
"""Placeholder exposure time in us for imported images without one.

It is the same for all exposures of a bracket, so that their ratio carries no information: fusion then measures the
brightness ratio and never uses an invented one.
"""


class ScanPlan(Spec, frozen=True, kw_only=True, omit_defaults=True):
    """Complete plan of a scan: fields, sweep, exposures, legs in order, predicted time and all prices.

    depth_of_field_um: of the objective; 0 if unknown; coarse_look: the look that the windows of the fields follow.
    """

    fields: tuple[Field, ...]
    sweep: FocusSweep
    exposures_us: tuple[Positive, ...]
    strategy: str
    legs: tuple[Leg, ...]
    predicted_s: NonNegative
    prices: tuple[Price, ...]
    rows: Count
    cols: Count
    pixel_um: Positive
    depth_of_field_um: NonNegative = 0.0
    coarse_look: CoarseLook | None = None

    def field(self, number: int) -> Field:
        """Return the field with a number."""
        return next(f for f in self.fields if f.number == number)

    @property
    def exposures_are_known(self) -> bool:
        """False if the images were imported and do not state their exposure times."""
        return self.strategy != IMPORT or UNKNOWN_EXPOSURE_US not in self.exposures_us

    @property
    def n_frames(self) -> int:
        """Number of frames of the scan, over all fields and exposures."""
        return sum(map(self.sweep.frames_of, self.fields)) * len(self.exposures_us)

    @property
    def frames_each(self) -> str:
        """Number of frames of a field at one exposure, as a range where fields have windows of their own."""
        numbers = [self.sweep.frames_of(field) for field in self.fields] or [self.sweep.n_frames]
        low, high = min(numbers), max(numbers)
        return f"{low}" if low == high else f"{low} to {high}"

    @property
    def field_by_field(self) -> bool:
        """True if each field gets all its frames in one pass, one field after the other."""
        fields = [{shot.field for shot in leg.shots} for leg in self.legs[: len(self.fields) + 1]]
        return len(fields) == len(self.fields) and all(len(of_leg) == 1 for of_leg in fields)

    @property
    def bytes_on_disk(self) -> int:
        """Size of all 8-bit frames in bytes."""
        return self.n_frames * self.rows * self.cols
