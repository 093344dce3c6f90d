"""The defects in the left panel: search form, warnings, classes, filters, and the list with thumbnails."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import symbol_svg
from wafer_viewer.draw.charts.defect_charts import Bar, pareto
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.elements.elements import Dropdown, Elements, Html, Stack
from wafer_viewer.gui.elements.form import form
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.preconditions import no_defects
from wafer_viewer.gui.presenters import verdict as words
from wafer_viewer.gui.presenters.results import Box
from wafer_viewer.gui.presenters.review import (
    VERDICT_LOOKS,
    ReviewItem,
    chosen_defect,
    chosen_item,
    classes_of,
    on_show,
    review_items,
)
from wafer_viewer.gui.scenes.thumbnails import Thumbnails, defect_request, thumbnail
from wafer_viewer.gui.state.view_state import FILTERED, SORTS, DefectListing, ReviewFilter, View
from wafer_viewer.gui.steps.review.defect_form import per_mm2, verdict
from wafer_viewer.gui.steps.review.dialogs import (
    ERRANDS,
    STAYS,
    area_of_defect,
    earlier_html,
    excluded_dialog,
    list_added,
    overlay_html,
    place_of_other,
    recipes_dialog,
)
from wafer_viewer.gui.steps.review.inspection_form import PICKS, InspectionDraft, inspect_by_form, inspection_form, save
from wafer_viewer.gui.steps.review.judging import Review
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.model.inspection.defect import FORM_SEES, REFERENCES, Defect, Inspection, verdict_of
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES, ClassTable, DefectClassEntry
from wafer_viewer.model.inspection.lot import WaferComparison
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace, settings_of
from wafer_viewer.session.state.inspection_state import InspectionState, OtherTool
from wafer_viewer.session.state.snapshot import Snapshot

FILTERS: tuple[tuple[ReviewFilter, str], ...] = (
    ("all", "All"),
    ("open", "Open"),
    ("accepted", "Accepted"),
    ("rejected", "Rejected"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DefectsState(InspectionDraft):
    """State of the search form, and what the list needs. fly: moves the camera to a box."""

    review: Review
    thumbnails: Thumbnails
    fly: Callable[[Box], object]
    shows_filter: bool = False


def defect_list(here: Here[DefectsState]) -> Elements | None:
    """Return the section; the search form is unfolded until the surface has been inspected."""
    snapshot, view, state = here.snapshot, here.view, here.snapshot.inspection
    if view.step != "review" or snapshot.surface is None:
        return None
    if state.work and here.own.unfolded:
        here.own = replace(here.own, unfolded=False)
    inspection, other, earlier = state.inspection, snapshot.defect_files.other, snapshot.defect_files.earlier
    limits = verdict(inspection) if inspection is not None else Markup()
    listed = inspection is not None and bool(inspection.defects)
    return [
        Html(_top(here) + summary(state) + limits),
        Stack(inspection_form(here) or []),
        Html(_command_links() if inspection is not None else ""),
        Html(_overlay(other, state) if other is not None else ""),
        Html(earlier_html(earlier) if earlier is not None else ""),
        Html(_choices(state, view) if listed else ""),
        Stack(_filters(here)) if listed and here.own.shows_filter else None,
        Html(_rows(here, inspection) + facts(inspection) if inspection is not None else ""),
    ]


def section_commands(here: Here[DefectsState]) -> list[Command]:
    """Return the palette commands that inspect, sort and export defects."""
    icon, page = viser.Icon, here.page

    def command(name: str, act: Callable[[], object], sign: Any) -> Command:
        return Command(name, None, act, sign, group="Review")

    return with_precondition(
        no_defects,
        command("Search for defects…", lambda: unfold(here), icon.SEARCH),
        command("Save the recipe for defects…", lambda: save(here), icon.DEVICE_FLOPPY),
        command("Excluded areas…", lambda: edit_excluded_areas(here), icon.CROP),
        command("Exclude this place…", lambda: edit_excluded_areas(here, proposed=True), icon.CROP),
        command("Recipes for defects…", lambda: recipes_dialog(page), icon.LIST),
        *(command(errand.name, partial(_run, here, key), errand.icon) for key, errand in ERRANDS.items()),
        *(
            command(f"Defects by {name.lower()}", partial(here.own.review.list_by, sort=sort), icon.SORT_DESCENDING)
            for sort, (name, _) in SORTS.items()
        ),
    )


def unfold(here: Here[DefectsState]) -> None:
    """Unfold or fold the form."""
    here.page.change(step="review")
    here.keep(unfolded=not here.own.unfolded)


def edit_excluded_areas(here: Here[DefectsState], *, proposed: bool = False) -> None:
    """Open the dialog of areas to exclude on every die; the form then shows them, next to the button that inspects.

    proposed: with the area of the defect under review.
    """
    page = here.page
    area = area_of_defect(chosen_defect(page.session.snapshot, page.view.review)) if proposed else ()

    def keep(areas: tuple[Region, ...]) -> None:
        here.put("form.excluded", areas)
        here.keep(unfolded=True)

    guarded(page, STAYS)(excluded_dialog)(page, here.own.form.excluded, keep, area)


def _run(here: Here[DefectsState], errand: str) -> None:
    """Open the dialog of one of the commands on all defects."""
    dialog = ERRANDS[errand]
    guarded(here.page, dialog.failed)(dialog.ask)(here.page)


def _go_to_other(here: Here[DefectsState], other_number: str) -> None:
    if (box := place_of_other(here.page.session.snapshot, int(other_number))) is not None:
        here.page.change(sheet="none")
        here.own.fly(box)


DEFECT_PICKS: Picks[DefectsState] = {
    **PICKS,
    "defect-form": lambda here, _: unfold(here),
    "defect-errand": _run,
    "defect-excluded": lambda here, key: edit_excluded_areas(here, proposed=key == "here"),
    "defect-by-form": lambda here, _: inspect_by_form(here),
    "defect-filter": lambda here, _: here.keep(shows_filter=not here.own.shows_filter),
    "defect-sort": lambda here, sort: here.own.review.list_by(sort=sort),
    "defect-other": _go_to_other,
    "defect-added": lambda here, _: list_added(here.page),
    "defect-earlier-away": lambda here, _: here.page.ask(
        "The comparison was not removed", here.page.session.defects.files.take_earlier_away()
    ),
    "defect-other-away": lambda here, _: here.page.ask(
        "The overlay was not removed", here.page.session.defects.files.take_away()
    ),
}


def _top(here: Here[DefectsState]) -> Markup:
    state = here.snapshot.inspection
    if state.work:
        return html.head("Defects", "searching …")
    if (inspection := state.inspection) is None:
        first = html.empty("Not inspected yet:", "set the sensitivity and press Inspect.")
        return html.head("Defects") + ("" if state.problem else first)
    link = html.link("Less" if here.own.unfolded else "Inspect again…", "defect-form")
    n = sum(defect.judgement != "open" for defect in inspection.defects)
    judged = f"{n} of {len(inspection.defects)} judged" if inspection.defects else ""
    return Markup('<div class="wv-h">Defects<span class="wv-mid">{}</span><span>{}</span></div>').format(judged, link)


def _command_links() -> Markup:
    """Return the links of the commands on all defects."""
    links = [html.link(errand.short, "defect-errand", key) for key, errand in ERRANDS.items()]
    links += [html.link("Exclude…", "defect-excluded", "here"), html.link("Filter…", "defect-filter")]
    return Markup('<div class="wv-legend" style="margin:2px 0 6px">{}</div>').format(Markup("").join(links))


@lru_cache(maxsize=2)
def _overlay(other: OtherTool, state: InspectionState) -> Markup:
    """Return the section of a KLARF file; thousands of places take a tenth of a second."""
    return overlay_html(other, state.defects)


def _choices(state: InspectionState, view: View) -> Markup:
    """Return the classes, the choice of judged or open ones, and the order."""
    sorts = [(key, name) for key, (name, _) in SORTS.items()]
    return (
        chart(state, view.defects, view.review_filter)
        + html.segments("review-filter", FILTERS, view.review_filter, "Judgement")
        + html.segments("defect-sort", sorts, view.defects.sort, "Sort by")
    )


def _filters(here: Here[DefectsState]) -> Elements:
    """Return the inputs of the filters."""
    table, listing, review = classes_of(here.snapshot.inspection), here.view.defects, here.own.review
    names = {"All": ""} | {entry.title: entry.name for entry in table.values()}
    shown = next((title for title, name in names.items() if name == listing.kind), "All")
    hint = settings_of(DefectListing)["kind"].hint
    kind = Dropdown("Class", shown, lambda title: review.list_by(kind=names[title]), hint, options=tuple(names))
    return [kind, *form(listing, lambda name, value: review.list_by(**{name: value}), *FILTERED[1:])]


def alone(listing: DefectListing, inspection: Inspection, earlier: WaferComparison | None = None) -> Markup:
    """Return the active filters with a link that clears them; empty if everything is listed."""
    state = next((die.word for die in inspection.dies if die.name == listing.die), "")
    die = html.typeset(f"Die {listing.die}")
    filters = [f"{die} ({state})" if state else die] if listing.die else []
    filters += [inspection.recipe.class_table[listing.kind].title] if listing.kind else []
    of = "of one place on the dies"
    if earlier is not None and listing.numbers == earlier.added:
        of = f"added since {earlier.first}"
    filters += [f"{len(listing.numbers)} {of}"] if listing.numbers else []
    titles = {name: settings_of(DefectListing)[name].setting.title for name in FILTERED[2:]}
    limits = ((name, title, getattr(listing, name)) for name, title in titles.items())
    filters += [f"{title.lower()} {value:g}" for _, title, value in limits if value is not None]
    return (
        Markup('<div class="wv-lab wv-alone">{} alone · {}</div>').format(
            Markup(" · ").join(filters), html.link("all", "defect-all")
        )
        if filters
        else Markup()
    )


MOST_ROWS, ROWS_BEFORE = 16, 2
"""Rows shown at once, as thousands of pictures would be slow; rows before the item under review."""


def _rows(here: Here[DefectsState], inspection: Inspection) -> Markup:
    """Return the list, with links to the items before and after."""
    snapshot, view = here.snapshot, here.view
    if not inspection.defects:
        return nothing_found(inspection)
    items = [item for item in review_items(snapshot, view.review_filter, view.defects) if item.defect is not None]
    now = chosen_item(snapshot, view)
    shown = rows_of(items, now)
    jpegs = here.own.thumbnails.painted_all([defect_request(item, snapshot) for item in shown])
    listing = alone(view.defects, inspection, snapshot.defect_files.earlier)
    return listing + rows(items, shown, now, [thumbnail(jpeg) for jpeg in jpegs])


def rows_of(items: Sequence[ReviewItem], now: ReviewItem | None) -> Sequence[ReviewItem]:
    """Return the items to show: from shortly before the one under review, which is always visible."""
    index = next((k for k, item in enumerate(items) if now is not None and item.key == now.key), 0)
    first = max(0, index - ROWS_BEFORE)
    return items[first : first + MOST_ROWS]


def rows(
    items: Sequence[ReviewItem], shown: Sequence[ReviewItem], now: ReviewItem | None, thumbs: Sequence[str]
) -> Markup:
    """Return the rows, with links to the items before and after."""
    if not shown:
        return html.empty("No defect matches.")
    first = items.index(shown[0])
    before, after = items[:first][::-1], items[first + len(shown) :]
    body = [_row(item, now is not None and item.key == now.key, t) for item, t in zip(shown, thumbs, strict=True)]
    more = _more(before, "before") + html.table([], body, "  n") + _more(after, "more")
    return Markup('<div class="wv-defects">{}</div><div style="height:8px"></div>').format(more)


def _more(items: Sequence[ReviewItem], word: str) -> Markup:
    return html.remark(html.link(f"{len(items)} {word} …", "review", items[0].key)) if items else Markup()


def _row(item: ReviewItem, chosen: bool, thumb: str) -> Markup:
    sign, colour = VERDICT_LOOKS[item.judgement.verdict]
    where = item.below.split(" · ")[0].lower()
    tip = f"{item.sign}, {item.title}, {where}, {item.judged_as}"
    name = Markup(
        '<span class="wv-cut wv-short" title="{title}">{symbol} {title}</span>'
        '<small title="{tip}"><span style="color:var(--{colour})">{icon}</span> {sign} · {where}</small>'
    ).format(
        title=item.title,
        symbol=symbol_svg(item.shape, item.colour),
        tip=tip,
        colour=colour,
        icon=html.icon(sign, 13),
        sign=item.sign,
        where=where.removeprefix("die "),
    )
    attributes = Markup('{} aria-label="{}"').format(html.pick("review", item.key), tip)
    return html.row([thumb, name, item.value], "  n", attributes, "sel" if chosen else "")


# ------------------------------------------------------------------------------------------------ results and features


_NONE: dict[ReviewFilter, str] = {
    "all": "There is nothing to review.",
    "open": "Nothing is open.",
    "accepted": "Nothing was accepted.",
    "rejected": "Nothing was rejected.",
}


def review_list(snapshot: Snapshot, view: View) -> Markup:
    """Return the list of features and results, with the filter; empty in other steps.

    If there are defects, the filter is part of their list above.
    """
    everything = [item for item in review_items(snapshot) if item.defect is None]
    if view.step != "review" or not everything:
        return Markup()
    listed = [item for item in review_items(snapshot, view.review_filter) if item.defect is None]
    now = chosen_item(snapshot, view)
    judged = sum(not item.is_open for item in everything)
    body = [_judged_row(item, now is not None and item.key == now.key) for item in listed]
    table = html.table([], body, "  n") if body else html.empty(_NONE[view.review_filter])
    over = html.segments("review-filter", FILTERS, view.review_filter) if not snapshot.inspection.defects else ""
    head = html.head("Under review", f"{judged} of {len(everything)} judged")
    return Markup('{}{}{}<div style="height:6px"></div>').format(head, over, table)


def _judged_row(item: ReviewItem, chosen: bool) -> Markup:
    sign, colour = VERDICT_LOOKS[item.judgement.verdict]
    state = Markup("<small>{}</small>").format(words.state(item.word)) if item.word is not None else Markup()
    name = Markup(
        '<span class="wv-cut wv-short" title="{title}">{title}</span>'
        "{state}<small style='color:var(--{colour})'>{icon} {judged}</small>"
    ).format(title=item.title, state=state, colour=colour, icon=html.icon(sign, 14), judged=item.judged_as)
    label = Markup('{} aria-label="{}"').format(html.pick("review", item.key), f"{item.title}, {item.verdict_text}")
    return html.row([html.chip(item.sign, item.colour), name, item.value], "  n", label, "sel" if chosen else "")


# -------------------------------------------------------------------------------------------------------------- figures


def summary(state: InspectionState) -> str:
    """Return warnings on the inspection, as HTML: failure, outdated surface, uninspected areas."""
    inspection = state.inspection
    problem = html.note("attention", "Inspection failed", state.problem) if state.problem else ""
    if state.dies_missing:
        problem += html.remark(html.link("Compare with the fitted form", "defect-by-form") + f" {FORM_SEES}")
    if inspection is None:
        return problem
    stale = (
        html.note(
            "attention",
            "The surface has been reconstructed since",
            "Inspect again: places and heights may have changed.",
        )
        if state.stale
        else ""
    )
    told = verdict_of(inspection).word == "no verdict"  # its reasons name what was not inspected
    return problem + stale + (Markup() if told else unknown(inspection))


def facts(inspection: Inspection) -> Markup:
    """Return area, density, reference, threshold, expected false detections and notes of an inspection, as HTML."""
    return Markup("").join(
        Markup('<div class="wv-sub">{}</div>').format(html.typeset(line)) for line in _facts(inspection)
    )


def unknown(inspection: Inspection) -> Markup:
    """Return a warning on dies and areas not inspected; empty if everything was inspected."""
    blind = [die for die in inspection.dies if die.state not in ("whole", "missing")]
    causes = [f"{n} {'die' if n == 1 else 'dies'} {state}" for state, n in Counter(d.state for d in blind).items()]
    if inspection.unmeasured_mm2 > 0:
        causes.append(f"{number(inspection.unmeasured_mm2, 2)} mm² unmeasured")
    if not causes:
        return Markup()
    text = f"{', '.join(causes)}: these parts were not inspected."
    return Markup('<div class="wv-blind">{}</div>').format(html.note("attention", "Parts were not inspected", text))


def nothing_found(inspection: Inspection) -> Markup:
    """Return the placeholder of an empty defect list."""
    if inspection.inspected_mm2 <= 0:
        return html.empty("Nothing could be inspected:", "this does not mean that the wafer is clean.")
    clean = sum(die.word == "clean" for die in inspection.dies)
    dies = "the one die" if clean == 1 else f"the {clean} dies"
    where = f"on {dies} inspected whole." if clean else f"on {number(inspection.inspected_mm2, 2)} mm²."
    return html.empty("No defect was found", where)


def _facts(inspection: Inspection) -> list[str]:
    n_found, area = len(inspection.found), inspection.inspected_mm2
    density = f", {number(n_found / area, 2)} per mm²" if area > 0 else ""
    words = {True: "SIMULATED · ", False: ""}[inspection.simulated]
    return [
        f"{words}{n_found} on {number(area, 2)} mm²{density} · compared with {REFERENCES[inspection.reference]}",
        f"Over {number(inspection.threshold_sigma, 1)} times the noise; expected to be false by noise alone: "
        f"{per_mm2(inspection.expected_false_per_mm2)}",
        *((inspection.learned.words,) if inspection.learned is not None else ()),
        *inspection.notes,
    ]


def chart(state: InspectionState, listing: DefectListing, only: ReviewFilter) -> Markup:
    """Return the chart of the listed defects, with all classes; cached."""
    return _pareto(state, replace(listing, sort="size", map_by="class"), only)


@lru_cache(maxsize=8)
def _pareto(state: InspectionState, listing: DefectListing, only: ReviewFilter) -> Markup:
    return pareto_html(on_show(state.defects, replace(listing, kind=""), only), listing.kind, classes_of(state))


def pareto_html(defects: Iterable[Defect], chosen: str, table: ClassTable = DEFECT_CLASSES) -> Markup:
    """Return the Pareto chart; the operator's class overrides the proposed one, `chosen` is the filtered class.

    Unmeasured areas are no defects and have no share.
    """
    kinds = [defect.seen_as for defect in defects]
    classes = [kind for kind in kinds if kind != "unmeasured"]
    bars = pareto(classes)
    rows = [
        _class_row(look := table[bar.kind], bar.count, chosen, _bar(bar, look), f"{number(100 * bar.cumulated, 0)} %")
        for bar in bars
    ]
    if (unmeasured := kinds.count("unmeasured")) > 0:
        rows.append(_class_row(table["unmeasured"], unmeasured, chosen, Markup("<i></i>"), ""))
    head = Markup(
        '<div class="wv-pareto-head"><span>Class</span><span>Share</span><span>n</span><span>Sum</span></div>'
    )
    return (
        Markup('<div class="wv-pareto" aria-label="Classes">{}{}</div>').format(head, Markup("").join(rows))
        if rows
        else Markup()
    )


def _class_row(look: DefectClassEntry, n: int, chosen: str, bar: str, cumulated: str) -> Markup:
    on = look.name == chosen
    return Markup(
        '<span class="{on}" aria-pressed="{aria_pressed}" {pick}>'
        "<span>{sign_of} {title}</span>"
        "{bar}<b>{number}</b><small>{cumulated}</small></span>"
    ).format(
        on="on" if on else "",
        aria_pressed=str(on).lower(),
        pick=html.pick("defect-kind", look.name),
        sign_of=symbol_svg(look.shape, look.colour),
        title=look.title,
        bar=bar,
        number=number(n, 0),
        cumulated=cumulated,
    )


def _bar(bar: Bar, look: DefectClassEntry) -> Markup:
    """Return the bar with the share of a class, and in a paler colour the cumulative share."""
    title = f"{number(100 * bar.share, 0)} % of all, {number(100 * bar.cumulated, 0)} % with those above"
    return Markup(
        '<i title="{title}"><i style="width:{width:.1f}%"></i>'
        '<i style="width:{width2:.1f}%;background:{colour}"></i></i>'
    ).format(title=title, width=100 * bar.cumulated, width2=100 * bar.share, colour=look.colour)
