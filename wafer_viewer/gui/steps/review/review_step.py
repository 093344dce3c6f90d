"""The panel of the step Review: one item at a time with its numbers; class and judgement stay in sight at the foot."""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import symbol_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html, Text
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.panels import awaited
from wafer_viewer.gui.page.preconditions import can_undo
from wafer_viewer.gui.presenters import verdict as words
from wafer_viewer.gui.presenters.review import (
    VERDICT_LOOKS,
    ReviewItem,
    alike,
    chosen_defect,
    chosen_item,
    classes_of,
    learned_text,
    review_items,
)
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.steps.review.judging import JUDGEMENTS, NOT_JUDGED, NOT_NOTED, Review, framed
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import COMMIT_S
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES, ClassTable
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.state.snapshot import Snapshot

PICTURE_PX = 480
NOTE_HINT = "Saved with the judgement and shown in the report"
PICTURE = "picture of a result"


def review_step(here: Here[Review]) -> Elements | None:
    """Return the item under review; the left panel lists all items."""
    snapshot, view, review, page = here.snapshot, here.view, here.own, here.page
    if view.step != "review" or view.explains:
        return None
    if (item := chosen_item(snapshot, view)) is None:
        return [None, Html(page.notes(snapshot) + _nothing_yet(snapshot))]
    if item.defect is not None and view.review != item.key:
        page.change(review=item.key)
    defect, table = chosen_defect(snapshot, item.key), classes_of(snapshot.inspection)
    return [
        Html(html.title(f"{item.sign} · {item.title}", item.below)),
        Html(page.notes(snapshot)),
        Html(_picture(here, item) if defect is None else ""),
        Html(numbers_of(item)),
        Text(
            "Note",
            item.judgement.note,
            lambda text: review.note(item.key, text),
            NOTE_HINT,
            commands=True,
            action="Finding judged",
            failed=NOT_NOTED,
            pause_s=COMMIT_S,
        ),
        Html(
            Markup('<div class="wv-judging">{}{}{}</div>').format(
                _state(here, item), _learned(defect, table), classes(defect, table)
            )
        ),
        Buttons(_judgements(here, defect is not None), 34, at_foot=True, key=defect is not None),
        Button("Next", lambda: review.step(1), viser.Icon.ARROW_RIGHT, "leading", failed="The item was not changed"),
    ]


REVIEW_PICKS: Picks[Review] = {
    "review": lambda here, key: here.own.go_to(key),
    "review-step": lambda here, by: here.own.step(int(by)),
    "review-filter": lambda here, key: here.page.change(review_filter=key),
    "review-reopen": lambda here, _: here.own.reopen(),
    "defect-class": lambda here, kind: here.own.classify(kind),
    "defect-learned": lambda here, _: here.own.as_learned(),
    "sheet": lambda here, sheet: here.own.look(sheet),
    "pane": lambda here, pane: here.page.change(pane=pane),
    "compared": lambda here, what: here.page.change(compared=what),
}


def _judgements(here: Here[Review], of_defect: bool) -> list[Button]:
    """Return the buttons that accept, reject and take back."""
    review, icon = here.own, viser.Icon

    def command(label: str, act: Callable[[], None], sign: Any, failed: str, disabled: bool = False) -> Button:
        return Button(label, act, sign, disabled=disabled, commands=True, action="Finding judged", failed=failed)

    (accept, good, real), (reject, bad, none) = JUDGEMENTS
    return [
        command(real if of_defect else good, lambda: review.judge(accept), icon.CHECK, NOT_JUDGED),
        command(none if of_defect else bad, lambda: review.judge(reject), icon.X, NOT_JUDGED),
        command(
            "Undo",
            lambda: review.take_back("undo"),
            icon.ARROW_BACK_UP,
            "Nothing was undone",
            not can_undo(here.snapshot, here.view),
        ),
    ]


