"""Features measured on every sample of a product, their limits, and the dies over which they are repeated."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.tools import TOOLS, ToolOptions
from wafer_viewer.model.quantity import Unit
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import NonNegative, Setting, Spec, Within, replace

DecisionRule = Literal["guard_band", "simple_acceptance"]
_RULE = Setting(
    "Rule",
    "Guard band: value ± U must lie within the limits; simple acceptance: the value alone",
    titles={"guard_band": "guard band, ISO 14253-1", "simple_acceptance": "simple acceptance"},
)
MOST_DIES = 100_000


class Feature(Spec, frozen=True, kw_only=True, omit_defaults=True):
    """One quantity measured by a tool, its limits and its decision rule.

    places: the regions of the tool, in wafer um if the job has alignment marks, else in stage um; for a feature
    measured `per_die`, in um from the corner of a die. Without them it is not measured automatically. quantity: a field
    of the result, such as ``flt_q``; empty for the main one. unit: of nominal and limits; a missing limit is open.
    options: of the tool; None for the defaults.
    """

    name: Annotated[str, Setting("Name", "Name of the feature in verdicts; empty: the tool's name with a number")]
    tool: ToolName = "step"
    quantity: str = ""
    unit: Unit = "um"
    nominal: Annotated[
        float | None, Setting("Nominal, µm", "Nominal value, in the unit of the quantity", "not given")
    ] = None
    lower_limit: Annotated[float | None, Setting("Lower limit", "In the unit of the quantity", "no limit")] = None
    upper_limit: Annotated[float | None, Setting("Upper limit", "In the unit of the quantity", "no limit")] = None
    decision_rule: Annotated[DecisionRule, _RULE] = "guard_band"
    per_die: Annotated[bool, Setting("On every die", "At the same place on each die of the plan")] = False
    places: tuple[Region, ...] = ()
    options: ToolOptions | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lower_limit is None and self.upper_limit is None:
            self.refuse("upper_limit", f"a number in {self.unit}, or else lower_limit: by one of them it is judged")
        if self.lower_limit is not None and self.upper_limit is not None and self.upper_limit <= self.lower_limit:
            self.refuse("upper_limit", f"over the lower limit {self.lower_limit:g} {self.unit}")
        if self.tool not in TOOLS:
            self.refuse("tool", f"one of {', '.join(map(repr, TOOLS))}")
        required = TOOLS[self.tool].places
        if self.places and [place.kind for place in self.places] != [place.kind for place in required]:
            self._require_places(len(required))

    @property
    def has_place(self) -> bool:
        """True if its regions are given."""
        return bool(self.places)

    @property
    def tolerance(self) -> float | None:
        """Upper minus lower limit, in the unit; None if either is open."""
        return None if self.lower_limit is None or self.upper_limit is None else self.upper_limit - self.lower_limit

    @property
    def measures(self) -> tuple[Any, ...]:
        """Key of the measured number: features with equal keys have the same number."""
        return self.tool, self.quantity, self.places, self.per_die, self.options or ToolOptions()

    def _require_places(self, n: int) -> None:
        """Refuse regions of the wrong number or kind; rectangle, polygon and circle may replace each other."""
        kinds = [
            (given.kind, required.kind) for given, required in zip(self.places, TOOLS[self.tool].places, strict=False)
        ]
        same = all(
            given == required or {given, required} <= {"rectangle", "polygon", "circle"} for given, required in kinds
        )
        if len(self.places) != n or not same:
            names = ", ".join(f"{place.name} ({place.kind})" for place in TOOLS[self.tool].places)
            given = ", ".join(place.kind for place in self.places)
            raise PlanError(f"Feature '{self.name}': its tool '{self.tool}' is measured at {names}; {given} are given.")


class Die(Spec, frozen=True, kw_only=True):
    """One die: its name and the wafer position of its lower left corner."""

    name: str
    x_um: float
    y_um: float


class Dies(Spec, frozen=True, kw_only=True):
    """Dies of a wafer: `listed` individually, or a lattice of rows and columns with its pitch, in wafer um.

    (x0_um, y0_um): lower left corner of the die in row 0, column 0; rows count upwards. `left_out`: names,
    "column,row", of lattice positions without a die.
    """

    width_um: NonNegative
    height_um: NonNegative
    listed: tuple[Die, ...] = ()
    rows: Annotated[int, Within(0)] = 0
    cols: Annotated[int, Within(0)] = 0
    pitch_x_um: float = 0.0
    pitch_y_um: float = 0.0
    x0_um: float = 0.0
    y0_um: float = 0.0
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.listed) == bool(self.rows * self.cols):
            self.refuse("listed", "given, or else rows and cols of a lattice, not both")
        if self.rows * self.cols > MOST_DIES:
            self.refuse("rows", f"so few that rows times cols is at most {MOST_DIES}")
        if len({die.name for die in self.listed}) < len(self.listed):
            self.refuse("listed", "dies with a name each, no two alike")

    def all(self) -> tuple[Die, ...]:
        """Return every die, row by row from the lowest."""
        if self.listed:
            return self.listed
        lattice = ((row, col) for row in range(self.rows) for col in range(self.cols))
        dies = (self._at(row, col) for row, col in lattice)
        return tuple(die for die in dies if die.name not in self.left_out)

    def _at(self, row: int, col: int) -> Die:
        x_um, y_um = self.x0_um + col * self.pitch_x_um, self.y0_um + row * self.pitch_y_um
        return Die(name=f"{col},{row}", x_um=x_um, y_um=y_um)


def on_die(region: Region, die: Die) -> Region:
    """Convert a region in um from the corner of a die to wafer um."""
    points = tuple(Point(x_um=p.x_um + die.x_um, y_um=p.y_um + die.y_um) for p in region.points)
    return replace(region, points=points, excluded=tuple(on_die(hole, die) for hole in region.excluded))


def limits_text(feature: Feature) -> str:
    """Return the limits of a feature as plain text: ``29 to 31 um``, ``at most 2 um``."""
    low, high = feature.lower_limit, feature.upper_limit
    if low is None:
        return f"at most {high:g} {feature.unit}"
    return f"at least {low:g} {feature.unit}" if high is None else f"{low:g} to {high:g} {feature.unit}"
