"""What people think of a thing under review goes where it is kept: of a defect with the defects, else the notebook."""

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
    """Accept, reject, or leave open again."""
    number = number_of(key)
    if number is None:
        return session.notebook.judge(key, verdict)
    return session.defects.judge(number, JUDGEMENT_OF[verdict])


def note(session: SessionApi, key: str, text: str) -> Future[Any]:
    """Note something down."""
    number = number_of(key)
    return session.notebook.judge(key, note=text) if number is None else session.defects.judge(number, note=text)


def undo(session: SessionApi, view: View) -> Future[Any]:
    """What was thought before of things of the kind under review."""
    return session.notebook.undo() if number_of(view.review) is None else session.defects.undo()


def redo(session: SessionApi, view: View) -> Future[Any]:
    """What was undone of them."""
    return session.notebook.redo() if number_of(view.review) is None else session.defects.redo()


def can_undo(snapshot: Snapshot, view: View) -> bool:
    """Whether there is anything to undo."""
    of_defects = number_of(view.review) is not None
    return snapshot.inspection.can_undo if of_defects else snapshot.notebook.can_undo


def can_redo(snapshot: Snapshot, view: View) -> bool:
    """Whether anything was undone."""
    of_defects = number_of(view.review) is not None
    return snapshot.inspection.can_redo if of_defects else snapshot.notebook.can_redo
