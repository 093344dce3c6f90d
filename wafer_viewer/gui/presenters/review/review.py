"""HTML of the step Review: list of items, picture and numbers of an item."""

from __future__ import annotations

from wafer_viewer.gui.presenters import verdict
from wafer_viewer.gui.presenters.review.judgement_colours import VERDICT_LOOKS
from wafer_viewer.gui.presenters.review.review_item import VERDICTS, ReviewItem
from wafer_viewer.gui.presenters.review.review_items import FILTERS, chosen_item, review_items
from wafer_viewer.gui.state.view_state import ReviewFilter, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.session.state.snapshot import Snapshot

_NONE: dict[ReviewFilter, str] = {
    "all": "Nothing is under review.",
    "open": "Nothing is left open.",
    "accepted": "Nothing was accepted.",
    "rejected": "Nothing was rejected.",
}


def review_list(snapshot: Snapshot, view: View) -> str:
    """Return the list of features and results in the left panel, with the filter; empty in other steps.

    If there are defects, the filter is part of their list above.
    """
    everything = [item for item in review_items(snapshot) if item.defect is None]
    if view.step != "review" or not everything:
        return ""
    listed = [item for item in review_items(snapshot, view.review_filter) if item.defect is None]
    now = chosen_item(snapshot, view.review, view.defects)
    judged = sum(item.judgement.verdict != "open" for item in everything)
    rows = [_row(item, now is not None and item.key == now.key) for item in listed]
    body = html.table([], rows, "  n") if rows else html.empty(_NONE[view.review_filter])
    head = html.head("Under review", f"{judged} of {len(everything)} judged")
    over = "" if snapshot.inspection.defects else filters(view)
    return f'{head}{over}{body}<div style="height:6px"></div>'


def picture(item: ReviewItem, url: str) -> str:
    """Return the picture of an item; a sentence if it has no position on the surface."""
    if item.box_um is None:
        return html.empty("It has no place on the surface.")
    inside = f'<img alt="{html.safe(item.title)}" src="{url}">' if url else ""
    return f'<div class="wv-review-picture">{inside}</div>'


def numbers(item: ReviewItem) -> str:
    """Return all quantities of an item with their U, and the verdict with its reason."""
    rows = [html.row([html.safe(cell) for cell in row], " nn") for row in item.rows]
    word = f"{verdict.state(item.word)} · " if item.word is not None else ""
    said = word + html.safe(html.with_micro_sign(item.said))
    below = f'<div class="wv-sub" style="margin-top:6px">{said}</div>' if said else ""
    table = html.table(["", "Value", "± U, k = 2", ""], rows, " nn") if rows else ""
    return html.head("Numbers") + table + below


def progress(items: tuple[ReviewItem, ...]) -> str:
    """Describe the progress of the review."""
    left = sum(item.judgement.verdict == "open" for item in items)
    rejected = sum(item.judgement.verdict == "rejected" for item in items)
    said = f"{left} still open" if left else "Everything is judged"
    on = "Page Down goes to the next open one" if left else "Page Down continues"
    return f'<div class="wv-why">{said}{f" · {rejected} rejected" if rejected else ""} · {on}</div>'


def _row(item: ReviewItem, chosen: bool) -> str:
    sign, colour = VERDICT_LOOKS[item.judgement.verdict]
    state = f"<small>{verdict.state(item.word)}</small>" if item.word is not None else ""
    name = (
        f'<span class="wv-cut wv-short" title="{html.safe(item.title)}">{html.safe(item.title)}</span>'
        f"{state}<small style='color:var(--{colour})'>{html.icon(sign, 14)} {VERDICTS[item.judgement.verdict]}</small>"
    )
    attributes = f'{html.pick("review", item.key)} aria-label="{html.safe(f"{item.title}, {item.told}")}"'
    return html.row([html.chip(item.sign, item.colour), name, item.value], "  n", attributes, "sel" if chosen else "")


def filters(view: View) -> str:
    """Return the filter buttons."""
    chosen = view.review_filter
    buttons = "".join(
        f'<span class="{"on" if key == chosen else ""}" aria-pressed="{str(key == chosen).lower()}" '
        f"{html.pick('review-filter', key)}>{name}</span>"
        for key, name in FILTERS
    )
    return f'<div class="wv-segments">{buttons}</div>'
