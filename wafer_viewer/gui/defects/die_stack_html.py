"""HTML of all dies overlaid: the drawing and the list of repeating places."""

from __future__ import annotations

import base64
from collections.abc import Sequence

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.charts.die_stack import die_stack_svg, not_drawn, shown
from wafer_viewer.draw.charts.symbols import symbol_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.overlays.scene_sheet import SheetRoom
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.inspection.repeating_defect import LEAST_DIES, RepeatedPlace
from wafer_viewer.session.rendering.comparison_views import DiePicture

HEAD_PX, FOOT_PX, PAD_PX, LIST_PX = 30, 26, 12, 250
MOST_ROWS = 60
NO_DIES = "The surface was compared with its form: there are no dies to overlay."


def drawing_px(inspection: Inspection, room: SheetRoom) -> tuple[int, int]:
    """Return the width and height that the drawing can take next to the list, in pixels."""
    grid = inspection.grid
    aspect = grid.width_um / grid.height_um if grid is not None else 1.0
    width, height = room.width_px - LIST_PX - 3 * PAD_PX, room.height_px - HEAD_PX - FOOT_PX - 2 * PAD_PX
    return int(min(width, height * aspect)), int(min(height, width / aspect))


def sheet(
    inspection: Inspection,
    places: Sequence[RepeatedPlace],
    picture: DiePicture | None,
    size_px: tuple[int, int],
    chosen: int | None,
    place: int | None,
) -> str:
    """Return the sheet as HTML."""
    if inspection.grid is None:
        return head(inspection) + html.empty(NO_DIES)
    url = f"data:image/jpeg;base64,{base64.b64encode(picture.picture).decode()}" if picture and picture.picture else ""
    drawn = die_stack_svg(
        inspection,
        places,
        url,
        width_px=size_px[0],
        most_height_px=size_px[1],
        chosen=chosen,
        place=place,
        attributes=html.pick,
    )
    beside = f'<div class="wv-stack-list" style="max-height:{size_px[1]}px">{_list(inspection, places, place)}</div>'
    foot = f'<div class="wv-lab" style="height:{FOOT_PX}px;padding-top:6px">{_foot(inspection, places, picture)}</div>'
    return f'{head(inspection)}<div class="wv-stacked"><div>{drawn}</div>{beside}</div>{foot}'


def head(inspection: Inspection) -> str:
    """Return the header with title and close link as HTML."""
    whole = sum(die.state == "whole" for die in inspection.dies)
    name = f"All {whole} whole dies overlaid" if whole else "All dies overlaid"
    away = f'<span class="wv-link" {html.pick("sheet", "none")}>Close · Esc</span>'
    return f'<div class="wv-over-head" style="height:{HEAD_PX}px"><b>{name}</b><span>{away}</span></div>'


def place_of(numbers: tuple[int, ...], places: Sequence[RepeatedPlace]) -> int | None:
    """Return the index of the place that shares most defects with a filter; None if no place shares any.

    The numbers need not match exactly, because a defect that was rejected since is no longer part of its place.
    """
    common = [len(set(place.numbers) & set(numbers)) for place in places]
    return common.index(max(common)) if any(common) else None


def _list(inspection: Inspection, places: Sequence[RepeatedPlace], chosen: int | None) -> str:
    if not places:
        dies = "No two dies" if len({d.die for d in inspection.found if d.die}) < 2 else f"No {LEAST_DIES} dies"
        return html.empty("Nothing repeats.", f"{dies} have a defect at the same place.")
    rows = [_row(k, place, k == chosen) for k, place in enumerate(places[:MOST_ROWS])]
    more = f'<div class="wv-lab">{len(places) - MOST_ROWS} more</div>' if len(places) > MOST_ROWS else ""
    return html.head("Places that repeat", f"{len(places)}", first=True) + html.table([], rows, "  n") + more


def _row(k: int, place: RepeatedPlace, chosen: bool) -> str:
    look, at = KINDS[place.kind], place.in_die
    name = (
        f"{symbol_svg(look.shape, look.colour)} {look.title}"
        f"<small>x {number(at.x_um, 1)}, y {number(at.y_um, 1)}\u202fµm</small>"
    )
    dies = f"<b>{len(place.dies)}</b><small>of {place.of_dies} dies</small>"
    told = html.safe(f"Place {k + 1}, {look.title}, {place.words}")
    attributes = f'{html.pick("defect-place", k)} aria-label="{told}"'
    return html.row([f"{k + 1}", name, dies], "  n", attributes, "sel" if chosen else "")


def _foot(inspection: Inspection, places: Sequence[RepeatedPlace], picture: DiePicture | None) -> str:
    if picture is None:
        ground = "The picture of the die is made …"
    elif picture.why_not:
        ground = picture.why_not
    else:
        ground = f"Picture: {picture.golden or f'median of {picture.dies} dies'}"
    left = not_drawn(inspection, shown(inspection, places))
    parts = [ground, f"{left} weaker ones are not drawn" if left else "", "Backspace: next place" if places else ""]
    return html.safe(" · ".join(part for part in parts if part))
