"""Commands of the gauge check and their preconditions."""

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
"""Command of the leading (filled) button."""


class GaugeActions:
    """Commands of a gauge check, for buttons, keys and clicks."""

    def __init__(self, page: Page, finder: FaceFinder) -> None:
        self._page, self._finder = page, finder
        page.on_pick("gauge-tick", self._tick)
        page.on_pick(
            "gauge-drop", lambda k: page.ask("The repeat was not changed", page.session.gauge.drop_repeat(int(k)))
        )
        page.on_pick("gauge-lay", lambda _: finder.place_default_regions())
        page.on_pick("gauge-find", lambda _: finder.again())

    def go_on(self) -> None:
        """Carry out the next point of the procedure, or ask for the certificate if it is missing."""
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
        """Measure the step between the regions and add it as a repeat."""
        view = self._page.view
        upper, lower = view.faces or (None, None)
        taken = self._page.session.gauge.add_repeat(upper, lower, max(0, view.show))
        self._page.ask("The step was not measured", taken, lambda _: self._page.change(check=None))

    def sign(self) -> None:
        """Open the dialog that signs the check."""
        check = self._page.session.snapshot.gauge.check
        if check is not None:
            guarded(self._page, "The check was not signed")(sign_dialog)(self._page, check)

    def certificate(self) -> None:
        """Open the dialog that loads a certificate."""
        guarded(self._page, "The certificate was not loaded")(certificate_dialog)(self._page)

    def correct(self) -> None:
        """Open the dialog that corrects the z scale, if a correction is proposed."""
        offered = self._page.session.snapshot.gauge.correction
        if offered is not None:
            guarded(self._page, "The z scale was not changed")(correct_dialog)(self._page, offered)

    def begin_anew(self) -> None:
        """Start a new check of the same blocks."""
        self._page.ask(
            "The check was not changed", self._page.session.gauge.clear(), lambda _: self._page.change(check=None)
        )

    def leading(self, snapshot: Snapshot) -> Lead:
        """Return the command of the leading button."""
        gauge = snapshot.gauge
        if gauge.signed is not None:
            return "new"
        if gauge.check is not None:
            return "sign"
        return "certificate" if gauge.certificate is None else "measure"

    def why_not(self, snapshot: Snapshot, view: View, verb: Lead) -> str | None:
        """Return the reason why a command is not possible now, to follow "Not yet:"; None if it is."""
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
