"""Stop command: halt all motion at once; after a scan, ask how to proceed."""

from __future__ import annotations

import viser

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.dialogs.dialog import Confirm, Dialog
from wafer_viewer.gui.elements.elements import Elements
from wafer_viewer.gui.page.page import Page
from wafer_viewer.session.state.snapshot import FieldState, OpenDataset, RigStatus, Snapshot

NOT_STOPPED = "Nothing was stopped"
COMPLETE = (FieldState.TAKEN, FieldState.RECONSTRUCTING, FieldState.MEASURED)
"""States of a field with all frames."""


def can_stop(snapshot: Snapshot) -> bool:
    """Return whether the rig moves, works, scans or is paused."""
    return snapshot.rig.state in ("moving", "working", "scanning", "paused")


def stop(page: Page) -> None:
    """Halt all motion at once, then ask how to proceed with an interrupted scan."""
    was_scanning = page.session.snapshot.scanning
    page.ask(NOT_STOPPED, page.session.stop(), lambda anything: _stopped(page, bool(anything), was_scanning))


def _stopped(page: Page, anything: bool, was_scanning: bool) -> None:
    """Report the stop. The holder of the controls learns of a stopped move from its own command."""
    snapshot = page.session.snapshot
    data, holds = snapshot.dataset, snapshot.control.holds(page.browser.key)
    if not anything:
        page.say(NOT_STOPPED, "Nothing moves.", "attention")
    elif was_scanning and _is_interrupted(snapshot, data) and data is not None:
        if holds:
            _ask_what_next(page, data)
        else:
            page.say("The scan is stopped", complete_fields_sentence(data), "attention")
    elif not holds:
        page.say("Stopped", f"The stage stands at {place(snapshot.rig)}.", "attention")


def _ask_what_next(page: Page, data: OpenDataset) -> None:
    """Ask whether to continue or end the scan; close the dialog when it no longer applies."""
    text = (
        f"{complete_fields_sentence(data)} To continue takes only the missing frames; that is possible later as well."
    )

    def close_when_settled(here: Dialog[None]) -> Elements:
        if not _is_interrupted(here.snapshot, data):
            here.close()
        return ()

    go_on, failed = lambda _: page.session.continue_scan(), "The scan did not continue"
    answer = Confirm("Continue the scan", viser.Icon.PLAYER_PLAY, go_on, failed, away="End the scan")
    Dialog(page, "The scan is stopped", text, answer, None, close_when_settled)


def _is_interrupted(now: Snapshot, data: OpenDataset | None) -> bool:
    """Return whether the scan of `data` is open, unfinished and at rest."""
    shown = now.dataset
    return data is not None and shown is not None and shown.path == data.path and not (shown.finished or now.scanning)


def complete_fields_sentence(data: OpenDataset) -> str:
    """Return how many fields of a dataset are complete, as a sentence."""
    complete = sum(state in COMPLETE for state in data.states.values())
    return f"{complete} of {len(data.fields)} fields {'is' if complete == 1 else 'are'} complete; all frames are kept."


def place(rig: RigStatus) -> str:
    """Format the stage position in mm, as in the header."""
    axes = (("X", rig.x_um), ("Y", rig.y_um), ("Z", rig.z_um))
    return ", ".join(f"{axis} {number(um / 1000, 4, signed=True)}" for axis, um in axes) + " mm"
