"""Button that finds the exposure, and the result under it with the proposed bracket."""

from __future__ import annotations

import viser

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.exposure import result
from wafer_viewer.gui.widgets.controls import HtmlBlock, command_button, in_a_row, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.session.state.snapshot import Snapshot

FAILED = "The exposure was not found"


class ExposureSection:
    """Search for the exposure of the plan; its progress and its cancel button are in the list of running work."""

    def __init__(self, page: Page) -> None:
        self._page = page
        find = guarded(page, FAILED)(lambda _: self._search())
        icon = viser.Icon.BRIGHTNESS_UP
        self._find = command_button(page.gui, "Find the exposure", icon, find, action="Plan saved")
        in_a_row(page.gui, [self._find])
        self._result = HtmlBlock(page.gui)
        page.on_pick("bracket", lambda _: page.ask("The bracket was not taken", page.session.take_bracket()))

    def show(self, snapshot: Snapshot) -> None:
        """Update the button and the result."""
        draft = snapshot.draft
        released = draft.job is not None and draft.job.released
        set_prop(self._find, "disabled", released or draft.plan is None or snapshot.rig.state != "ready")
        self._result.show(result(snapshot))

    def _search(self) -> None:
        self._page.ask(FAILED, self._page.session.find_exposure())
