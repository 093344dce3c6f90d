"""Overlay of another tool's defects: number of matches, and the places of unmatched defects."""

from __future__ import annotations

from collections.abc import Callable

from markupsafe import Markup

from wafer_viewer.draw.charts.wafer_map import MapMark
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.results import Box
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.klarf import KlarfDefect
from wafer_viewer.session.state.inspection_state import OtherTool
from wafer_viewer.session.state.snapshot import Snapshot

MOST_ROWS, MOST_MARKS = 6, 400
INK = "var(--ink)"
ROUND, LEAST_PX = 3.0, 120
"""Side of the area shown relative to the defect, and its minimum in pixels of the surface."""


class OtherSection:
    """Section shown while a KLARF file is overlaid."""

    def __init__(self, page: Page, fly: Callable[[Box], object]) -> None:
        self._page, self._fly = page, fly
        self._shown_for: tuple[object, object] = None, None
        self._cell = HtmlBlock(page.gui)
        page.on_pick("defect-other", self._go_to)
        page.on_pick("defect-other-away", lambda _: self._take_away())

    def show(self, snapshot: Snapshot) -> None:
        """Bring the section up to date."""
        other, defects = snapshot.defect_files.other, snapshot.inspection.defects
        if (
            self._shown_for[0] is not other or self._shown_for[1] is not defects
        ):  # thousands of places take a tenth of a second
            self._shown_for = other, defects
            self._cell.show(overlay_html(other, defects) if other is not None else "")

    def _go_to(self, other_number: str) -> None:
        now = self._page.session.snapshot
        other = now.defect_files.other
        if other is None or now.surface is None:
            return
        pairs = zip(other.klarf.defects, other.places, strict=True)
        place = next((place for defect, place in pairs if defect.number == int(other_number)), None)
        if place is not None:
            self._fly(_box_around(place.bounds_um, LEAST_PX * now.surface.pixel_um))

    def _take_away(self) -> None:
        self._page.ask("The overlay was not removed", self._page.session.defects.files.take_away())


def other_marks(other: OtherTool | None) -> list[MapMark]:
    """Return the map marks of the other tool's defects: open rings, so that our own defects stay visible inside."""
    if other is None:
        return []
    pairs = list(zip(other.klarf.defects, other.places, strict=True))[:MOST_MARKS]
    return [
        MapMark(
            place.points[0].x_um,
            place.points[0].y_um,
            INK,
            f"{other.name} {defect.number}{f', {defect.class_name}' if defect.class_name else ''}",
            attributes=html.pick("defect-other", str(defect.number)),
            shape="ring",
        )
        for defect, place in pairs
    ]


def overlay_html(other: OtherTool, defects: tuple[Defect, ...]) -> Markup:
    """Return the match counts and the table of unmatched defects as HTML."""
    compared = tuple(defect for defect in defects if defect.kind != "unmeasured")
    rest = other.unmatched(compared)
    both, n = len(other.klarf.defects) - len(rest), len(other.klarf.defects)
    away = Markup('<span class="wv-link" {}>Remove overlay</span>').format(html.pick("defect-other-away"))
    head = Markup('<div class="wv-h">{}<span>{}</span></div>').format(other.name, away)
    simulated = "SIMULATED. " if other.klarf.simulated else ""
    summary = (
        f"{simulated}{_counted(n, 'place')} of another tool: {both} found here too, {len(rest)} not. "
        f"{len(compared) - both} found here {'is' if len(compared) - both == 1 else 'are'} not in the file. "
        f"The same within {number(other.within_um, 0)} µm; {other.by}."
    )
    notes = Markup("").join(_lab(note) for note in other.klarf.notes)
    more = _lab(f"{len(rest) - MOST_ROWS} more on the map.") if len(rest) > MOST_ROWS else ""
    rows = [_row(defect) for defect, _ in rest[:MOST_ROWS]]
    table = html.table(["Not found here", "Die", "Size, µm"], rows, " nn") if rows else ""
    return Markup('{head}{lab}{notes}{table}{more}<div style="height:8px"></div>').format(
        head=head, lab=_lab(summary), notes=notes, table=table, more=more
    )


def _row(defect: KlarfDefect) -> Markup:
    name = f"{defect.number} {defect.class_name}".strip()
    size = number(defect.size_um, 1) if defect.size_um else "–"
    return html.row([name, f"{defect.col},{defect.row}", size], " nn", html.pick("defect-other", str(defect.number)))


def _box_around(bounds: Box, least_um: float) -> Box:
    x0, y0, x1, y1 = bounds
    half = max(ROUND * max(x1 - x0, y1 - y0), least_um) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half, y - half, x + half, y + half


def _counted(n: int, what: str) -> str:
    return f"1 {what}" if n == 1 else f"{number(n, 0)} {what}s"


def _lab(text: str) -> Markup:
    return Markup('<div class="wv-lab" style="margin-bottom:5px">{}</div>').format(html.with_micro_sign(text))
