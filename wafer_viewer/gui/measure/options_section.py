"""Options section of the measuring panel: a table of controls for the options of each tool."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import Tool, View
from wafer_viewer.gui.widgets.controls import BoundInput, set_prop
from wafer_viewer.gui.widgets.debounce import Debouncer
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.number_field import OptionalNumber, number_of, text_of
from wafer_viewer.model.measurement.tools import ToolName
from wafer_viewer.model.spec import replace

FAILED = "The setting was not changed"


@dataclass(frozen=True, slots=True)
class Pick:
    """Option with a fixed set of values; `values` maps the displayed names to them."""

    label: str
    field: str
    values: Mapping[str, Any]
    hint: str = ""

    def build(self, gui: Any) -> Any:
        """Create the widget."""
        return gui.add_dropdown(self.label, tuple(self.values), hint=self.hint or None)

    def of(self, put_in: Any) -> Any:
        """Return the option's value of a widget value."""
        return self.values[put_in]

    def shown(self, value: Any) -> Any:
        """Return the widget value of an option's value."""
        return next((name for name, v in self.values.items() if v == value), next(iter(self.values)))


@dataclass(frozen=True, slots=True)
class NumberOption:
    """Numeric option that may be empty, with its unit in the label; `empty` is its hint, ``empty: no filter``."""

    label: str
    field: str
    empty: str
    over: float | None = 0.0

    def build(self, gui: Any) -> Any:
        """Create the widget."""
        return OptionalNumber(gui, self.label, over=self.over, hint=self.empty).handle

    def of(self, put_in: Any) -> Any:
        """Return the option's value of a widget value. Raises WaferViewerError if it is not a number."""
        return number_of(put_in, self.label, over=self.over)

    def shown(self, value: Any) -> Any:
        """Return the widget value of an option's value."""
        return text_of(value)


Control = Pick | NumberOption
FORMS = {"Mean": 0, "Plane": 1, "Order 2": 2, "Order 3": 3, "Order 4": 4, "Order 6": 6, "Order 8": 8}
CONDITIONS = (
    NumberOption("Repeats s, µm", "conditions.repeatability_um", "Spread of repeated measurements; empty: not known"),
    NumberOption("Drift u, µm", "conditions.drift_um", "Standard uncertainty by drift; empty: not known"),
    NumberOption(
        "Sample, °C", "conditions.temperature_c", "Of the sample while it was scanned; empty: not known", None
    ),
)
BRIGHTNESS = {"Either": "either", "Bright": "bright", "Dark": "dark"}
CONTROLS: dict[ToolName, tuple[Control, ...]] = {
    "step": (
        Pick(
            "Height taken",
            "definition",
            {
                "Over a common plane": "common_plane",
                "Over the lower face": "lower_face",
                "Over the upper face": "upper_face",
                "At the joint": "joint",
            },
            "The distance between tilted faces depends on the place",
        ),
        *CONDITIONS,
    ),
    "groove": (
        Pick("It crosses", "shape", {"A groove or ridge": "groove", "A single step": "step"}, "Two edges or one"),
        *CONDITIONS,
    ),
    "volume": (
        Pick(
            "Reference",
            "reference",
            {"As heights are read": None, "Plane of the border": "border", "Zero of heights": "zero"},
            "Reference that the volume lies above and below",
        ),
    ),
    "texture": (
        Pick("Form removed", "form_order", FORMS, "Polynomial of least squares"),
        NumberOption("S-filter, µm", "s_filter_um", "Removes shorter wavelengths; empty: no filter"),
        NumberOption("L-filter, µm", "l_filter_um", "Removes longer wavelengths; empty: no filter"),
    ),
    "roughness": (
        NumberOption("λc, µm", "lambda_c_um", "Removes longer wavelengths; the sampling length; empty: no filter"),
        NumberOption("λs, µm", "lambda_s_um", "Removes shorter wavelengths; empty: no filter"),
    ),
    "kerf": (Pick("Kerf", "kerf", BRIGHTNESS, "Relative to the ground beside it in the picture"),),
    "die": (Pick("Rim of the die", "die", BRIGHTNESS, "Relative to its surroundings in the picture"),),
    "circle": (Pick("Inside", "inside", BRIGHTNESS, "Relative to the outside in the picture"),),
    "chipping": (
        NumberOption("Chip over, µm", "limit_um", "Empty: four standard deviations of the edge"),
        Pick("Die on the", "die", {"Higher side": "auto", "Bright side": "bright", "Dark side": "dark"}),
    ),
    "site_range": (
        NumberOption("Site width, µm", "width_um", "Empty: a quarter of the region"),
        NumberOption("Site height, µm", "height_um", "Empty: a quarter of the region"),
    ),
    "coplanarity": (Pick("Plane", "reference", {"Least squares": "least_squares", "Seating plane": "seating"}),),
}
"""Controls of each tool; `field` names the field of the tool's options, with a dot for a field of a nested spec."""


class OptionsSection:
    """Controls of the active tool; those of the other tools are hidden."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folders: dict[Tool, Any] = {}
        self._fields: dict[tuple[Tool, str], tuple[Control, BoundInput[Any]]] = {}
        for tool, controls in CONTROLS.items():
            self._folders[tool] = folder = page.gui.add_folder(None, visible=False)
            with folder:
                for control in controls:
                    field = BoundInput(control.build(page.gui), self._hear(tool, control), page, FAILED)
                    self._fields[tool, control.field] = control, field

    def show(self, view: View, *, kept: bool) -> None:
        """Bring the section up to date; a saved result has no controls."""
        for tool, folder in self._folders.items():
            set_prop(folder, "visible", tool == view.tool and not kept)
        for (tool, name), (control, field) in self._fields.items():
            if tool == view.tool:
                field.show(control.shown(attrgetter(name)(getattr(view.options, tool))))

    def _hear(self, tool: ToolName, control: Control) -> Callable[[Any], None]:
        def put() -> None:
            options = self._page.view.options
            value = control.of(self._fields[tool, control.field][1].value)
            self._page.change(options=replace(options, **{tool: _with(getattr(options, tool), control.field, value)}))

        if isinstance(control, Pick):
            return lambda _: put()
        edits = Debouncer(put, guarded(self._page, FAILED))
        return lambda _: edits.made()


def _with(spec: Any, field: str, value: Any) -> Any:
    """Return a copy of a spec with one field changed."""
    outer, _, inner = field.partition(".")
    return replace(spec, **{outer: _with(getattr(spec, outer), inner, value) if inner else value})
