"""The notebook of the open dataset as the snapshot shows it."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.job.review_notes import Notebook


@dataclass(frozen=True, slots=True)
class NotebookState:
    """Saved views and judgements, and whether the last change to them can be undone or done again."""

    book: Notebook = Notebook()
    can_undo: bool = False
    can_redo: bool = False
