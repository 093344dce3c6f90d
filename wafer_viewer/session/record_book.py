"""The list of results of the open dataset: kept, renamed and deleted with undo, saved at every change."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyFinding, Findings
from wafer_viewer.model.spec import replace
from wafer_viewer.session.desk import Desk
from wafer_viewer.session.history import History
from wafer_viewer.session.library import Library

NAMES = {"Profile": "Profile", "StepHeight": "Step", "Flatness": "Flatness", "GaugeCheck": "Gauge check"}


class RecordBook:
    """The findings of the snapshot; on the session's thread only."""

    def __init__(self, desk: Desk, library: Library) -> None:
        self._desk, self._library = desk, library
        self._items: History[tuple[AnyFinding, ...]] = History(())

    def open(self) -> None:
        """Read the findings of the result being looked at; none without a dataset."""
        shown = self._desk.now.dataset
        self._items.restart(self._library.result.findings().items if shown is not None else ())
        self._show()

    def keep(self, finding: AnyFinding) -> AnyFinding:
        """Number and name a finding, and keep it."""
        kind = NAMES.get(type(finding).__name__, type(finding).__name__)
        number = 1 + max((f.number for f in self._items.value), default=0)
        nth = 1 + sum(type(f) is type(finding) for f in self._items.value)
        kept = replace(finding, number=number, name=finding.name or f"{kind} {nth}")
        self._change((*self._items.value, kept))
        return kept

    def rename(self, number: int, name: str) -> None:
        """Another name for a finding."""
        renamed = replace(self._numbered(number), name=name.strip() or self._numbered(number).name)
        self._change(tuple(renamed if f.number == number else f for f in self._items.value))

    def delete(self, number: int) -> None:
        """Take a finding off the list."""
        self._numbered(number)
        self._change(tuple(f for f in self._items.value if f.number != number))

    def undo(self) -> None:
        """Back to the list before."""
        self._require_writable()
        self._items.undo()
        self._save()

    def export(self, path: Path) -> Path:
        """Write the list as CSV."""
        from wafer_viewer.store.exporters import findings_csv
        from wafer_viewer.store.files import write_text

        write_text(path, findings_csv(Findings(items=self._items.value)))
        return path

    def _change(self, items: tuple[AnyFinding, ...]) -> None:
        self._require_writable()
        self._items.put(items)
        self._save()

    def _save(self) -> None:
        self._library.result.save_findings(Findings(items=self._items.value))
        self._show()

    def _show(self) -> None:
        self._desk.change(findings=self._items.value, findings_undo=self._items.can_undo)

    def _numbered(self, number: int) -> AnyFinding:
        found = next((f for f in self._items.value if f.number == number), None)
        if found is None:
            raise MeasureError(f"There is no result {number}: it was deleted, choose another.")
        return found

    def _require_writable(self) -> None:
        if (why := self._library.shown.read_only) is not None:
            raise MeasureError(f"Results cannot be kept: {why}")
