"""Lattice of dies on a surface, in stage um, and scan status of each die."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.errors import MeasureError, PlanError, WaferViewerError
from wafer_viewer.model.measurement.feature import MOST_DIES, Die, Dies
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Fraction, NonNegative, Positive, Spec, Within

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
DieState = Literal["whole", "cut", "partly scanned", "not scanned", "missing"]
LEAST_KNOWN = 0.9
"""Measured fraction of a die below which its status says so."""
STRAIGHT_UM = 1.0
"""Deviation of the far corners, in um, below which a lattice is written as aligned with the wafer's axes."""


class DieGrid(Spec, frozen=True, kw_only=True):
    """A lattice of dies: pitches, rotation (anticlockwise), and the columns and rows on the surface.

    (x0_um, y0_um): lower left corner of the die in column 0, row 0, stage um; columns count to the right, rows upwards.
    width_um, height_um: of a die without its street; left_out: names of lattice positions without a die.
    named: True if all positions are known to hold dies; False: it covers all of a surface, and its rim may hold none.
    u_pitch_um, u_origin_um: standard uncertainties of a pitch and of that corner; 0 for a given lattice.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    pitch_x_um: Positive
    pitch_y_um: Positive
    x0_um: float
    y0_um: float
    width_um: Positive
    height_um: Positive
    angle_rad: float = 0.0
    first_col: int = 0
    first_row: int = 0
    cols: Annotated[int, Within(1)] = 1
    rows: Annotated[int, Within(1)] = 1
    left_out: tuple[str, ...] = ()
    named: bool = True
    u_pitch_um: NonNegative = 0.0
    u_origin_um: NonNegative = 0.0
    by: Literal["found", "given"] = "given"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width_um > self.pitch_x_um:
            self.refuse("width_um", f"at most the pitch {self.pitch_x_um:g} um")
        if self.height_um > self.pitch_y_um:
            self.refuse("height_um", f"at most the pitch {self.pitch_y_um:g} um")
        if self.rows * self.cols > MOST_DIES:
            self.refuse("rows", f"so few that rows times cols is at most {MOST_DIES}")

    @classmethod
    def of(cls, dies: Dies, alignment: Alignment = Alignment()) -> Self:
        """Return the lattice of a job in stage coordinates. Raises PlanError for dies listed one by one."""
        if dies.listed:
            raise PlanError("The job lists its dies one by one: give rows, cols and pitch of a lattice instead.")
        x_um, y_um = alignment.to_stage(dies.x0_um, dies.y0_um)
        return cls(
            pitch_x_um=dies.pitch_x_um,
            pitch_y_um=dies.pitch_y_um,
            x0_um=x_um,
            y0_um=y_um,
            width_um=dies.width_um,
            height_um=dies.height_um,
            angle_rad=-alignment.rotation_rad,
            cols=dies.cols,
            rows=dies.rows,
            left_out=dies.left_out,
        )

    def as_dies(self, alignment: Alignment = Alignment()) -> Dies:
        """Return the dies as a job has them, in wafer um, listed one by one if the lattice is rotated on the wafer.

        In a lattice the lowest column and row become 0.
        """
        turn = math.remainder(self.angle_rad + alignment.rotation_rad, 2 * math.pi)
        far_um = math.hypot(self.cols * self.pitch_x_um, self.rows * self.pitch_y_um)
        return self._lattice(alignment) if abs(turn) * far_um < STRAIGHT_UM else self._listed(alignment)

    def _lattice(self, alignment: Alignment) -> Dies:
        x_um, y_um = alignment.to_wafer(*self.corner(self.first_col, self.first_row))
        moved = (tuple(map(int, name.split(","))) for name in self.left_out)
        return Dies(
            width_um=self.width_um,
            height_um=self.height_um,
            rows=self.rows,
            cols=self.cols,
            pitch_x_um=self.pitch_x_um,
            pitch_y_um=self.pitch_y_um,
            x0_um=x_um,
            y0_um=y_um,
            left_out=tuple(self.name(col - self.first_col, row - self.first_row) for col, row in moved),
        )

    def _listed(self, alignment: Alignment) -> Dies:
        places = ((self.name(*place), alignment.to_wafer(*self.corner(*place))) for place in self.places)
        listed = tuple(Die(name=name, x_um=x_um, y_um=y_um) for name, (x_um, y_um) in places)
        return Dies(width_um=self.width_um, height_um=self.height_um, listed=listed)

    @property
    def places(self) -> tuple[tuple[int, int], ...]:
        """(col, row) of every die, row by row from the lowest; without those in `left_out`."""
        rows, cols = (
            range(self.first_row, self.first_row + self.rows),
            range(self.first_col, self.first_col + self.cols),
        )
        return tuple((col, row) for row in rows for col in cols if self.name(col, row) not in self.left_out)

    @property
    def street_x_um(self) -> float:
        """Width of the street between neighbours in a row."""
        return self.pitch_x_um - self.width_um

    @property
    def street_y_um(self) -> float:
        """Width of the street between neighbours in a column."""
        return self.pitch_y_um - self.height_um

    def to_die(self, x_um: Floats, y_um: Floats) -> tuple[Ints, Ints, Floats, Floats]:
        """Return (col, row, u_um, v_um) of stage positions: nearest die and um from its lower left corner.

        Half of each street belongs to the adjacent die: there u and v are negative or exceed the size of the die.
        """
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        dx, dy = np.asarray(x_um, float) - self.x0_um, np.asarray(y_um, float) - self.y0_um
        along, up = c * dx + s * dy, c * dy - s * dx
        cols = np.floor((along + self.street_x_um / 2) / self.pitch_x_um).astype(np.int64)
        rows = np.floor((up + self.street_y_um / 2) / self.pitch_y_um).astype(np.int64)
        return cols, rows, along - cols * self.pitch_x_um, up - rows * self.pitch_y_um

    def to_stage(
        self, col: Ints | int, row: Ints | int, u_um: Floats | float = 0.0, v_um: Floats | float = 0.0
    ) -> tuple[Floats, Floats]:
        """Return the stage positions (x_um, y_um) of points on dies, given in um from the lower left corner of each."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        along = np.asarray(col, float) * self.pitch_x_um + u_um
        up = np.asarray(row, float) * self.pitch_y_um + v_um
        return self.x0_um + c * along - s * up, self.y0_um + s * along + c * up

    def corner(self, col: int, row: int) -> tuple[float, float]:
        """Return the stage position of the lower left corner of a die."""
        x_um, y_um = self.to_stage(col, row)
        return float(x_um), float(y_um)

    def outline(self, col: int, row: int) -> Region:
        """Return the outline of a die without its street."""
        u, v = self.width_um * np.array([0, 1, 1, 0]), self.height_um * np.array([0, 0, 1, 1])
        corners = list(zip(*(a.tolist() for a in self.to_stage(col, row, u, v)), strict=True))
        return Region.rectangle(*corners[0], *corners[2]) if self.angle_rad == 0 else Region.polygon(*corners)

    def name(self, col: int, row: int) -> str:
        """Return the name of a die, "column,row"."""
        return f"{col},{row}"


