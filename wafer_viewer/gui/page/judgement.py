"""Dispatch of judgements under review: those of defects to the defects, all others to the notebook."""

from __future__ import annotations

from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from wafer_viewer.gui.presenters.review.defect_items import JUDGEMENT_OF, number_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.job.review_notes import Verdict

if TYPE_CHECKING:
    from wafer_viewer.session.api import SessionApi
    from wafer_viewer.session.state.snapshot import Snapshot


def judge(session: SessionApi, key: str, verdict: Verdict) -> Future[Any]:
    """Accept, reject or reopen an item."""
    number = number_of(key)
    if number is None:
        return session.notebook.judge(key, verdict)
    return session.defects.judge(number, JUDGEMENT_OF[verdict])


def note(session: SessionApi, key: str, text: str) -> Future[Any]:
    """Save a note on an item."""
    number = number_of(key)
    return session.notebook.judge(key, note=text) if number is None else session.defects.judge(number, note=text)


def undo(session: SessionApi, view: View) -> Future[Any]:
    """Undo the last judgement in the store of the item under review."""
    return session.notebook.undo() if number_of(view.review) is None else session.defects.undo()


def redo(session: SessionApi, view: View) -> Future[Any]:
    """Redo the last undone judgement in the store of the item under review."""
    return session.notebook.redo() if number_of(view.review) is None else session.defects.redo()


def can_undo(snapshot: Snapshot, view: View) -> bool:
    """Return whether a judgement can be undone."""
    of_defects = number_of(view.review) is not None
    return snapshot.inspection.can_undo if of_defects else snapshot.notebook.can_undo


def can_redo(snapshot: Snapshot, view: View) -> bool:
    """Return whether a judgement can be redone."""
    of_defects = number_of(view.review) is not None
    return snapshot.inspection.can_redo if of_defects else snapshot.notebook.can_redo
