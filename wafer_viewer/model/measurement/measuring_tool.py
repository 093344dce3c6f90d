"""Descriptor of a measuring tool: what it needs, how it is shown, and what measures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from wafer_viewer.model.measurement.measurements import MeasurementResult
from wafer_viewer.model.measurement.tool_options import OptionsSpec
from wafer_viewer.model.region import RegionKind

ToolName = str
"""Key of `TOOLS`."""
ToolGroup = Literal["Sections and steps", "Places", "What stands out", "On the picture", "Faces"]
InitialRegions = Literal[
    "informative line",
    "line across a groove",
    "line across a face",
    "point",
    "two points",
    "two levels",
    "two faces",
    "bump",
    "around a bump",
    "bumps",
    "face",
    "kerf",
    "die",
    "round shape",
    "die edge",
    "all in view",
]
"""Feature of the visible part on which the page places the regions of a tool."""


@dataclass(frozen=True, slots=True)
class PlaceAsked:
    """One region that a tool needs: its name on the page, its kind, and its flag on the command line with its help."""

    name: str
    kind: RegionKind
    flag: str
    help: str


def rectangle_place(name: str, help: str = "Two opposite corners of a rectangle.", flag: str = "region") -> PlaceAsked:
    """Return a rectangle that a tool needs."""
    return PlaceAsked(name, "rectangle", flag, help)


def line_place(help: str) -> PlaceAsked:
    """Return the line that a tool needs."""
    return PlaceAsked("line", "line", "line", help)


@dataclass(frozen=True, slots=True)
class ChoiceControl:
    """Option with a fixed set of values; `values` maps the names on the page to them.

    field: of the tool's options, with a dot for a field of a nested spec; help: on the command line.
    """

    label: str
    field: str
    values: Mapping[str, Any]
    hint: str = ""
    help: str = ""


@dataclass(frozen=True, slots=True)
class NumberControl:
    """Number that may be empty, with its unit in the label; `hint` ends with the meaning of an empty one."""

    label: str
    field: str
    hint: str
    over: float | None = 0.0
    help: str = ""


Control = ChoiceControl | NumberControl


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuringTool:
    """A measuring tool.

    name: key in files and commands; title, short: on the page; result_name: of its results, if
    not the short one; summary: line in the list of
    commands; help: first paragraph of its command's help; how: instruction for the operator.
    measure: ``module:function`` or the function, ``f(surface, *regions, calibration_valid=..., **options) -> result``.
    initial: feature on which its regions are placed; symbol: letter of its results; main: label of the main quantity,
    if the title does not tell it; signed: a positive main quantity has a sign.
    icon: Tabler icon; key: on the keyboard, with shift, or alt in its place, or without.
    on_picture: it evaluates the all-in-focus picture and no heights.
    """

    name: ToolName
    title: str
    short: str
    summary: str
    help: str
    how: str
    result: type[MeasurementResult]
    measure: str | Callable[..., MeasurementResult]
    places: tuple[PlaceAsked, ...]
    initial: InitialRegions
    group: ToolGroup
    symbol: str
    icon: str
    result_name: str = ""
    key: str = ""
    shift: bool = True
    alt: bool = False
    main: str = ""
    signed: bool = False
    on_toolbar: bool = False
    on_picture: bool = False
    options: type[OptionsSpec] | None = None
    controls: tuple[Control, ...] = field(default=())

    def __post_init__(self) -> None:
        names = getattr(self.result, "main_fields", ())
        if not names or not set(names) <= set(self.result.__struct_fields__):
            raise TypeError(f"{self.result.__name__} must name the field with its main quantity in main_fields")

    @property
    def modifier(self) -> Literal["shift", "alt"] | None:
        """Key held with its key."""
        return "alt" if self.alt else "shift" if self.shift else None

    @property
    def tag(self) -> str:
        """Name of its result type in files."""
        return str(self.result.__struct_config__.tag)
