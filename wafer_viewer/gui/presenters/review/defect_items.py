"""Defects as review items, for `review_items` and the panel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.gui.presenters.measurement import value_texts
from wafer_viewer.gui.presenters.result_regions import bounds_of
from wafer_viewer.gui.presenters.review.defects import below, said, size_text
from wafer_viewer.gui.presenters.review.review_item import ReviewItem, Row
from wafer_viewer.gui.state.defect_list_state import DefectListing, listed
from wafer_viewer.gui.state.view_state import OF_DEFECT, ReviewFilter
from wafer_viewer.model.inspection.defect import Defect, Judgement
from wafer_viewer.model.job.review_notes import Judgement as Noted
from wafer_viewer.model.job.review_notes import Verdict
from wafer_viewer.session.state.inspection_state import InspectionState
from wafer_viewer.session.state.snapshot import Snapshot

VERDICT_OF: dict[Judgement, Verdict] = {"open": "open", "real": "accepted", "nuisance": "rejected"}
JUDGEMENT_OF: dict[Verdict, Judgement] = {verdict: judgement for judgement, verdict in VERDICT_OF.items()}
"""Defect judgement by review verdict: an accepted defect is real."""
_known: dict[int, tuple[Defect, ReviewItem]] = {}
"""Cache of review items by defect number: a judgement changes one of thousands."""


def key_of(defect: Defect) -> str:
    """Return the review key of a defect."""
    return f"{OF_DEFECT}{defect.number}"


def number_of(key: str | None) -> int | None:
    """Return the defect number of a review key; None if the key is not of a defect."""
    digits = key.removeprefix(OF_DEFECT) if key is not None and key.startswith(OF_DEFECT) else ""
    return int(digits) if digits.isdecimal() else None


def chosen_defect(snapshot: Snapshot, key: str | None) -> Defect | None:
    """Return the defect of a review key; None if the key is not of a defect."""
    number = number_of(key)
    return snapshot.inspection.defect(number) if number is not None else None


def defect_items(snapshot: Snapshot, listing: DefectListing) -> tuple[ReviewItem, ...]:
    """Return the listed defects as review items, in list order."""
    return _listed(snapshot.inspection, listing)


def defect_item(snapshot: Snapshot, key: str | None) -> ReviewItem | None:
    """Return the review item of a defect, listed or not; None if there is no such defect."""
    defect = chosen_defect(snapshot, key)
    return _item(defect) if defect is not None else None


def on_show(defects: Iterable[Defect], listing: DefectListing, only: ReviewFilter) -> tuple[Defect, ...]:
    """Return the listed defects whose verdict matches the filter `only`."""
    return tuple(d for d in listed(defects, listing) if only in ("all", VERDICT_OF[d.judgement]))


@lru_cache(maxsize=8)
def _listed(state: InspectionState, listing: DefectListing) -> tuple[ReviewItem, ...]:
    return tuple(_item(defect) for defect in listed(state.defects, listing))


def _item(defect: Defect) -> ReviewItem:
    known = _known.get(defect.number)
    if known is None or known[0] is not defect:
        known = _known[defect.number] = defect, _made(defect)
    return known[1]


def _made(defect: Defect) -> ReviewItem:
    look, height = KINDS[defect.seen_as], value_texts(defect.height.quantity, signed=True)
    return ReviewItem(
        key=key_of(defect),
        sign=f"D{defect.number}",
        colour=look.colour,
        title=look.title,
        below=below(defect),
        value=f"<b>{size_text(defect)}</b><small>{height[0]} {height[2]}</small>",
        rows=tuple(_rows(defect)),
        judgement=Noted(key=key_of(defect), verdict=VERDICT_OF[defect.judgement], note=defect.note),
        box_um=bounds_of(defect),
        show=defect.show,
        levelling=defect.levelling,
        said=said(defect),
        defect=defect.number,
        shape=look.shape,
    )


def _rows(defect: Defect) -> Iterator[Row]:
    """Yield the measured quantities of a defect; sizes only if they are resolved."""
    yield "Height from its surroundings", *value_texts(defect.height.quantity, signed=True)
    if defect.size_resolved:
        yield "Length", *value_texts(defect.major.quantity)
        yield "Width", *value_texts(defect.minor.quantity)
        yield "Area", *value_texts(defect.area)
        yield "Volume", *value_texts(defect.volume)
