"""Dialog of areas excluded on every die because they differ by design, such as numbers and probe marks."""

from __future__ import annotations

from collections.abc import Callable

import viser

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.gui.widgets.number_field import PLACE, OptionalPair
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.region import Region

Areas = tuple[Region, ...]
STAYS, CORNER = "The areas were not changed", "corner of a new one, x, y from that of the die; empty: none"
ROOM = 0.25
"""Margin around a defect as a share of its size; its position varies slightly from die to die."""
BELOW = (
    "Areas of every die, µm from its lower left corner, that are not searched: numbers and probe marks differ from "
    "die to die. They are part of the recipe; defects already found stay until the surface is inspected again."
)


class ExcludedDialog:
    """Dialog that lists the excluded areas, to be edited or removed, and takes two corners of a new one.

    proposed: further areas, such as that of the defect under review. Nothing changes before Keep is pressed.
    """

    def __init__(self, page: Page, areas: Areas, keep: Callable[[Areas], None], proposed: Areas = ()) -> None:
        self._areas = (*areas, *proposed)
        dialog = Dialog(page, "Areas left out", BELOW)
        with dialog.modal:
            self._table = HtmlBlock(page.gui, area_table(self._areas))
            self._start = OptionalPair(page.gui, "From, µm", between=PLACE, hint=f"Lower left {CORNER}")
            self._end = OptionalPair(page.gui, "To, µm", between=PLACE, hint=f"Upper right {CORNER}")
        page.on_pick("defect-area-change", lambda key: self._change(int(key)))
        page.on_pick("defect-area-away", lambda key: self._take_away(int(key)))
        dialog.answers("Keep", viser.Icon.CHECK, lambda: keep((*self._areas, *self._typed())), STAYS)

    def _typed(self) -> Areas:
        """Return the rectangle between the entered corners; empty if none are entered.

        Raises MeasureError if one corner is missing or the rectangle is empty.
        """
        start, end = self._start.value, self._end.value
        if start is None and end is None:
            return ()
        if start is None or end is None:
            raise MeasureError("One corner of the area is missing: type both, or leave both empty.")
        if start[0] == end[0] or start[1] == end[1]:
            raise MeasureError("The area is empty: type two opposite corners of a rectangle.")
        return (Region.rectangle(*map(min, start, end), *map(max, start, end)),)

    def _change(self, k: int) -> None:
        """Move the corners of an area into the input fields, to be edited."""
        x0, y0, x1, y1 = self._areas[k].bounds_um
        self._start.value, self._end.value = (x0, y0), (x1, y1)
        self._take_away(k)

    def _take_away(self, k: int) -> None:
        self._areas = (*self._areas[:k], *self._areas[k + 1 :])
        self._table.show(area_table(self._areas))


def area_of_defect(defect: Defect | None) -> Areas:
    """Return the rectangle around a defect, relative to the corner of its die; empty if it is on no die."""
    if defect is None or defect.in_die is None:
        return ()
    x0, y0, x1, y1 = defect.outline.bounds_um
    half_x, half_y = (x1 - x0) * (0.5 + ROOM), (y1 - y0) * (0.5 + ROOM)
    u, v = defect.in_die.x_um, defect.in_die.y_um
    return (Region.rectangle(*(round(um, 1) for um in (u - half_x, v - half_y, u + half_x, v + half_y))),)


def area_table(areas: Areas) -> str:
    """Return the table of excluded areas with links to edit and remove them, as HTML."""
    if not areas:
        return html.empty("The whole die is searched.")
    return html.table(["", "x, µm", "y, µm", ""], [_row(k, area) for k, area in enumerate(areas)], " nn ")


def _row(k: int, area: Region) -> str:
    """Return the table row of an area as HTML; only rectangles can be edited."""
    x0, y0, x1, y1 = area.bounds_um
    change, away = ("Change", "change", "Edit its corners"), ("Remove", "away", "Search there again")
    verbs = " · ".join(
        f'<span class="wv-link" title="{title}" {html.pick(f"defect-area-{what}", k)}>{verb}</span>'
        for verb, what, title in ((change, away) if area.kind == "rectangle" else (away,))
    )
    spans = (f"{number(low, 1)} – {number(high, 1)}" for low, high in ((x0, x1), (y0, y1)))
    return html.row([str(k + 1), *spans, f'<span style="white-space:nowrap">{verbs}</span>'], " nn ")
