"""Defects of the open dataset: detected by a worker, judged by people with undo, saved at every change."""

from __future__ import annotations

import datetime
from collections.abc import Collection
from concurrent.futures import Future
from dataclasses import replace as with_changes
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer.model.errors import DatasetError, DiesNotFound, WaferViewerError
from wafer_viewer.model.inspection.defect import (
    Against,
    Defect,
    DefectRecipe,
    Inspection,
    Judgement,
    require_dies_for,
)
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.command_queue import UndoHistory
from wafer_viewer.session.core.commands import command
from wafer_viewer.session.inspection.inspection_job import Dies, inspect_dataset, mosaic_mark
from wafer_viewer.session.state.inspection_state import InspectionState, product_of

if TYPE_CHECKING:
    from wafer_viewer.model.inspection.defect import DefectLimits
    from wafer_viewer.session.core.background_work import BackgroundWork
    from wafer_viewer.session.core.command_queue import CommandQueue
    from wafer_viewer.session.core.dataset_library import Library
    from wafer_viewer.session.inspection.inspection_files import DefectFiles
    from wafer_viewer.session.inspection.reference_views import DefectViews
    from wafer_viewer.session.state.snapshot import Snapshot


class DefectController:
    """Controller of the inspection, ``session.defects``; commands return futures."""

    files: DefectFiles
    views: DefectViews

    def __init__(
        self,
        command_queue: CommandQueue,
        library: Library,
        background: BackgroundWork,
        files: DefectFiles,
        views: DefectViews,
    ) -> None:
        self._command_queue, self._library, self._background = command_queue, library, background
        self.files, self.views = files, views
        self._history: UndoHistory[Inspection | None] = UndoHistory(None)
        self._opened_for: tuple[Path, str] | None = None
        self._work, self._problem, self._stamp, self._dies_missing = "", "", 0, False
        self._search = 0

    def watch(self) -> None:
        """Check whether the inspection is still valid whenever the surface changes."""
        self._command_queue.subscribe(
            lambda now: self._command_queue.note(self._look_again) if self._stamp != _stamp(now) else None
        )

    def open(self) -> None:
        """Read the inspection of the displayed surface; a running inspection of another one is cancelled."""
        from wafer_viewer.store.records.inspection_records import read_inspection

        looked_at = self._looked_at
        if self._work and looked_at != self._opened_for:
            self._background.cancel(self._work)
        self._problem, self._dies_missing, stored = "", False, None
        if looked_at is not None:
            try:
                stored = read_inspection(self._library.result.path)
            except WaferViewerError as fault:
                self._problem = str(fault)
        self._restart(stored)
        self._show()

    @command
    def inspect(
        self, recipe: DefectRecipe | None = None, dies: Dies = None, against: Against = "dies"
    ) -> Future[Inspection]:
        """Inspect the stitched surface for defects; the work can be cancelled.

        recipe: by default the last one saved for the product of the dataset. dies: a lattice, "found" to detect the
        dies on the surface, or None: the job's, else detected. against: the reference of the comparison; the fitted
        form is compared only if asked for.
        """
        self._require_writable()
        if self._work:
            raise DatasetError("Defects are being searched for already: wait, or cancel it in the job list.")
        if self._command_queue.now.surface is None:
            raise DatasetError("There is no stitched surface yet: defects are searched for on that.")
        arguments = (self._library.dataset.path, self._library.result_name, recipe or self._own_recipe, dies, against)
        running = self._background.lead("Search for defects", inspect_dataset, *arguments, ended=self._ended)
        self._work, self._opened_for, self._problem, self._dies_missing = running.id, self._looked_at, "", False
        self._show()
        return running.done

    @command.audited("Defects judged")
    def judge(
        self,
        number: int | Collection[int],
        judgement: Judgement | None = None,
        kind: str | None = None,
        note: str | None = None,
    ) -> None:
        """Judge a defect, or several at once, as real or nuisance, set class or note; None leaves it unchanged."""
        self._require_writable()
        numbers = {number} if isinstance(number, int) else set(number)
        inspection = self._holding(numbers)
        if kind is not None and kind not in (table := inspection.recipe.class_table):
            known = ", ".join(entry.name for entry in table.offered)
            raise DatasetError(f"There is no class {kind!r}: choose one of {known}.")
        given = {"judgement": judgement, "judged_kind": kind, "note": None if note is None else note.strip()}
        given = {name: value for name, value in given.items() if value is not None}
        by = {"judged_by": self._library.shown.job.sample.operator, "judged_at": now()}
        defects = tuple(_judged(one, given, by) if one.number in numbers else one for one in inspection.defects)
        if defects != inspection.defects:
            self._history.put(replace(inspection, defects=defects))
            self._save()

    @command
    def propose_classes(self) -> Future[Inspection]:
        """Propose classes for open defects from the judged ones, of this surface and of the product's other wafers."""
        from wafer_viewer.session.inspection.inspection_files import learn_classes

        self._require_writable()
        self._holding(set())
        arguments = (self._library.dataset.path, self._library.result_name)
        return self._background.run("Propose classes", learn_classes, *arguments, ended=self._proposed).done

    @command.audited("Defect limits changed")
    def limit(self, limits: DefectLimits) -> None:
        """Set the allowed number of defects per die and per wafer; `verdict_of` compares the inspection with them."""
        self._require_writable()
        if (inspection := self._history.value) is None:
            raise DatasetError("Limits are for what was found: inspect for defects first.")
        require_dies_for(limits, bool(inspection.dies))
        if limits != inspection.recipe.limits:
            self._history.put(replace(inspection, recipe=replace(inspection.recipe, limits=limits)))
            self._save()

    @command.audited("Class table changed")
    def load_classes(self, path: Path | None) -> None:
        """Use the class table of a file for what was found, None for the built-in one; judgements keep their class."""
        from wafer_viewer.store.records.inspection_records import read_class_table

        self._require_writable()
        if (inspection := self._history.value) is None:
            raise DatasetError("Classes are for what was found: inspect for defects first.")
        classes = () if path is None else read_class_table(path)
        if classes != inspection.recipe.classes:
            self._history.put(replace(inspection, recipe=replace(inspection.recipe, classes=classes)))
            self._save()

    @command.audited("Change of defects undone")
    def undo(self) -> None:
        """Undo the last change of judgements or limits."""
        self._require_writable()
        self._history.undo()
        self._save()

    @command.audited("Change of defects redone")
    def redo(self) -> None:
        """Redo the last undone change."""
        self._require_writable()
        self._history.redo()
        self._save()

    def _ended(self, done: Future[Inspection]) -> None:
        """Store the inspection; if it failed, show the reason in place of the defect list."""
        self._work = ""
        if self._opened_for == self._looked_at:
            try:
                self._take_over(done.result())
            except WaferViewerError as fault:
                self._problem, self._dies_missing = str(fault), isinstance(fault, DiesNotFound)
        self._show()

    def _proposed(self, done: Future[Inspection]) -> None:
        """Add proposals to the defects that are still open; a failure is reported to whoever asked for them."""
        inspection = self._history.value
        if inspection is None or done.cancelled() or done.exception() is not None:
            return
        if (new := done.result()).mark == inspection.mark:
            learned = {defect.number: defect.learned for defect in new.defects}
            defects = tuple(replace(d, learned=learned.get(d.number, d.learned)) for d in inspection.defects)
            self._history.put(replace(inspection, defects=defects, learned=new.learned))
            self._save()

    def _take_over(self, new: Inspection) -> None:
        """Store the inspection, with earlier judgements of the same places carried over."""
        from wafer_viewer.store.records.inspection_records import carry_over, write_inspection

        before = self._history.value
        inspection = new if before is None else carry_over(before, new)
        write_inspection(self._library.result.path, inspection)
        self._restart(inspection)
        files = with_changes(self._command_queue.now.defect_files, earlier=None)  # it has the numbers of those before
        self._command_queue.change(defect_files=files)

    def _restart(self, inspection: Inspection | None) -> None:
        self._history.restart(inspection)
        self._search += 1

    def _save(self) -> None:
        from wafer_viewer.store.records.inspection_records import write_inspection

        if (inspection := self._history.value) is not None:
            write_inspection(self._library.result.path, inspection)
        self._show()

    def _look_again(self) -> None:
        """Update the state if the surface has changed."""
        if self._stamp != _stamp(self._command_queue.now):
            self._show()

    def _show(self) -> None:
        history, inspection = self._history, self._history.value
        self._stamp = _stamp(self._command_queue.now)
        stale = inspection is not None and inspection.mark not in ("", mosaic_mark(self._library.result))
        self._command_queue.change(
            inspection=InspectionState(
                inspection,
                stale,
                self._problem,
                self._dies_missing,
                self._work,
                history.can_undo,
                history.can_redo,
                self._search,
            )
        )

    @property
    def _own_recipe(self) -> DefectRecipe:
        """Recipe stored for the product of the dataset, else the default one."""
        product = product_of(self._library.shown.job)
        return self._command_queue.now.defect_files.recipe_of(product) or DefectRecipe(product=product)

    @property
    def _looked_at(self) -> tuple[Path, str] | None:
        shown = self._command_queue.now.dataset
        return (shown.path, self._library.result_name) if shown is not None else None

    def _holding(self, numbers: set[int]) -> Inspection:
        inspection = self._history.value
        missing = numbers - {defect.number for defect in inspection.defects} if inspection is not None else numbers
        if inspection is None or missing:
            gone = ", ".join(map(str, sorted(missing)))
            raise DatasetError(f"There is no defect {gone}: the surface was searched again, choose another.")
        return inspection

    def _require_writable(self) -> None:
        if (why := self._library.shown.read_only) is not None:
            raise DatasetError(f"Defects were not changed: {why}")


def _judged(old: Defect, given: dict[str, Any], by: dict[str, Any]) -> Defect:
    """Return a defect with what is given; it is judged by nobody else if nothing of it changes."""
    new = replace(old, **given)
    return old if new == old else replace(new, **by)


def now() -> str:
    """Return the current time, ISO 8601."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


def _stamp(now: Snapshot) -> int:
    return now.surface.stamp if now.surface is not None else 0
