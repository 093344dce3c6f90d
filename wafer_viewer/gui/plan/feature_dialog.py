"""Dialog for a feature of a job: quantity of a tool, regions, limits."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.plan.dies_dialog import relative_to_die
from wafer_viewer.gui.plan.job_dialogs import edit, required_job
from wafer_viewer.gui.presenters.result_features import KeptFeature, kept_features
from wafer_viewer.gui.presenters.verdict import RULES
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, duo, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.number_field import OptionalNumber
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.measurement.feature import Feature, on_die
from wafer_viewer.model.measurement.tool_options import ToolOptions
from wafer_viewer.model.measurement.tools import TOOLS, ToolName
from wafer_viewer.model.quantity import Unit
from wafer_viewer.model.region import Region

AS_BEFORE, BY_HAND = "as before", "as typed below"
MAIN = "the main one"
STAYS = "The feature was not changed"
HOW = "A step height as typed below, or any result kept on the surface shown, with the limits of a good wafer."


def feature_dialog(page: Page, n: int | None = None) -> None:
    """Open the dialog of a feature. n: index of the job's feature to change; None for a new one."""
    features = required_job(page).features
    FeatureDialog(page, features[n] if n is not None else None, n)


class FeatureDialog:
    """Feature under construction; a chosen kept result sets tool, regions and quantities."""

    def __init__(self, page: Page, old: Feature | None, n: int | None) -> None:
        self._page, self._old, self._n = page, old, n
        self._tool: ToolName = old.tool if old else "step"
        self._unit: Unit = old.unit if old else "um"
        self._places: tuple[Region, ...] = old.places if old else ()
        self._options: ToolOptions | None = old.options if old else None
        self._was_per_die = old.per_die if old else False
        self._dies = required_job(page).dies
        self._kept = kept_features(page.session.snapshot)
        dialog = Dialog(page, "Feature", HOW)
        with dialog.modal:
            self._ask_what()
            self._ask_limits()
            self._ask_where()
        self._tell()
        dialog.answers("Keep", viser.Icon.CHECK, self._keep, STAYS)

    def _ask_what(self) -> None:
        gui, old = self._page.gui, self._old
        self._name = gui.add_text("Name", old.name if old else "")
        self._source = gui.add_dropdown("Measured as", (AS_BEFORE if old else BY_HAND, *self._kept))
        self._quantity = gui.add_dropdown("Quantity", ((old.quantity if old else "") or MAIN,))
        self._what = HtmlBlock(gui)
        self._source.on_update(guarded(self._page, STAYS)(lambda _: self._take()))
        self._quantity.on_update(guarded(self._page, STAYS)(lambda _: self._take_quantity()))

    def _ask_limits(self) -> None:
        gui, old = self._page.gui, self._old
        self._nominal = OptionalNumber(gui, "Nominal, µm", old.nominal if old else None)
        duo(gui)
        self._low = OptionalNumber(gui, "Lower limit", old.lower_limit if old else None)
        self._high = OptionalNumber(gui, "Upper limit", old.upper_limit if old else None)
        rule = RULES[old.decision_rule if old else "guard_band"]
        self._rule = gui.add_dropdown("Rule", tuple(RULES.values()), initial_value=rule)

    def _ask_where(self) -> None:
        """Add the region inputs, last, so that the dropdowns above open over them and not over the buttons."""
        gui = self._page.gui
        self._upper = _corners(gui, "Upper", self._places[:1])
        self._lower = _corners(gui, "Lower", self._places[1:2])
        self._every = gui.add_checkbox("On every die", self._was_per_die, disabled=self._dies is None)

    def _take(self) -> None:
        """Take tool, regions, options and quantities from the chosen kept result."""
        if (chosen := self._chosen()) is None:
            return
        self._tool, self._places, self._options = chosen.tool, chosen.places, chosen.options
        self._quantity.options = (MAIN, *chosen.quantities)
        if self._tool == "step":
            for handles, place in zip((self._upper, self._lower), self._places, strict=True):
                _put(handles, place)
        self._take_quantity()

    def _take_quantity(self) -> None:
        """Take the unit of the chosen quantity, and its value as the nominal value."""
        if (chosen := self._chosen()) is not None:
            self._unit = chosen.unit(self._quantity_name)
            self._nominal.value = round(chosen.value(self._quantity_name), 2)
        self._tell()

    def _tell(self) -> None:
        """Show tool and unit; region inputs are visible for steps only."""
        for handle in (*self._upper, *self._lower):
            set_prop(handle, "visible", self._tool == "step")
        words = f"{TOOLS[self._tool].title}; its limits are in {self._unit}."
        self._what.show(f'<div class="wv-lab">{html.safe(html.with_micro_sign(words))}</div>')

    def _chosen(self) -> KeptFeature | None:
        return self._kept.get(self._source.value)

    @property
    def _quantity_name(self) -> str:
        return "" if self._quantity.value == MAIN else self._quantity.value

    def _keep(self) -> None:
        page, features = self._page, required_job(self._page).features
        made = self._made(f"{TOOLS[self._tool].title} {len(features) + 1}")
        kept = (*features, made) if self._n is None else (*features[: self._n], made, *features[self._n + 1 :])
        edit(page, features=kept)

    def _made(self, unnamed: str) -> Feature:
        """Return the feature of the form. Raises PlanError if it is invalid."""
        places = self._asked_places()
        return Feature(
            name=self._name.value.strip() or unnamed,
            tool=self._tool,
            quantity=self._quantity_name,
            unit=self._unit,
            nominal=self._nominal.value,
            lower_limit=self._low.value,
            upper_limit=self._high.value,
            decision_rule=next(key for key, title in RULES.items() if title == self._rule.value),
            per_die=self._every.value,
            places=places,
            options=self._options,
        )

    def _asked_places(self) -> tuple[Region, ...]:
        """Return the regions on the wafer or relative to a die's corner; convert them only if that choice changed."""
        places = tuple(_region(h) for h in (self._upper, self._lower)) if self._tool == "step" else self._places
        if not places:
            raise PlanError("The feature has no place: choose a result that was kept.")
        counted = self._was_per_die and self._chosen() is None
        if self._dies is None or self._every.value == counted:
            return places
        if counted:
            return tuple(on_die(place, self._dies.all()[0]) for place in places)
        return relative_to_die(places, self._dies)


def _corners(gui: Any, name: str, places: tuple[Region, ...]) -> tuple[Any, Any]:
    """Add inputs for two opposite corners of a rectangle."""
    x0, y0, x1, y1 = places[0].bounds_um if places else (0.0, 0.0, 0.0, 0.0)
    return gui.add_vector2(f"{name}, µm", (x0, y0), step=0.5), gui.add_vector2("– to, µm", (x1, y1), step=0.5)


def _put(handles: tuple[Any, Any], region: Region) -> None:
    x0, y0, x1, y1 = region.bounds_um
    handles[0].value, handles[1].value = (round(x0, 1), round(y0, 1)), (round(x1, 1), round(y1, 1))


def _region(handles: tuple[Any, Any]) -> Region:
    return Region.rectangle(*handles[0].value, *handles[1].value)
