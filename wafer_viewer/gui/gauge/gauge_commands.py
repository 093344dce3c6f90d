"""What a person does in Gauge check, by button, key or click, and why it is not possible now."""

from __future__ import annotations

from typing import Literal

from wafer_viewer.gui.gauge.face_finder import FaceFinder
from wafer_viewer.gui.gauge.gauge_dialogs import certificate_dialog, correct_dialog, sign_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.gauge_procedure import BY_HAND, next_point
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.session.state.snapshot import Snapshot

Lead = Literal["certificate", "measure", "sign", "new"]
"""What leads on: the one filled button."""


class GaugeActions:
    """The verbs of a check; one for the page."""

    def __init__(self, page: Page, finder: FaceFinder) -> None:
        self._page, self._finder = page, finder
        page.on_pick("gauge-tick", self._tick)
        page.on_pick(
            "gauge-drop", lambda k: page.ask("The repeat was not changed", page.session.gauge.drop_repeat(int(k)))
        )
        page.on_pick("gauge-lay", lambda _: finder.lay_by_hand())
        page.on_pick("gauge-find", lambda _: finder.again())

    def go_on(self) -> None:
        """The next point of the procedure; with the certificate where the check waits for it."""
        snapshot = self._page.session.snapshot
        point = next_point(snapshot)
        if point is None:
            self.begin_anew()
        elif point.name in BY_HAND:
            self._tick(point.name)
        elif point.name == "scan":
            self._page.change(step="plan")
        elif snapshot.gauge.certificate is None:
            self.certificate()
        elif point.name == "faces":
            self.measure()
        else:
            self.sign()

    def measure(self) -> None:
        """Measure the step between the regions: one repeat more."""
        view = self._page.view
        upper, lower = view.faces or (None, None)
        taken = self._page.session.gauge.add_repeat(upper, lower, max(0, view.show))
        self._page.ask("The step was not measured", taken, lambda _: self._page.change(check=None))

    def sign(self) -> None:
        """Ask who signs."""
        check = self._page.session.snapshot.gauge.check
        if check is not None:
            guarded(self._page, "The check was not signed")(sign_dialog)(self._page, check)

    def certificate(self) -> None:
        """Ask for a certificate."""
        guarded(self._page, "The certificate was not loaded")(certificate_dialog)(self._page)

    def correct(self) -> None:
        """Ask whether the z scale is to be corrected."""
        offered = self._page.session.snapshot.gauge.correction
        if offered is not None:
            guarded(self._page, "The z scale was not changed")(correct_dialog)(self._page, offered)

    def begin_anew(self) -> None:
        """Begin another check of the same blocks."""
        self._page.ask(
            "The check was not changed", self._page.session.gauge.clear(), lambda _: self._page.change(check=None)
        )

    def leading(self, snapshot: Snapshot) -> Lead:
        """Which verb leads on."""
        gauge = snapshot.gauge
        if gauge.signed is not None:
            return "new"
        if gauge.check is not None:
            return "sign"
        return "certificate" if gauge.certificate is None else "measure"

    def why_not(self, snapshot: Snapshot, view: View, verb: Lead) -> str | None:
        """Why a verb is not possible now, in words that follow "Not yet:"."""
        gauge, data = snapshot.gauge, snapshot.dataset
        if verb == "measure":
            if gauge.busy:
                return "a repeat is being measured."
            if snapshot.surface is None:
                return "there is no surface to measure on."
            return gauge.refusal or (None if view.faces else "the regions do not lie on the faces yet.")
        if verb == "sign" and data is not None and data.read_only is not None:
            return data.read_only
        return None

    def _tick(self, point: str) -> None:
        done = any(tick.point == point for tick in self._page.session.snapshot.gauge.ticks)
        self._page.ask("The point was not changed", self._page.session.gauge.tick(point, not done))
