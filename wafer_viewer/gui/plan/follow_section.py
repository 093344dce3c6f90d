"""Section of a plan that follows the focus: coarse look, allowance for uncertainty, and the windows of the fields."""

from __future__ import annotations

import viser

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import focus as words
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.controls import HtmlBlock, ToggleGroup, command_button, in_a_row, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Snapshot

ALLOW_FOR = ((1.0, "1 u"), (2.0, "2 u"), (3.0, "3 u"))
"""Coverage factors with their titles."""
FAILED = "The focus was not looked for"


class FollowSection:
    """Coarse look and the windows that follow it; the look is in the list of running work while it runs."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._head = HtmlBlock(page.gui)
            self._allow = ToggleGroup(page.gui, "Allow for", ALLOW_FOR, self._allow_for)
            look = guarded(page, FAILED)(lambda _: page.ask(FAILED, page.session.look_for_focus()))
            more = guarded(page, FAILED)(lambda _: page.ask(FAILED, page.session.look_at_more_places()))
            self._look = command_button(page.gui, "Look for the focus", viser.Icon.CROSSHAIR, look)
            self._more = command_button(page.gui, "More places", viser.Icon.PLUS, more)
            in_a_row(page.gui, [self._look, self._more])
            self._windows = HtmlBlock(page.gui)
        page.on_pick("focus-row", lambda row: page.change(focus_row=int(row)))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the section; it is hidden while the plan does not follow the focus."""
        draft = snapshot.draft
        follow = draft.job.follow_focus if draft.job is not None else None
        set_prop(self._folder, "visible", follow is not None)
        if draft.job is None or follow is None:
            return
        shown = words.followed(draft, view.focus_row)
        idle = draft.plan is not None and snapshot.rig.state == "ready"
        everywhere = shown is not None and len(shown.look.places) >= len(shown.plan.fields)
        set_prop(self._look, "disabled", not idle)
        set_prop(self._more, "disabled", not idle or shown is None or everywhere)
        self._allow.show(follow.coverage_factor)
        self._head.show(words.head(draft, shown))
        self._windows.show(words.windows(shown))

    def _allow_for(self, factor: float) -> None:
        job = self._page.session.snapshot.draft.job
        if job is None or job.follow_focus is None:
            return
        follow = replace(job.follow_focus, coverage_factor=factor)
        self._page.ask("The allowance was not changed", self._page.session.edit_job(replace(job, follow_focus=follow)))
