"""The gallery of the listed defects over the scene: pages of thumbnails, of which several can be selected."""

from __future__ import annotations

from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import symbol_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.overlays.hud import SheetRoom
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.review import VERDICT_LOOKS, ReviewItem, number_of, review_items
from wafer_viewer.gui.scenes.thumbnails import Thumbnails, defect_request, image
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.review.panes import FOOT_PX, HEAD_PX, PAD_PX, sheet_head
from wafer_viewer.gui.widgets import html
from wafer_viewer.session.state.snapshot import Snapshot

TILE_PX, NAME_PX, GAP_PX = 96, 34, 8
"""Side of a picture, height of the two lines below it, and distance of two tiles, in CSS pixels."""
HELD = {"and": "Ctrl", "to": "Shift"}
HINT = Markup(
    "Ctrl + click: one more<span class=wv-further> · Shift + click: all up to here</span>"
    "<span class=wv-furthest> · Shift + Y, N or a class key judges the selected</span>"
)


def gallery_sheet(here: Here[Any], thumbnails: Thumbnails, room: SheetRoom) -> tuple[Markup, int]:
    """Return the page of the gallery that holds the defect under review."""
    snapshot, view = here.snapshot, here.view
    items, (cols, rows) = defects_on_show(snapshot, view), tiles_in(room)
    shown = page_of(items, view.review, cols * rows)
    requests = [defect_request(item, snapshot) for item in shown]
    pictures = thumbnails.painted_all(requests)
    tiles = Markup("").join(
        _tile(item, jpeg, chosen=item.key == view.review, marked=item.defect in view.marked)
        for item, jpeg in zip(shown, pictures, strict=True)
    )
    height = room.height_px - HEAD_PX - FOOT_PX - 2 * PAD_PX
    style = f"grid-template-columns:repeat({cols},{TILE_PX}px);height:{height}px"
    sheet = Markup('{}<div class="wv-gallery" style="{}">{}</div><div class="wv-lab wv-sheet-foot">{}</div>').format(
        _head(view, items, shown),
        style,
        tiles or html.empty("No defect matches."),
        _foot(view),
    )
    return sheet, room.height_px


def defects_on_show(snapshot: Snapshot, view: View) -> list[ReviewItem]:
    """Return the listed defects in their order."""
    return [item for item in review_items(snapshot, view.review_filter, view.defects) if item.defect is not None]


def tiles_in(room: SheetRoom) -> tuple[int, int]:
    """Return the numbers of columns and rows of a page."""
    cols = (room.width_px - 2 * PAD_PX + GAP_PX) // (TILE_PX + GAP_PX)
    rows = (room.height_px - HEAD_PX - FOOT_PX - 2 * PAD_PX + GAP_PX) // (TILE_PX + NAME_PX + GAP_PX)
    return max(2, cols), max(1, rows)


def page_of(items: list[ReviewItem], key: str | None, most: int) -> list[ReviewItem]:
    """Return the items of the page with a key; the first page without it."""
    index = next((k for k, item in enumerate(items) if item.key == key), 0)
    return items[index // most * most :][:most]


def marked_by_click(view: View, items: list[ReviewItem], clicked: str) -> tuple[int, ...]:
    """Return the selection after a click: `clicked` is a key, after "and " with Ctrl, after "to " with Shift."""
    held, key = _split(clicked)
    number = number_of(key)
    if not held or number is None:
        return ()
    keys = [item.key for item in items]
    if held == "to" and view.review in keys and key in keys:
        low, high = sorted((keys.index(view.review), keys.index(key)))
        between = (item.defect for item in items[low : high + 1] if item.defect is not None)
        return tuple(dict.fromkeys((*view.marked, *between)))
    first = number_of(view.review)
    begun = view.marked or ((first,) if first is not None and view.review in keys and first != number else ())
    return tuple(n for n in begun if n != number) if number in begun else (*begun, number)


def _split(clicked: str) -> tuple[str, str]:
    held, _, key = clicked.partition(" ")
    return (held, key) if held in HELD else ("", clicked)


def tile_clicked(page: Page, clicked: str) -> str | None:
    """Select by a click on a tile; return the key to go to after a click without a key held."""
    held, key = _split(clicked)
    marked = marked_by_click(page.view, defects_on_show(page.session.snapshot, page.view), clicked)
    page.change(marked=marked)
    return None if held else key


def mark_all(page: Page) -> None:
    """Select all listed defects; deselect them if any are selected."""
    numbers = [item.defect for item in defects_on_show(page.session.snapshot, page.view) if item.defect is not None]
    page.change(marked=() if page.view.marked else tuple(numbers))


def _tile(item: ReviewItem, jpeg: bytes, chosen: bool, marked: bool) -> Markup:
    sign, colour = VERDICT_LOOKS[item.judgement.verdict]
    look = " ".join(name for name, on in (("sel", chosen), ("marked", marked), ("done", not item.is_open)) if on)
    label = Markup('aria-label="{}" aria-pressed="{}" title="{} · {}"').format(
        f"{item.sign}, {item.title}, {item.judged_as}", str(marked).lower(), item.title, item.below.split(" · ")[0]
    )
    tick = html.icon(viser.Icon.CHECK, 13) if marked else ""
    return Markup(
        '<span class="wv-tile {look}" data-where="held" {pick} {label}><i>{tick}</i><u>{image}</u>'
        '<b>{symbol} {sign}<em style="color:var(--{colour})">{verdict}</em></b><small>{value}</small></span>'
    ).format(
        look=look,
        pick=html.pick("tile", item.key),
        label=label,
        tick=tick,
        image=image(jpeg),
        symbol=symbol_svg(item.shape, item.colour, 12),
        sign=item.sign,
        colour=colour,
        verdict=html.icon(sign, 13),
        value=item.below.split(" · ")[0].removeprefix("Die ") if item.below.startswith("Die ") else "no die",
    )


def _head(view: View, items: list[ReviewItem], shown: list[ReviewItem]) -> Markup:
    """Return the head with the shown numbers, and the ways to the pages before and after."""
    if not shown:
        return sheet_head(view, "", (Markup(), Markup()))
    first, n, most = items.index(shown[0]), len(shown), len(items)
    words = f"{number(first + 1, 0)} – {number(first + n, 0)} of {number(most, 0)}"
    before, after = items[max(0, first - 1)], items[min(most - 1, first + n)]
    return sheet_head(view, words, (html.pick("review", before.key), html.pick("review", after.key)))


def _foot(view: View) -> Markup:
    n = len(view.marked)
    words = f"{number(n, 0)} selected" if n else "None selected"
    return Markup("<b>{}</b> · {} · {}").format(words, html.link("none" if n else "all", "tiles", "all"), HINT)