class ProductDies(Spec, frozen=True, kw_only=True):
    """Pitches and size of the dies of a product, whose place on the surface is not known; size 0: not known."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    pitch_x_um: Positive
    pitch_y_um: Positive
    width_um: NonNegative = 0.0
    height_um: NonNegative = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for size, pitch in (("width_um", self.pitch_x_um), ("height_um", self.pitch_y_um)):
            if getattr(self, size) > pitch:
                self.refuse(size, f"at most the pitch {pitch:g} um")


class DieMeasurement(Spec, frozen=True, kw_only=True):
    """Tilt, offset, bow and brightness of a die, relative to the others and to their trend over the wafer.

    tilt_x, tilt_y: slopes along the lattice, positive where the die rises to the right and upwards. offset: height of
    its corners' plane. bow: height of its middle over its corners. brightness_fraction: brightness in the picture, with
    its standard uncertainty (k = 1).
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    tilt_x: Quantity
    tilt_y: Quantity
    offset: Length
    bow: Length
    brightness_fraction: float = 0.0
    u_brightness_fraction: NonNegative = 0.0

    @property
    def tilt_mrad(self) -> float:
        """Tilt of the die, without its direction."""
        return math.hypot(self.tilt_x.value, self.tilt_y.value)

    def value(self, name: DieNumber) -> float:
        """Return one of its numbers: mrad, um, or for the brightness percent."""
        match name:
            case "tilt":
                return self.tilt_mrad
            case "brightness":
                return 100 * self.brightness_fraction
            case _:
                return getattr(self, name).value_um


DieNumber = Literal["tilt", "offset", "bow", "brightness"]
DIE_UNITS: dict[DieNumber, str] = {"tilt": "mrad", "offset": "um", "bow": "um", "brightness": "%"}
"""Numbers of a die and their units."""


class DieStatus(Spec, frozen=True, kw_only=True):
    """Status of one lattice position: scanned and measured fraction of its die, and number of defects.

    cut: the die extends beyond the edge of the wafer or the surface; partly scanned: fields are missing from it, or
    less than half of it could be measured; missing: scanned, but no die there. defects: None where it was not
    inspected; street_inspected: False if only the area between the streets was compared; measured: None where it was
    not compared.
    """

    name: str
    col: int
    row: int
    state: DieState
    measured_fraction: Fraction
    defects: Annotated[int, Within(0)] | None = None
    street_inspected: bool = True
    measured: DieMeasurement | None = None

    @property
    def word(self) -> str:
        """Status as shown in a list: clean only if the whole die was scanned and inspected."""
        if self.defects:
            return "1 defect" if self.defects == 1 else f"{self.defects} defects"
        if self.state != "whole":
            return self.state
        if self.defects is None:
            return "not inspected"
        return "clean" + self._as_far_as

    @property
    def _as_far_as(self) -> str:
        """Qualification of a clean status: unmeasured fraction and uninspected street."""
        lacks = f"{1 - self.measured_fraction:.0%} of it unmeasured" if self.measured_fraction < LEAST_KNOWN else ""
        street = "" if self.street_inspected else "street not inspected"
        return "".join(f", {word}" for word in (lacks, street) if word)


class DieOffset(Spec, frozen=True, kw_only=True):
    """Found minus given: corner of die 0,0, pitches in ppm, rotation.

    farthest_um: largest offset of any die corner on the surface.
    """

    origin_x_um: float
    origin_y_um: float
    pitch_x_ppm: float
    pitch_y_ppm: float
    turn_mrad: float
    farthest_um: NonNegative
