"""What a gauge check is made under, typed in by a person: limit, temperature of the blocks, tolerance, interval."""

from __future__ import annotations

from typing import Any

from wafer_viewer.gui import html
from wafer_viewer.gui.kit import Cell, Field, set_prop
from wafer_viewer.gui.page import Page
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state import Snapshot

FAILED = "The terms of the check stay"


class TermsSection:
    """A number each; zero says that it is not known, and what needs it is not evaluated."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            Cell(page.gui, html.head("Terms", "0: not said"))
            self._fields = {
                "limit_um": self._number("Limit, ± µm", 0.01),
                "temperature_c": self._number("Blocks, °C", 0.1),
                "tolerance_um": self._number("Tolerance, µm", 0.1),
                "interval_days": self._number("Next in, days", 1),
            }

    def show(self, snapshot: Snapshot, earlier: bool) -> None:
        """Bring the numbers up to date; an earlier check stays as it was made."""
        set_prop(self._folder, "visible", not earlier)
        for name, field in self._fields.items():
            field.show(getattr(snapshot.gauge.terms, name) or 0)

    def _number(self, label: str, step: float) -> Field[Any]:
        whole = float(step).is_integer()
        zero, finest = (0, int(step)) if whole else (0.0, step)
        handle = self._page.gui.add_number(label, zero, min=zero, step=finest)
        return Field(handle, lambda _: self._put(), self._page, FAILED)

    def _put(self) -> None:
        put_in = {name: field.value or None for name, field in self._fields.items()}
        terms = self._page.session.snapshot.gauge.terms
        put_in["interval_days"] = put_in["interval_days"] or terms.interval_days
        self._page.ask(FAILED, self._page.session.gauge.set_terms(replace(terms, **put_in)))
