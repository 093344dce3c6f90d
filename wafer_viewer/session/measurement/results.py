"""Results list of the open dataset: add, rename and delete with undo, saved at every change.

Thumbnails are stored next to the list. A number is never reused, so that the thumbnail of a deleted result still
belongs to it after the deletion is undone.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult, MeasurementResults
from wafer_viewer.model.gauge.gauge_check import GaugeCheck
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.measurement.edge_and_bump_shapes import Chipping, CircleSize, Coplanarity, DieSize, KerfWidth
from wafer_viewer.model.measurement.measurements import (
    AreaVolume,
    Distance,
    FaceAngle,
    Flatness,
    PointHeight,
    Profile,
    Radius,
)
from wafer_viewer.model.measurement.site_range import SiteRanges
from wafer_viewer.model.measurement.step import StepHeight, StepProfile
from wafer_viewer.model.measurement.texture import Roughness, Texture
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.core.undo_history import UndoHistory

NAMES: dict[type[AnyResult], str] = {
    Profile: "Profile",
    PointHeight: "Point",
    Distance: "Distance",
    StepHeight: "Step",
    StepProfile: "Groove",
    FaceAngle: "Angle",
    Radius: "Radius",
    AreaVolume: "Volume",
    Flatness: "Flatness",
    Texture: "Texture",
    Roughness: "Roughness",
    KerfWidth: "Kerf",
    DieSize: "Die size",
    CircleSize: "Circle",
    Chipping: "Chipping",
    Coplanarity: "Coplanarity",
    GaugeCheck: "Gauge check",
    SiteRanges: "Site range",
    Defect: "Defect",
}
"""Default names of results by type, followed by a count."""


class ResultsStore:
    """Results of the snapshot. Use on the session's thread only."""

    def __init__(self, desk: CommandQueue, library: Library) -> None:
        self._desk, self._library = desk, library
        self._items: UndoHistory[tuple[AnyResult, ...]] = UndoHistory(())
        self._highest = 0

    def open(self) -> None:
        """Read the results of the displayed surface; the list is empty without a dataset."""
        shown = self._desk.now.dataset
        self._items.restart(())  # those of another dataset must not stay where these cannot be read
        self._items.restart(self._library.result.findings().items if shown is not None else ())
        pictured = self._library.result.highest_thumbnail() if shown is not None else 0
        self._highest = max((pictured, *(f.number for f in self._items.value)))
        self._show()

    def keep(self, finding: AnyResult, thumbnail: bytes | None = None) -> AnyResult:
        """Add a result with a number and a name; thumbnail: a small picture of the region, JPEG."""
        self._require_writable()
        self._highest += 1
        if thumbnail is not None:
            self._library.result.save_thumbnail(self._highest, thumbnail)
        kept = replace(finding, number=self._highest, name=finding.name or self._name_for(finding))
        self._change((*self._items.value, kept))
        return kept

    def rename(self, number: int, name: str) -> None:
        """Rename a result."""
        renamed = replace(self._numbered(number), name=name.strip() or self._numbered(number).name)
        self._change(tuple(renamed if f.number == number else f for f in self._items.value))

    def delete(self, number: int) -> None:
        """Delete a result."""
        self._numbered(number)
        self._change(tuple(f for f in self._items.value if f.number != number))

    def undo(self) -> None:
        """Undo the last change of the list."""
        self._require_writable()
        self._items.undo()
        self._save()

    def redo(self) -> None:
        """Redo the change of the list that was undone last."""
        self._require_writable()
        self._items.redo()
        self._save()

    def export(self, path: Path) -> Path:
        """Write the list as CSV."""
        from wafer_viewer.store.io.atomic_files import write_text
        from wafer_viewer.store.tables.measurements_csv import findings_csv

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
        self._desk.change(
            findings=self._items.value, findings_undo=self._items.can_undo, findings_redo=self._items.can_redo
        )

    def _name_for(self, finding: AnyResult) -> str:
        """Return the first of 'Step 1', 'Step 2', … that no result has."""
        taken = {f.name for f in self._items.value}
        names = (f"{NAMES[type(finding)]} {nth}" for nth in count(1))
        return next(name for name in names if name not in taken)

    def _numbered(self, number: int) -> AnyResult:
        found = next((f for f in self._items.value if f.number == number), None)
        if found is None:
            raise MeasureError(f"There is no result {number}: it was deleted, choose another.")
        return found

    def _require_writable(self) -> None:
        if (why := self._library.shown.read_only) is not None:
            raise MeasureError(f"Results cannot be kept: {why}")
