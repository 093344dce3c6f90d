"""Sheets over the scene in Review: a defect beside its reference, the gallery, or all dies stacked onto one."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.overlays.hud import SheetRoom
from wafer_viewer.gui.scenes.thumbnails import Thumbnails
from wafer_viewer.gui.steps.review.die_stack import filter_by_place, stack_sheet
from wafer_viewer.gui.steps.review.gallery import gallery_sheet, mark_all, tile_clicked
from wafer_viewer.gui.steps.review.judging import Review
from wafer_viewer.gui.steps.review.panes import panes_sheet


@dataclass(frozen=True, slots=True)
class SheetState:
    """State of the sheets: the commands of the step, and the pictures of the gallery."""

    review: Review
    thumbnails: Thumbnails


def review_sheet(here: Here[SheetState], room: SheetRoom) -> tuple[Markup, int] | None:
    """Return the sheet that the view chooses; None for none."""
    match here.view.sheet_over:
        case "beside":
            return panes_sheet(here, room)
        case "gallery":
            return gallery_sheet(here, here.own.thumbnails, room)
        case "stack":
            return stack_sheet(here, room)
        case "none":
            return None


def _click_tile(here: Here[SheetState], clicked: str) -> None:
    if (key := tile_clicked(here.page, clicked)) is not None:
        here.own.review.go_to(key)


SHEET_PICKS: Picks[SheetState] = {
    "tile": _click_tile,
    "tiles": lambda here, _: mark_all(here.page),
    "defect-place": lambda here, k: filter_by_place(here, here.own.review, int(k)),
}
