"""Items under review: defects, features of a verdict and results, with their HTML. Pure.

To add another kind of item, add a function to `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from markupsafe import Markup

from wafer_viewer.draw.quantities import value_texts
from wafer_viewer.gui.presenters import verdict
from wafer_viewer.gui.presenters.defects import defect_item, defect_items
from wafer_viewer.gui.presenters.measurement import list_text, main_label, sign_colour, symbol
from wafer_viewer.gui.presenters.results import VERDICT_LOOKS, VERDICTS, Box, ReviewItem, Row, bounds_of
from wafer_viewer.gui.presenters.verdict import feature_summary
from wafer_viewer.gui.state.view_state import DefectListing, ReviewFilter, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.job import FeatureVerdict, Job, Word, key_of_result, keys_of_features
from wafer_viewer.model.measurement.feature import on_die
from wafer_viewer.model.measurement.result_rows import title_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import LAYER_TITLES
from wafer_viewer.session.state.snapshot import Snapshot

FILTERS: tuple[tuple[ReviewFilter, str], ...] = (
    ("all", "All"),
    ("open", "Open"),
    ("accepted", "Accepted"),
    ("rejected", "Rejected"),
)
EVERYTHING = DefectListing()
GRAVEST: tuple[Word, ...] = ("fail", "inconclusive", "no verdict", "pass")
"""Verdicts in order of review, the worst first."""


def review_items(
    snapshot: Snapshot, only: ReviewFilter = "all", listing: DefectListing = EVERYTHING
) -> tuple[ReviewItem, ...]:
    """Return the items under review whose verdict matches the filter `only`; defects in list order."""
    items = (item for source in SOURCES for item in source(snapshot, listing))
    return tuple(item for item in items if only in ("all", item.judgement.verdict))


def chosen_item(snapshot: Snapshot, key: str | None, listing: DefectListing = EVERYTHING) -> ReviewItem | None:
    """Return the item of a key; the first item if the key is None or unknown; None without items."""
    defect = defect_item(snapshot, key)
    if defect is not None:
        return defect
    items = review_items(snapshot, "all", listing)
    return next((item for item in items if item.key == key), items[0] if items else None)


def neighbour(
    snapshot: Snapshot,
    key: str | None,
    by: int,
    only: ReviewFilter = "all",
    listing: DefectListing = EVERYTHING,
) -> ReviewItem | None:
    """Return the next open item after `key`, or with negative `by` the previous item; wraps around the ends.

    Without another open item, return the next of the items that match the filter `only`; None without any.
    """
    items = review_items(snapshot, "all", listing)
    index = next((k for k, item in enumerate(items) if item.key == key), -1 if by > 0 else 0)
    round_trip = (items[(index + by * n) % len(items)] for n in range(1, len(items) + 1))
    ahead = [item for item in round_trip if only in ("all", item.judgement.verdict)]
    still_open = (item for item in ahead if by > 0 and item.key != key and item.judgement.verdict == "open")
    return next(still_open, next(iter(ahead), None))


def _results(snapshot: Snapshot, _: DefectListing) -> Iterator[ReviewItem]:
    for finding in snapshot.findings:
        key = key_of_result(finding.number)
        yield ReviewItem(
            key=key,
            sign=symbol(finding),
            colour=sign_colour(finding),
            title=finding.name or symbol(finding),
            below=_kind(finding),
            value=list_text(finding),
            rows=tuple(_rows(finding)),
            judgement=snapshot.notebook.book.judgement(key),
            box_um=bounds_of(finding),
            show=finding.show,
            levelling=finding.levelling,
            number=finding.number,
            word=finding.verdict if isinstance(finding, GaugeCheck) else None,
            reason=finding.why if isinstance(finding, GaugeCheck) else "",
        )


def _features(snapshot: Snapshot, _: DefectListing) -> Iterator[ReviewItem]:
    verdict, data = snapshot.operating.verdict, snapshot.dataset
    if verdict is None or data is None:
        return
    keyed = enumerate(zip(keys_of_features(verdict), verdict.items, strict=True), 1)
    for n, (key, judged) in sorted(keyed, key=lambda entry: GRAVEST.index(entry[1][1].word)):
        places = _places(judged, data.job)
        yield ReviewItem(
            key=key,
            sign=f"F{n}",
            colour="",
            title=judged.name,
            below="Feature of the released job" if verdict.released else "Feature of the job",
            value=feature_summary(judged),
            rows=_feature_rows(judged),
            judgement=snapshot.notebook.book.judgement(key),
            box_um=_box_on_stage(places, data.job.alignment),
            word=judged.word,
            reason=judged.why,
        )


SOURCES: tuple[Callable[[Snapshot, DefectListing], Iterable[ReviewItem]], ...] = (defect_items, _features, _results)


def _kind(finding: AnyResult) -> str:
    titles = {tool: made.title for tool, made in TOOLS.items()}
    tag = {"step_height": "step"}.get(str(finding.__struct_config__.tag), str(finding.__struct_config__.tag))
    words = (titles.get(tag, tag.replace("_", " ").capitalize()), main_label(finding), LAYER_TITLES[finding.surface])
    return " · ".join(word for word in words if word)


def _rows(finding: AnyResult) -> Iterator[Row]:
    for name, quantity in finding.quantities.items():
        yield (title_of(type(finding), name), *value_texts(quantity))


def _feature_rows(judged: FeatureVerdict) -> tuple[Row, ...]:
    feature, tool = judged.feature, TOOLS[judged.feature.tool]
    what = title_of(tool.result, feature.quantity) if feature.quantity else tool.title
    measured = ((what, *value_texts(judged.measured)),) if judged.measured else ()
    named = (("Nominal", feature.nominal), ("Lower limit", feature.lower_limit), ("Upper limit", feature.upper_limit))
    given = [(name, Quantity(value=value, unit=feature.unit)) for name, value in named if value is not None]
    texts = [(name, *value_texts(quantity)) for name, quantity in given]
    return (*measured, *((name, value, "", unit) for name, value, _, unit in texts))


def _places(judged: FeatureVerdict, job: Job) -> list[Region]:
    """Return the regions of a feature in wafer µm."""
    dies = job.dies.all() if job.dies is not None and judged.die else ()
    die = next((die for die in dies if die.name == judged.die), None)
    return [place if die is None else on_die(place, die) for place in judged.feature.places]


def _box_on_stage(places: list[Region], alignment: Alignment | None) -> Box | None:
    """Return the stage bounding box of regions on the wafer; None without regions."""
    boxes = [place.bounds_um for place in places]
    corners = [(x, y) for x0, y0, x1, y1 in boxes for x in (x0, x1) for y in (y0, y1)]
    if alignment is not None:
        corners = [alignment.to_stage(x, y) for x, y in corners]
    xs, ys = [x for x, _ in corners], [y for _, y in corners]
    return (min(xs), min(ys), max(xs), max(ys)) if corners else None


_NONE: dict[ReviewFilter, str] = {
    "all": "Nothing is under review.",
    "open": "Nothing is left open.",
    "accepted": "Nothing was accepted.",
    "rejected": "Nothing was rejected.",
}


def review_list(snapshot: Snapshot, view: View) -> Markup:
    """Return the list of features and results in the left panel, with the filter; empty in other steps.

    If there are defects, the filter is part of their list above.
    """
    everything = [item for item in review_items(snapshot) if item.defect is None]
    if view.step != "review" or not everything:
        return Markup()
    listed = [item for item in review_items(snapshot, view.review_filter) if item.defect is None]
    now = chosen_item(snapshot, view.review, view.defects)
    judged = sum(item.judgement.verdict != "open" for item in everything)
    rows = [_row(item, now is not None and item.key == now.key) for item in listed]
    body = html.table([], rows, "  n") if rows else html.empty(_NONE[view.review_filter])
    head = html.head("Under review", f"{judged} of {len(everything)} judged")
    over = "" if snapshot.inspection.defects else filters(view)
    return Markup('{}{}{}<div style="height:6px"></div>').format(head, over, body)


def picture(item: ReviewItem, url: str) -> Markup:
    """Return the picture of an item; a sentence if it has no position on the surface."""
    if item.box_um is None:
        return html.empty("It has no place on the surface.")
    inside = Markup('<img alt="{}" src="{}">').format(item.title, url) if url else Markup()
    return Markup('<div class="wv-review-picture">{}</div>').format(inside)


def numbers(item: ReviewItem) -> Markup:
    """Return all quantities of an item with their U, and the verdict with its reason."""
    rows = [html.row(row, " nn") for row in item.rows]
    word = verdict.state(item.word) + " · " if item.word is not None else Markup()
    reason = word + html.with_micro_sign(item.reason)
    below = Markup('<div class="wv-sub" style="margin-top:6px">{}</div>').format(reason) if reason else Markup()
    table = html.table(["", "Value", "± U, 95 %", ""], rows, " nn") if rows else ""
    return html.head("Numbers") + table + below


def progress(items: tuple[ReviewItem, ...]) -> Markup:
    """Describe the progress of the review."""
    n_open = sum(item.judgement.verdict == "open" for item in items)
    rejected = sum(item.judgement.verdict == "rejected" for item in items)
    text = f"{n_open} still open" if n_open else "Everything is judged"
    on = "Page Down goes to the next open one" if n_open else "Page Down continues"
    return Markup('<div class="wv-why">{}{} · {}</div>').format(text, f" · {rejected} rejected" if rejected else "", on)


def _row(item: ReviewItem, chosen: bool) -> Markup:
    sign, colour = VERDICT_LOOKS[item.judgement.verdict]
    state = Markup("<small>{}</small>").format(verdict.state(item.word)) if item.word is not None else Markup()
    name = Markup(
        '<span class="wv-cut wv-short" title="{title}">{title}</span>'
        "{state}<small style='color:var(--{colour})'>{icon} {verdicts}</small>"
    ).format(
        title=item.title,
        state=state,
        colour=colour,
        icon=html.icon(sign, 14),
        verdicts=VERDICTS[item.judgement.verdict],
    )
    attributes = Markup('{} aria-label="{}"').format(
        html.pick("review", item.key), f"{item.title}, {item.verdict_text}"
    )
    return html.row([html.chip(item.sign, item.colour), name, item.value], "  n", attributes, "sel" if chosen else "")


def filters(view: View) -> Markup:
    """Return the filter buttons."""
    chosen = view.review_filter
    buttons = Markup("").join(
        Markup('<span class="{key}" aria-pressed="{aria_pressed}" {pick}>{name}</span>').format(
            key="on" if key == chosen else "",
            aria_pressed=str(key == chosen).lower(),
            pick=html.pick("review-filter", key),
            name=name,
        )
        for key, name in FILTERS
    )
    return Markup('<div class="wv-segments">{}</div>').format(buttons)
