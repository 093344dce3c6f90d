"""Input fields for the terms of a gauge check: limit, block temperature, tolerance and interval."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, set_prop
from wafer_viewer.gui.widgets.debounce import Debouncer
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.number_field import OptionalNumber, text_of
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Snapshot

FAILED = "The terms of the check were not changed"


class TermsSection:
    """Numeric fields of the terms; quantities that need an empty one are not evaluated."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._edits = Debouncer(self._put, guarded(page, FAILED))
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            HtmlBlock(page.gui, html.head("Terms"))
            self._fields = {
                "limit_um": self._number("Limit, ± µm", over=0),
                "temperature_c": self._number("Blocks, °C"),
                "tolerance_um": self._number("Tolerance, µm", over=0),
                "interval_days": self._number("Next in, days", over=0, whole=True),
            }

    def show(self, snapshot: Snapshot, earlier: bool) -> None:
        """Bring the numbers up to date; they are hidden for an earlier check."""
        set_prop(self._folder, "visible", not earlier)
        for name, (_, field) in self._fields.items():
            field.show(text_of(getattr(snapshot.gauge.terms, name)))

    def _number(
        self, label: str, over: float | None = None, whole: bool = False
    ) -> tuple[OptionalNumber, BoundInput[str]]:
        number = OptionalNumber(self._page.gui, label, over=over, whole=whole)
        return number, BoundInput(number.handle, lambda _: self._edits.made(), self._page, FAILED)

    def _put(self) -> Future[Any] | None:
        put_in: dict[str, Any] = {name: number.value for name, (number, _) in self._fields.items()}
        terms = self._page.session.snapshot.gauge.terms
        days = put_in["interval_days"]
        put_in["interval_days"] = terms.interval_days if days is None else int(days)
        answer = self._page.session.gauge.set_terms(replace(terms, **put_in))
        self._page.ask(FAILED, answer)
        return answer
