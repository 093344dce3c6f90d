"""Stop, wherever it is pressed: a scan is asked about first, any other motion is broken off at once."""

from __future__ import annotations

from wafer_viewer.draw.numbers import number
from wafer_viewer.gui.dialogs import stop_dialog
from wafer_viewer.gui.page import Page
from wafer_viewer.session.state import RigStatus, Snapshot

NOT_STOPPED = "Nothing was stopped"


def can_stop(snapshot: Snapshot) -> bool:
    """Whether there is a motion that does not end already."""
    return snapshot.rig.state in ("moving", "scanning", "paused")


def stop(page: Page) -> None:
    """Stop what moves; what was not stopped because nothing moves is said."""
    if page.session.snapshot.scanning:
        stop_dialog(page)
    else:
        page.ask(NOT_STOPPED, page.session.stop(), lambda anything: _tell(page, anything))


def _tell(page: Page, anything: bool) -> None:
    """Whoever holds the controls hears it from the move that ended; others hear it here."""
    snapshot = page.session.snapshot
    if not anything:
        page.say(NOT_STOPPED, "Nothing moves.", "attention")
    elif not snapshot.hands.holds(page.browser.key):
        page.say("Stopped", f"The stage stands at {place(snapshot.rig)}.", "attention")


def place(rig: RigStatus) -> str:
    """Where the stage stands, as the header writes it."""
    axes = (("X", rig.x_um), ("Y", rig.y_um), ("Z", rig.z_um))
    return ", ".join(f"{axis} {number(um / 1000, 4, signed=True)}" for axis, um in axes) + " mm"
