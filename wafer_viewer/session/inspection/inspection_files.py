"""Inspection recipes, golden dies and defect files: storage next to the datasets, exports, and KLARF overlays."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace as with_changes
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.session.inspection.defect_export import Handover, hand_over, keep_golden
from wafer_viewer.session.inspection.klarf_overlay import KlarfUnit, overlay_klarf
from wafer_viewer.session.state.inspection_resources import SAME_PLACE_UM, DefectShelf, OtherTool

if TYPE_CHECKING:
    from wafer_viewer.model.inspection.golden_die import GoldenHeader
    from wafer_viewer.session.core.background_work import BackgroundWork
    from wafer_viewer.session.core.command_queue import CommandQueue
    from wafer_viewer.session.core.dataset_library import Library

TITLES: dict[Handover, str] = {"klarf": "KLARF", "csv": "Table of defects", "training": "Training set"}


class DefectFilesKeeper:
    """Controller of the snapshot's inspection resources. Use on the session's thread only."""

    def __init__(self, desk: CommandQueue, library: Library, background: BackgroundWork, folder: Path) -> None:
        self._desk, self._library, self._background, self._folder = desk, library, background, folder

    def open(self) -> None:
        """Remove the overlay of the previous surface, and list recipes and golden dies again."""
        self.take_away()
        self.refresh()

    def refresh(self) -> None:
        """List recipes and golden dies again."""
        from wafer_viewer.store.records.defect_recipes import readable_recipes
        from wafer_viewer.store.records.golden_dies import FOLDER, every_golden

        recipes, problems = readable_recipes(self._folder)
        golden = sorted(every_golden(self._folder / FOLDER), key=lambda header: header.name.casefold())
        self._put(recipes=recipes, golden=tuple(golden), problems=problems)

    def save_recipe(self, recipe: DefectRecipe) -> Path:
        """Save a recipe under its product and name."""
        from wafer_viewer.store.records.defect_recipes import save_defect_recipe

        path = save_defect_recipe(self._folder, recipe)
        self.refresh()
        return path

    def rename_recipe(self, recipe: DefectRecipe, name: str) -> None:
        """Rename a stored recipe."""
        from wafer_viewer.store.records.defect_recipes import rename_defect_recipe

        rename_defect_recipe(self._folder, recipe, name)
        self.refresh()

    def delete_recipe(self, recipe: DefectRecipe) -> None:
        """Delete a stored recipe."""
        from wafer_viewer.store.records.defect_recipes import delete_defect_recipe

        delete_defect_recipe(self._folder, recipe)
        self.refresh()

    def keep_golden(self, name: str) -> Future[Path]:
        """Store the typical die as a golden die, on a worker; the list is updated afterwards."""
        done = self._background.run(f"Golden die {name}", keep_golden, *self._looked_at, name)
        return self._desk.afterwards(done, self.refresh)

    def add_golden(self, path: Path) -> GoldenHeader:
        """Copy a golden die from a file as the next version of its name.

        A golden die in the data folder is not copied.
        """
        from wafer_viewer.store.records.golden_dies import ENDING, FOLDER, header_of, open_golden, save_golden

        folder = self._folder / FOLDER
        if path.absolute().parent == folder.absolute():
            header = header_of(path)
        else:
            golden = open_golden(path)
            name = golden.header.name or path.name.removesuffix(ENDING)
            header = header_of(save_golden(golden, folder / name))
        self.refresh()
        return header

    def write(self, what: Handover, path: Path) -> Future[Path]:
        """Write the defects to a file or a folder, on a worker."""
        return self._background.run(f"{TITLES[what]} {path.name}", hand_over, *self._looked_at, what, path.absolute())

    def lay_over(self, path: Path, unit: KlarfUnit | None, within_um: float) -> OtherTool:
        """Read a KLARF file and overlay its defects on the surface."""
        alignment, inspection = self._library.shown.job.alignment, self._desk.now.inspection.inspection
        other = overlay_klarf(path, alignment, inspection, unit, within_um)
        self._put(other=other)
        return other

    def take_away(self) -> None:
        """Remove the overlay."""
        if self._desk.now.shelf.other is not None:
            self._put(other=None)

    @property
    def _looked_at(self) -> tuple[Path, str]:
        return self._library.dataset.path, self._library.result_name

    def _put(self, **changes: Any) -> None:
        shelf: DefectShelf = with_changes(self._desk.now.shelf, **changes)
        if shelf != self._desk.now.shelf:
            self._desk.change(shelf=shelf)


class DefectFiles:
    """Defect file commands of the page, ``session.defects.files``; commands return futures."""

    def __init__(self, do: Callable[..., Future[Any]], keeper: DefectFilesKeeper) -> None:
        self._do, self._keeper = do, keeper

    def save_recipe(self, recipe: DefectRecipe) -> Future[Path]:
        """Save a recipe under its product and name; an earlier one is replaced."""
        return self._do(self._keeper.save_recipe, recipe)

    def rename_recipe(self, recipe: DefectRecipe, name: str) -> Future[None]:
        """Rename a stored recipe."""
        return self._do(self._keeper.rename_recipe, recipe, name)

    def delete_recipe(self, recipe: DefectRecipe) -> Future[None]:
        """Delete a stored recipe and its file."""
        return self._do(self._keeper.delete_recipe, recipe)

    def keep_golden(self, name: str) -> Future[Path]:
        """Store the typical die of the inspected surface as the next version of a name; no version is overwritten."""
        return self._do(self._keeper.keep_golden, name)

    def add_golden(self, path: Path) -> Future[GoldenHeader]:
        """Copy a golden die from a file, as the next version of its name; the future's result is its header."""
        return self._do(self._keeper.add_golden, Path(path))

    def write(self, what: Handover, path: Path) -> Future[Path]:
        """Write the defects with their judgements: ``klarf`` and ``csv`` to a file, ``training`` to a new folder."""
        return self._do(self._keeper.write, what, Path(path))

    def lay_over(
        self, path: Path, unit: KlarfUnit | None = None, within_um: float = SAME_PLACE_UM
    ) -> Future[OtherTool]:
        """Overlay the defects of a KLARF file on the surface; lengths are um unless the file or `unit` says otherwise.

        within_um: maximum distance between positions of the same defect.
        """
        return self._do(self._keeper.lay_over, Path(path), unit, within_um)

    def take_away(self) -> Future[None]:
        """Remove the overlay."""
        return self._do(self._keeper.take_away)

    def refresh(self) -> Future[None]:
        """List recipes and golden dies again."""
        return self._do(self._keeper.refresh)
