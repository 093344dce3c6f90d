"""Recipes, golden dies and files of defects of a session that stands still: kept in memory, written nowhere."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future
from datetime import datetime
from pathlib import Path
from typing import Any

from tests.browser.recording import Recording, refused
from tests.support.datasets.inspections import written_klarf
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.inspection.defect import Defect, DefectRecipe, Inspection
from wafer_viewer.model.inspection.golden_die import GoldenHeader
from wafer_viewer.model.region import Point
from wafer_viewer.model.spec import replace
from wafer_viewer.session.inspection.inspection_files import SAME_PLACE_UM, DefectFiles, overlay_klarf
from wafer_viewer.session.state.inspection_state import DefectFilesState


def a_shelf() -> DefectFilesState:
    """Recipes of two products and three versions of golden dies."""
    recipes = (
        DefectRecipe(name="standard", product="LX-7", sensitivity=0.45),
        DefectRecipe(name="night shift", product="LX-7", sensitivity=0.3),
        DefectRecipe(name="standard", product="MEMS-2", sensitivity=0.6),
    )
    golden = (
        golden_header("lx7", 3, "2026-03-12T16:20:00"),
        golden_header("lx7", 2, "2026-02-02T09:00:00"),
        golden_header("lx7 thick", 1, "2025-11-20T11:30:00"),
        golden_header("mems", 1, "2026-01-09T10:00:00", "MEMS-2"),
    )
    return DefectFilesState(recipes=recipes, golden=golden)


def golden_header(name: str, version: int, at: str, product: str = "LX-7") -> GoldenHeader:
    return GoldenHeader(
        product=product, name=name, version=version, pixel_um=0.5, width_um=120.0, height_um=120.0, dies=20,
        made_of="coupon-04", made_at=at, simulated=True,
    )  # fmt: skip


def other_file(folder: Path, inspection: Inspection) -> Path:
    """A KLARF of another tool: what was found less one, a little off, and two places more."""
    moved = [_moved(defect, 4.0, -3.0) for defect in inspection.found[1:]]
    more = [
        replace(_moved(defect, 55.0, 30.0), number=90 + k, kind="particle")
        for k, defect in enumerate(inspection.found[:2])
    ]
    seen = replace(inspection, defects=(*moved, *more))
    return written_klarf(seen, folder / "tool-2.klarf", at=datetime(2026, 3, 14, 9, 0))


def _moved(defect: Defect, x_um: float, y_um: float) -> Defect:
    return replace(defect, center=Point(x_um=defect.center.x_um + x_um, y_um=defect.center.y_um + y_um))


class FakeDefectFiles(Recording):
    """What is kept is listed at once; a KLARF is really read."""

    def __init__(self, session: Any) -> None:
        super().__init__(DefectFiles, session._done, "defects.files.")
        self._session = session

    @property
    def _shelf(self) -> DefectFilesState:
        return self._session.snapshot.defect_files

    def save_recipe(self, recipe: DefectRecipe) -> Future[Any]:
        others = tuple(r for r in self._shelf.recipes if (r.product, r.name) != (recipe.product, recipe.name))
        return self._put("save_recipe", (recipe,), recipes=(recipe, *others))

    def rename_recipe(self, recipe: DefectRecipe, name: str) -> Future[Any]:
        recipes = tuple(replace(r, name=name) if r == recipe else r for r in self._shelf.recipes)
        return self._put("rename_recipe", (recipe, name), recipes=recipes)

    def delete_recipe(self, recipe: DefectRecipe) -> Future[Any]:
        return self._put("delete_recipe", (recipe,), recipes=tuple(r for r in self._shelf.recipes if r != recipe))

    def keep_golden(self, name: str) -> Future[Any]:
        version = 1 + max((h.version for h in self._shelf.golden if h.name == name), default=0)
        kept = golden_header(name, version, "2026-03-14T10:00:00")
        return self._put("keep_golden", (name,), golden=(kept, *self._shelf.golden))

    def add_golden(self, path: Path) -> Future[Any]:
        return self.keep_golden(path.name.split(".")[0])

    def lay_over(self, path: Path, unit: Any = None, within_um: float = SAME_PLACE_UM) -> Future[Any]:
        now = self._session.snapshot
        try:
            other = overlay_klarf(path, now.dataset.job.alignment, now.inspection.inspection, unit, within_um)
        except WaferViewerError as fault:
            return refused(fault)
        return self._put("lay_over", (path,), other=other)

    def take_away(self) -> Future[Any]:
        return self._put("take_away", (), other=None)

    def _put(self, verb: str, asked: tuple[Any, ...], **changes: Any) -> Future[Any]:
        self._session.change(defect_files=dataclasses.replace(self._shelf, **changes))
        return self._session._done(f"defects.files.{verb}", asked, {})
