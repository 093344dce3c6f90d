"""HTML of the defect list: rows around the defect under review, with thumbnails, and sort buttons."""

from __future__ import annotations

from collections.abc import Sequence

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.charts.symbols import symbol_svg
from wafer_viewer.gui.presenters.review.judgement_colours import VERDICT_LOOKS
from wafer_viewer.gui.presenters.review.review_item import ReviewItem
from wafer_viewer.gui.state.defect_list_state import SORTS, DefectListing
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.inspection.defect import Inspection

MOST_ROWS, ROWS_BEFORE = 40, 2
"""Rows shown at once, as thousands of pictures would be slow; rows before the item under review."""
JUDGED = {"open": "open", "accepted": "real", "rejected": "not a defect"}


def rows_of(items: Sequence[ReviewItem], now: ReviewItem | None) -> Sequence[ReviewItem]:
    """Return the items to show: from shortly before the one under review, which is always visible."""
    keys = [item.key for item in items]
    at = keys.index(now.key) if now is not None and now.key in keys else 0
    first = max(0, at - ROWS_BEFORE)
    return items[first : first + MOST_ROWS]


def rows(
    items: Sequence[ReviewItem], shown: Sequence[ReviewItem], now: ReviewItem | None, thumbs: Sequence[str]
) -> str:
    """Return the list, with links to the items before and after."""
    if not shown:
        return html.empty("No defect matches.")
    first = items.index(shown[0])
    before, after = items[:first][::-1], items[first + len(shown) :]
    body = [
        _row(item, now is not None and item.key == now.key, thumb) for item, thumb in zip(shown, thumbs, strict=True)
    ]
    more = _more(before, "before") + html.table([], body, "  n") + _more(after, "more")
    return f'<div class="wv-defects">{more}</div><div style="height:8px"></div>'


def sorting(listing: DefectListing, inspection: Inspection) -> str:
    """Return the sort buttons and the active filters."""
    buttons = "".join(
        f'<span class="{"on" if sort == listing.sort else ""}" aria-pressed="{str(sort == listing.sort).lower()}" '
        f"{html.pick('defect-sort', sort)}>{name}</span>"
        for sort, (name, _) in SORTS.items()
    )
    return f'<div class="wv-segments" aria-label="Sort by">{buttons}</div>{_alone(listing, inspection)}'


def _alone(listing: DefectListing, inspection: Inspection) -> str:
    """Return the active filters with a link that clears them; empty if everything is listed."""
    state = next((die.word for die in inspection.dies if die.name == listing.die), "")
    told = [f"Die {listing.die} ({state})" if state else f"Die {listing.die}"] if listing.die else []
    told += [KINDS[kind].title for kind in KINDS if kind == listing.kind]
    told += [f"{len(listing.numbers)} of one place on the dies"] if listing.numbers else []
    link = f'<span class="wv-link" {html.pick("defect-all")}>all</span>'
    return f'<div class="wv-lab wv-alone">{html.safe(" · ".join(told))} alone · {link}</div>' if told else ""


def _more(items: Sequence[ReviewItem], word: str) -> str:
    if not items:
        return ""
    link = f'<span class="wv-link" {html.pick("review", items[0].key)}>{len(items)} {word} …</span>'
    return f'<div class="wv-lab">{link}</div>'


def _row(item: ReviewItem, chosen: bool, thumbs: str) -> str:
    sign, colour = VERDICT_LOOKS[item.judgement.verdict]
    title, where = html.safe(item.title), item.below.split(" · ")[0].lower()
    told = html.safe(f"{item.sign}, {item.title}, {where}, {JUDGED[item.judgement.verdict]}")
    name = (
        f'<span class="wv-cut wv-short" title="{title}">{symbol_svg(item.shape, item.colour)} {title}</span>'
        f'<small title="{told}"><span style="color:var(--{colour})">{html.icon(sign, 13)}</span> '
        f"{html.safe(item.sign)} · {html.safe(where.removeprefix('die '))}</small>"
    )
    attributes = f'{html.pick("review", item.key)} aria-label="{told}"'
    return html.row(
        [f'<div class="wv-pair">{thumbs}</div>', name, item.value], "  n", attributes, "sel" if chosen else ""
    )
