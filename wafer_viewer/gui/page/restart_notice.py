"""Note after a restart: reopened dataset, and confirmation of the sample before any motion."""

from __future__ import annotations

import viser

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.status_bar import job_shown, sample
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.session.state.snapshot import Snapshot


class Reopened:
    """Request to confirm the sample on the stage, in the steps that move the rig."""

    def __init__(self, page: Page) -> None:
        self._note = HtmlBlock(page.gui)
        failed = "The sample is not confirmed"
        page.on_pick("confirm-sample", lambda _: page.ask(failed, page.session.jobs.confirm()))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the note until the sample is confirmed."""
        waits = not snapshot.draft.confirmed and view.step in ("plan", "acquire")
        self._note.show(_words(snapshot, view) if waits else "")


def _words(snapshot: Snapshot, view: View) -> str:
    data = snapshot.dataset
    name = sample(job_shown(snapshot, view))[0] or (data.path.stem if data is not None else "an unfinished plan")
    said = f"Reopened from last time: {name}. Another sample may be on the stage now."
    yes = f'<span class="wv-link" {html.pick("confirm-sample")}>It is this sample</span>'
    sign = html.icon(viser.Icon.ALERT_TRIANGLE, 18)
    return html.note("attention", "Nothing moves before you confirm the sample", said, yes, sign)
