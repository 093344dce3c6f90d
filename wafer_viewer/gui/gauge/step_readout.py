"""Read-out of the measured step at the top right of the scene in the gauge check."""

from __future__ import annotations

from collections.abc import Callable

from wafer_viewer.gui.gauge.gauge_list import selected_check
from wafer_viewer.gui.measure.live_measurement import Answer
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.gauge import day_and_time, scene_step_label
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.controls import FloatingPanel
from wafer_viewer.model.measurement.step import StepHeight
from wafer_viewer.session.state.snapshot import Snapshot


class StepReadout:
    """Read-out of the mean of the repeats, of an earlier check, or of the live step before the first repeat."""

    def __init__(self, page: Page, live: Callable[[], Answer]) -> None:
        self._live = live
        self._glass = FloatingPanel(page.gui, -EDGE_PX, EDGE_PX, 330, 88, align="right")

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the figure up to date."""
        self._glass.show(self._content(snapshot, view) if view.step == "gauge" and not view.explains else "")

    def _content(self, snapshot: Snapshot, view: View) -> str:
        earlier = selected_check(snapshot, view)
        check = earlier or snapshot.gauge.signed or snapshot.gauge.check
        if check is not None:
            of = f", {day_and_time(check.at)}" if check.at else f", mean of {check.n}" if check.n > 1 else ""
            return scene_step_label(f"Measured step{of}", check.height)
        step = self._live().finding
        return scene_step_label("Step between the regions, live", step.height) if isinstance(step, StepHeight) else ""
