"""What can be set of the tool in use, in the panel of measuring: a table of controls a tool, its options' fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from wafer_viewer.gui.kit import Field, set_prop
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.view import Tool, View
from wafer_viewer.model.measuring import ToolName
from wafer_viewer.model.spec import replace

FAILED = "The setting stays"


@dataclass(frozen=True, slots=True)
class Pick:
    """One of several: `values` by the names that the page gives them."""

    label: str
    field: str
    values: Mapping[str, Any]
    hint: str = ""

    def build(self, gui: Any) -> Any:
        """Its widget."""
        return gui.add_dropdown(self.label, tuple(self.values), hint=self.hint or None)

    def of(self, put_in: Any) -> Any:
        """The option's value of what stands in the widget."""
        return self.values[put_in]

    def shown(self, value: Any) -> Any:
        """What stands in the widget for a value."""
        return next((name for name, v in self.values.items() if v == value), next(iter(self.values)))


@dataclass(frozen=True, slots=True)
class Number:
    """A number, the unit in its label; zero is None where `off` says what that means, ``0: no filter``."""

    label: str
    field: str
    step: float
    off: str = ""
    least: float = 0.0
    most: float | None = None

    def build(self, gui: Any) -> Any:
        """Its widget."""
        whole = float(self.step).is_integer()
        start = int(self.least) if whole else self.least
        step = int(self.step) if whole else self.step
        return gui.add_number(self.label, start, min=self.least, max=self.most, step=step, hint=self.off or None)

    def of(self, put_in: Any) -> Any:
        """The option's value of what stands in the widget."""
        return None if self.off and not put_in else put_in

    def shown(self, value: Any) -> Any:
        """What stands in the widget for a value."""
        return 0.0 if value is None else value


Control = Pick | Number
FORMS = {"Mean": 0, "Plane": 1, "Order 2": 2, "Order 3": 3, "Order 4": 4, "Order 6": 6, "Order 8": 8}
CONDITIONS = (
    Number("Repeats s, µm", "conditions.repeatability_um", 0.01, off="0: not known"),
    Number("Drift u, µm", "conditions.drift_um", 0.01, off="0: not known"),
    Number("Sample, °C", "conditions.temperature_c", 0.1, off="0: not known"),
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
            "Faces that are tilted against each other are differently far apart at every place",
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
            "What volume lies over and under",
        ),
    ),
    "texture": (
        Pick("Form removed", "form_order", FORMS, "Polynomial of least squares"),
        Number("S-filter, µm", "s_filter_um", 0.1, off="Takes off waves that are shorter; 0: no filter"),
        Number("L-filter, µm", "l_filter_um", 0.5, off="Takes off waves that are longer; 0: no filter"),
    ),
    "roughness": (
        Number("λc, µm", "lambda_c_um", 0.5, off="Takes off longer waves; the sampling length; 0: no filter"),
        Number("λs, µm", "lambda_s_um", 0.1, off="Takes off waves that are shorter; 0: no filter"),
    ),
    "kerf": (Pick("Kerf", "kerf", BRIGHTNESS, "Beside what is next to it, on the picture"),),
    "die": (Pick("Rim of the die", "die", BRIGHTNESS, "Beside what is round it, on the picture"),),
    "circle": (Pick("Inside", "inside", BRIGHTNESS, "Beside what is outside, on the picture"),),
    "chipping": (
        Number("Chip over, µm", "limit_um", 0.5, off="0: four deviations of the edge"),
        Pick("Die on the", "die", {"Higher side": "auto", "Bright side": "bright", "Dark side": "dark"}),
    ),
    "site_range": (
        Number("Site width, µm", "width_um", 10.0, off="0: a quarter of the region"),
        Number("Site height, µm", "height_um", 10.0, off="0: a quarter of the region"),
    ),
    "coplanarity": (Pick("Plane", "reference", {"Least squares": "least_squares", "Seating plane": "seating"}),),
}
"""`field` is the field of the tool's options; with a full stop that of a spec in it."""


class OptionsSection:
    """The controls of the tool in use; those of the others are folded away."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folders: dict[Tool, Any] = {}
        self._fields: dict[tuple[Tool, str], tuple[Control, Field[Any]]] = {}
        for tool, controls in CONTROLS.items():
            self._folders[tool] = folder = page.gui.add_folder(None, visible=False)
            with folder:
                for control in controls:
                    field = Field(control.build(page.gui), self._hear(tool, control), page, FAILED)
                    self._fields[tool, control.field] = control, field

    def show(self, view: View, *, kept: bool) -> None:
        """Bring the section up to date; a result that was kept stays as it was measured, and has no controls."""
        for tool, folder in self._folders.items():
            set_prop(folder, "visible", tool == view.tool and not kept)
        for (tool, name), (control, field) in self._fields.items():
            if tool == view.tool:
                field.show(control.shown(attrgetter(name)(getattr(view.options, tool))))

    def _hear(self, tool: ToolName, control: Control) -> Callable[[Any], None]:
        def hear(event: Any) -> None:
            options = self._page.view.options
            own = _with(getattr(options, tool), control.field, control.of(event.target.value))
            self._page.change(options=replace(options, **{tool: own}))

        return hear


def _with(spec: Any, field: str, value: Any) -> Any:
    """A copy of a spec with one field changed."""
    outer, _, inner = field.partition(".")
    return replace(spec, **{outer: _with(getattr(spec, outer), inner, value) if inner else value})
