"""Connection monitor: texts that a page shows when the connection is lost and restored.

The browser's part is lost_connection.js; it gets its texts in advance and a heartbeat every second.
"""

from __future__ import annotations

import itertools
import secrets
import threading
import time

from markupsafe import Markup

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.stop import complete_fields_sentence
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

BEAT_S = 1.0
PROGRAM, SINCE = secrets.token_hex(8), time.strftime("%H:%M:%S")
"""Identity and start time of this process; a page that finds another one reports a restart."""
_STOP_OUT_OF_REACH, _RED_BUTTON = "Stop on this page does not reach the rig.", "Press the red button on the rig."


class Contact:
    """Heartbeat to the browser, with the texts to show if the connection is lost."""

    def __init__(self, page: Page) -> None:
        self._page = secrets.token_hex(8)
        self._beats = itertools.count()
        self._words = Markup()
        self._cell = HtmlBlock(page.gui, padded=False)
        self._closed = threading.Event()
        self._lock = threading.Lock()
        page.on_pick("contact-look", lambda _: page.change(step=_step_to_look_at(page.session.snapshot), why=None))
        page.on_close(self._closed.set)
        threading.Thread(target=self._beat, name="contact", daemon=True).start()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the browser's texts up to date."""
        words = {
            "program": PROGRAM,
            "page": self._page,
            "since": SINCE,
            "state": state(snapshot),
            "box": out_of_reach(snapshot.rig),
            "back": disconnection_summary(snapshot),
            "anew": restart_summary(snapshot),
            "look": "Look, and confirm the sample" if not snapshot.draft.confirmed else "Look",
        }
        self._words = Markup(" ").join(Markup('data-{}="{}"').format(name, text) for name, text in words.items())
        self._tell()

    def _beat(self) -> None:
        while not self._closed.wait(BEAT_S):
            self._tell()

    def _tell(self) -> None:
        if self._words and not self._closed.is_set():
            with self._lock:
                look = Markup("<span {}></span>").format(html.pick("contact-look"))
                self._cell.show(
                    Markup('<div hidden class="wv-contact" {} data-beat="{}">{}</div>').format(
                        self._words, next(self._beats), look
                    )
                )


def state(snapshot: Snapshot) -> str:
    """Return the state of the rig in words, shown as the last known state when the connection is lost."""
    scan = snapshot.scan
    if snapshot.scanning and scan is not None:
        return f"{snapshot.rig.state}, field {scan.field.number}"
    return "at rest" if snapshot.rig.state == "ready" else snapshot.rig.state


def out_of_reach(rig: RigStatus) -> str:
    """Return the instruction for stopping the rig without this page."""
    return f"{_STOP_OUT_OF_REACH}\n{'It is simulated: nothing real moves.' if rig.simulated else _RED_BUTTON}"


def disconnection_summary(snapshot: Snapshot) -> str:
    """Return what happened while the page was disconnected, and whether action is needed."""
    scan, data = snapshot.scan, snapshot.dataset
    if snapshot.rig.state in ("fault", "absent"):
        return f"{snapshot.rig.message or 'The rig does not answer.'}"
    if snapshot.scanning and scan is not None:
        missing = f"{scan.frames_missing} missing, taken again later" if scan.frames_missing else "none missing"
        frames = f"frame {scan.frames_done} of {scan.frames_total}, {missing}"
        return f"The scan continued without this page: {frames}. Nothing to do."
    if scan is not None and scan.finished and data is not None:
        ended = "has ended" if data.finished else "is stopped"
        return f"The scan {ended}: {complete_fields_sentence(data)} Nothing to do."
    return "Nothing moves. Nothing to do." if snapshot.rig.state == "ready" else f"The rig is {snapshot.rig.state}."


def restart_summary(snapshot: Snapshot) -> str:
    """Return what was preserved over a restart of the program, and whether the sample must be confirmed."""
    data = snapshot.dataset
    what = (
        f"{data.path.stem}: {complete_fields_sentence(data)}" if data is not None else "Datasets and results are kept."
    )
    wait = "" if snapshot.draft.confirmed else " Nothing moves before the sample is confirmed."
    return f"{what}{wait}"


def _step_to_look_at(snapshot: Snapshot) -> str:
    """Return the step that asks to confirm the sample."""
    data = snapshot.dataset
    return "acquire" if data is not None and not data.finished else "plan"
