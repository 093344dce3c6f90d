"""Notebook of the open dataset, as in the snapshot."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.job.review_notes import Notebook


@dataclass(frozen=True, slots=True)
class NotebookState:
    """Saved views and judgements, and whether their last change can be undone or redone."""

    book: Notebook = Notebook()
    can_undo: bool = False
    can_redo: bool = False
