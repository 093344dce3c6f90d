"""Keyboard dialog for a note on an item under review."""

from __future__ import annotations

import viser

from wafer_viewer.gui.page import judgement
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.review.review_item import ReviewItem

FAILED = "The note was not changed"


def note_dialog(page: Page, item: ReviewItem) -> None:
    """Open the note dialog; Enter saves the note."""
    dialog = Dialog(page, f"Note on {item.sign} · {item.title}", "Saved with the judgement and shown in the report.")
    with dialog.modal:
        text = page.gui.add_text("Note", item.judgement.note, hint="Enter saves, Escape cancels")
    dialog.answers(
        "Save the note",
        viser.Icon.NOTE,
        lambda: page.ask(FAILED, judgement.note(page.session, item.key, text.value)),
        FAILED,
    )
