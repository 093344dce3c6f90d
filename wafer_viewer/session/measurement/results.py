"""Results list and notebook of the open dataset: edited with undo, saved at every change.

Thumbnails are stored next to the list. A number is never reused, so that the thumbnail of a deleted result still
belongs to it after the deletion is undone.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any

from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.findings import AnyResult, MeasurementResults
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.job import Notebook, SavedView, Verdict
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.command_queue import CommandQueue, UndoHistory
from wafer_viewer.session.core.commands import command, observer_command
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.state.snapshot import NotebookState


def default_name(finding: AnyResult) -> str:
    """Return the name of a new result, which a count follows."""
    if (tool := TOOL_OF_RESULT.get(type(finding))) is not None:
        return tool.result_name or tool.short
    return "Gauge check" if isinstance(finding, GaugeCheck) else "Defect"


class ResultsStore:
    """Controller of the results list; every command returns a future."""

    def __init__(self, command_queue: CommandQueue, library: Library) -> None:
        self._command_queue, self._library = command_queue, library
        self._items: UndoHistory[tuple[AnyResult, ...]] = UndoHistory(())
        self._highest = 0

    def open(self) -> None:
        """Read the results of the displayed surface; the list is empty without a dataset."""
        shown = self._command_queue.now.dataset
        self._items.restart(())  # do not keep those of another dataset if these cannot be read
        self._items.restart(self._library.result.findings().items if shown is not None else ())
        pictured = self._library.result.highest_thumbnail() if shown is not None else 0
        self._highest = max((pictured, *(f.number for f in self._items.value)))
        self._show()

    @command.audited("Result kept")
    def keep(self, finding: AnyResult, thumbnail: bytes | None = None) -> AnyResult:
        """Add a result with a number and a name; thumbnail: a small picture of the region, JPEG."""
        self._require_writable()
        self._highest += 1
        if thumbnail is not None:
            self._library.result.save_thumbnail(self._highest, thumbnail)
        numbered = replace(finding, number=self._highest, name=finding.name or self._name_for(finding))
        self._change((*self._items.value, numbered))
        return numbered

    @command
    def rename(self, number: int, name: str) -> None:
        """Rename a result."""
        renamed = replace(self._numbered(number), name=name.strip() or self._numbered(number).name)
        self._change(tuple(renamed if f.number == number else f for f in self._items.value))

    @command.audited("Result deleted")
    def delete(self, number: int) -> None:
        """Delete a result."""
        self._numbered(number)
        self._change(tuple(f for f in self._items.value if f.number != number))

    @command.audited("Change of results undone")
    def undo(self) -> None:
        """Undo the last change of the list."""
        self._require_writable()
        self._items.undo()
        self._save()

    @command.audited("Change of results redone")
    def redo(self) -> None:
        """Redo the change of the list that was undone last."""
        self._require_writable()
        self._items.redo()
        self._save()

    @observer_command
    def export(self, path: Path) -> Path:
        """Write the list as CSV."""
        from wafer_viewer.store.io.atomic_files import write_text
        from wafer_viewer.store.tables.csv_tables import findings_csv

        path = Path(path)
        write_text(path, findings_csv(MeasurementResults(items=self._items.value)))
        return path

    def _change(self, items: tuple[AnyResult, ...]) -> None:
        self._require_writable()
        self._items.put(items)
        self._save()

    def _save(self) -> None:
        self._library.result.save_findings(MeasurementResults(items=self._items.value))
        self._show()

    def _show(self) -> None:
        self._command_queue.change(
            findings=self._items.value, findings_undo=self._items.can_undo, findings_redo=self._items.can_redo
        )

    def _name_for(self, finding: AnyResult) -> str:
        """Return the first of 'Step 1', 'Step 2', … that no result has."""
        taken = {f.name for f in self._items.value}
        names = (f"{default_name(finding)} {nth}" for nth in count(1))
        return next(name for name in names if name not in taken)

    def _numbered(self, number: int) -> AnyResult:
        found = next((f for f in self._items.value if f.number == number), None)
        if found is None:
            raise MeasureError(f"There is no result {number}: it was deleted, choose another.")
        return found

    def _require_writable(self) -> None:
        if (why := self._library.shown.read_only) is not None:
            raise MeasureError(f"Results cannot be kept: {why}")


class NotebookController:
    """Controller of the notebook, ``session.notebook``; every command returns a future."""

    def __init__(self, command_queue: CommandQueue, library: Library) -> None:
        self._command_queue, self._library = command_queue, library
        self._history: UndoHistory[Notebook] = UndoHistory(Notebook())

    def open(self) -> None:
        """Read the notebook of the displayed result; it is empty without a dataset."""
        from wafer_viewer.store.records.inspection_records import read_notebook

        shown = self._command_queue.now.dataset
        self._history.restart(Notebook())  # do not keep that of another dataset if this cannot be read
        self._history.restart(read_notebook(self._library.result.path) if shown is not None else Notebook())
        self._show()

    @command
    def save_view(self, view: SavedView) -> SavedView:
        """Save a view with a number; a view without a name is named after its number."""
        views = self._history.value.views
        number = next(n for n in range(1, len(views) + 2) if all(v.number != n for v in views))
        numbered = replace(view, number=number, name=view.name.strip() or f"View {number}")
        self._put(views=tuple(sorted((*views, numbered), key=lambda v: v.number)))
        return numbered

    @command
    def rename_view(self, number: int, name: str) -> None:
        """Rename a view."""
        old = self._numbered(number)
        renamed = replace(old, name=name.strip() or old.name)
        self._put(views=tuple(renamed if v.number == number else v for v in self._history.value.views))

    @command
    def delete_view(self, number: int) -> None:
        """Delete a view."""
        self._numbered(number)
        self._put(views=tuple(v for v in self._history.value.views if v.number != number))

    @command.audited("Finding judged")
    def judge(self, key: str, verdict: Verdict | None = None, note: str | None = None) -> None:
        """Accept or reject an item under review, or set a note; None leaves the verdict or the note unchanged."""
        old = self._history.value.judgement(key)
        new = replace(
            old,
            verdict=old.verdict if verdict is None else verdict,
            note=old.note if note is None else note.strip(),
        )
        if new != old:
            others = tuple(j for j in self._history.value.judgements if j.key != key)
            self._put(judgements=tuple(sorted((*others, new), key=lambda j: j.key)))

    @command.audited("Judgement of findings undone")
    def undo(self) -> None:
        """Undo the last change of the notebook."""
        self._require_writable()
        self._history.undo()
        self._save()

    @command.audited("Judgement of findings redone")
    def redo(self) -> None:
        """Redo the last undone change."""
        self._require_writable()
        self._history.redo()
        self._save()

    def _put(self, **changes: Any) -> None:
        self._require_writable()
        self._history.put(replace(self._history.value, **changes))
        self._save()

    def _save(self) -> None:
        from wafer_viewer.store.records.inspection_records import write_notebook

        write_notebook(self._library.result.path, self._history.value)
        self._show()

    def _show(self) -> None:
        history = self._history
        self._command_queue.change(notebook=NotebookState(history.value, history.can_undo, history.can_redo))

    def _numbered(self, number: int) -> SavedView:
        found = self._history.value.view(number)
        if found is None:
            raise DatasetError(f"There is no view {number}: it was deleted, choose another.")
        return found

    def _require_writable(self) -> None:
        if (why := self._library.shown.read_only) is not None:
            raise DatasetError(f"Nothing can be noted down: {why}")
