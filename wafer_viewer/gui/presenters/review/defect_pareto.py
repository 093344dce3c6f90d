"""HTML of the Pareto chart of defect classes, the most frequent first; a click filters the list by class.

In a low window the style sheet reduces the bars to text, so that the list stays visible.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.charts.pareto import Bar, pareto
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.presenters.review.defect_items import on_show
from wafer_viewer.gui.presenters.review.defects import sign_of
from wafer_viewer.gui.state.defect_list_state import DefectListing
from wafer_viewer.gui.state.view_state import ReviewFilter
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.inspection.defect import Defect, DefectClass
from wafer_viewer.session.state.inspection_state import InspectionState


def chart_of(state: InspectionState, listing: DefectListing, only: ReviewFilter) -> str:
    """Return the chart of the listed defects, with all classes; cached."""
    return _chart(state, replace(listing, sort="size", map_by="class"), only)


@lru_cache(maxsize=8)
def _chart(state: InspectionState, listing: DefectListing, only: ReviewFilter) -> str:
    return pareto_html(on_show(state.defects, replace(listing, kind=""), only), listing.kind)


def pareto_html(defects: Iterable[Defect], chosen: str) -> str:
    """Return the Pareto chart; the operator's class overrides the proposed one, `chosen` is the filtered class.

    Unmeasured areas are no defects and have no share.
    """
    kinds: list[DefectClass] = [defect.seen_as for defect in defects]
    found: list[DefectClass] = [kind for kind in kinds if kind != "unmeasured"]
    bars = pareto(found)
    rows = [_row(bar.kind, bar.count, chosen, _bar(bar), f"{number(100 * bar.cumulated, 0)} %") for bar in bars]
    if (unmeasured := kinds.count("unmeasured")) > 0:
        rows.append(_row("unmeasured", unmeasured, chosen, "<i></i>", ""))
    head = '<div class="wv-pareto-head"><span>Class</span><span>Share</span><span>n</span><span>Sum</span></div>'
    return f'<div class="wv-pareto" aria-label="Classes">{head}{"".join(rows)}</div>' if rows else ""


def _row(kind: DefectClass, n: int, chosen: str, bar: str, cumulated: str) -> str:
    on = kind == chosen
    return (
        f'<span class="{"on" if on else ""}" aria-pressed="{str(on).lower()}" {html.pick("defect-kind", kind)}>'
        f"<span>{sign_of(kind)} {KINDS[kind].title}</span>{bar}<b>{number(n, 0)}</b><small>{cumulated}</small></span>"
    )


def _bar(bar: Bar) -> str:
    """Return the bar with the share of a class, and in a paler colour the cumulative share."""
    told = f"{number(100 * bar.share, 0)} % of all, {number(100 * bar.cumulated, 0)} % with those above"
    return (
        f'<i title="{told}"><i style="width:{100 * bar.cumulated:.1f}%"></i>'
        f'<i style="width:{100 * bar.share:.1f}%;background:{KINDS[bar.kind].colour}"></i></i>'
    )