def _state(here: Here[Review], item: ReviewItem) -> Markup:
    """Return the judgement of the item with a link that takes it away, and what Shift and a key would judge."""
    n_open = sum(other.is_open for other in review_items(here.snapshot))
    left = f"{number(n_open, 0)} open" if n_open else "everything is judged"
    n_alike = len(alike(here.snapshot, here.view)) if item.defect is not None else 0
    which = "selected" if here.view.marked else f"open {item.title.lower()}"
    together = f"Shift + key: {number(n_alike, 0)} {which}" if n_alike > 1 else left
    if item.is_open:
        return html.head("Class and judgement" if item.defect is not None else "Judgement", together)
    sign, colour = VERDICT_LOOKS[item.judgement.verdict]
    said = Markup('<div><b style="color:var(--{})">{} {}</b> · {}</div>').format(
        colour,
        html.icon(sign, 14),
        item.judged_as,
        html.command_link("reopen", "review-reopen", action="Finding judged"),
    )
    return html.head(said, left)


def classes(defect: Defect | None, table: ClassTable = DEFECT_CLASSES) -> Markup:
    """Return the class buttons with their keys, the current class marked; empty for other items."""
    if defect is None:
        return Markup()
    tiles = (
        Markup('<span class="{}" aria-pressed="{}" title="{}" {}>{}{} {}</span>').format(
            "on" if look.name == defect.seen_as else "",
            str(look.name == defect.seen_as).lower(),
            " · ".join(part for part in (f"Key {look.key}" if look.key else look.title, look.code) if part),
            html.command_pick("defect-class", look.name, "Defects judged"),
            Markup("<kbd>{}</kbd>").format(look.key) if look.key else "",
            symbol_svg(look.shape, look.colour),
            look.title,
        )
        for look in table.offered
    )
    return Markup('<div class="wv-classes">{}</div>').format(Markup("").join(tiles))


def _learned(defect: Defect | None, table: ClassTable) -> Markup:
    """Return the class that judgements propose, with the link that agrees."""
    if defect is None or not (text := learned_text(defect, table)):
        return Markup()
    agrees = html.command_link("agree", "defect-learned", action="Defects judged", title="Alt + Y")
    return Markup('<div class="wv-lab wv-learned">From judgements: {} · {}</div>').format(text, agrees)


def numbers_of(item: ReviewItem) -> Markup:
    """Return all quantities of an item with their U, and the verdict with its reason."""
    rows = [html.row(row, " nn") for row in item.rows]
    word = words.state(item.word) + " · " if item.word is not None else Markup()
    reason = word + html.typeset(item.reason)
    below = Markup('<div class="wv-sub" style="margin-top:6px">{}</div>').format(reason) if reason else Markup()
    return (html.table(["", "Value", "± U, 95 %", ""], rows, " nn") if rows else Markup()) + below


def _picture(here: Here[Review], item: ReviewItem) -> Markup:
    """Return the picture of a result or feature; a sentence if it has no position on the surface."""
    if item.box_um is None:
        return html.empty("It has no place on the surface.")
    source, url = source_of(here.snapshot, item.show), ""
    if source is not None:
        request = RenderRequest(source, "picture", box_um=framed(item, here.snapshot), side_px=PICTURE_PX)
        paint = here.page.session.paint
        jpeg = here.ask(PICTURE, request, lambda: paint(request).result(), "The picture was not made", request).value
        url = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}" if jpeg else ""
    inside = Markup('<img alt="{}" src="{}">').format(item.title, url) if url else Markup()
    return Markup('<div class="wv-review-picture">{}</div>').format(inside)


def _nothing_yet(snapshot: Snapshot) -> Markup:
    """Return the hint shown when nothing is under review."""
    if awaited(snapshot):
        return words.waiting(snapshot.operating.judging)
    inspected = snapshot.inspection.inspection is not None
    none = "No defect was found, and no result is kept."
    say = none if inspected else "Inspect for defects on the left, or keep a result."
    return html.title("Review", "One item after the other, by keyboard alone.") + html.empty(say)
