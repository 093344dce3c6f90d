"""Items under review: defects, features of a verdict and results, their order, and which of them are alike. Pure.

To add another kind of item, add a function to `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.draw.quantities import value_texts
from wafer_viewer.gui.presenters.measurement import list_text, main_label, sign_colour, symbol
from wafer_viewer.gui.presenters.results import Box, bounds_of
from wafer_viewer.gui.presenters.verdict import LOOKS, feature_summary
from wafer_viewer.gui.state.view_state import OF_DEFECT, DefectListing, ReviewFilter, View, listed
from wafer_viewer.gui.widgets.html import typeset
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.inspection.defect import Defect, Evidence
from wafer_viewer.model.inspection.defect import Judgement as DefectJudgement
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES, ClassTable
from wafer_viewer.model.inspection.learned_classes import NUISANCE
from wafer_viewer.model.job import (
    FeatureVerdict,
    Job,
    Judgement,
    Verdict,
    Word,
    key_of_result,
    keys_of_features,
)
from wafer_viewer.model.measurement.feature import on_die
from wafer_viewer.model.measurement.result_rows import title_of
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import LAYER_TITLES
from wafer_viewer.session.state.inspection_state import InspectionState
from wafer_viewer.session.state.snapshot import Snapshot

Row = tuple[str, str, str, str]
"""Name, value, U, unit."""
EVERYTHING = DefectListing()
GRAVEST: tuple[Word, ...] = ("fail", "inconclusive", "no verdict", "pass")
"""Verdicts in order of review, the worst first."""
VERDICT_LOOKS = {
    "open": (viser.Icon.CIRCLE_DASHED, "ink3"),
    "accepted": (viser.Icon.CIRCLE_CHECK, "good"),
    "rejected": (viser.Icon.CIRCLE_X, "fault"),
}
VERDICT_OF: dict[DefectJudgement, Verdict] = {"open": "open", "real": "accepted", "nuisance": "rejected"}
JUDGEMENT_OF: dict[Verdict, DefectJudgement] = {verdict: judgement for judgement, verdict in VERDICT_OF.items()}
"""Defect judgement by review verdict: an accepted defect is real."""
JUDGED: dict[Verdict, str] = {"open": "open", "accepted": "real defect", "rejected": "not a defect"}
SEEN: dict[Evidence, str] = {"height": "heights", "picture": "picture only", "both": "heights and picture"}


@dataclass(frozen=True, slots=True)
class ReviewItem:
    """Item to judge: symbol, position, quantities, verdict of the instrument, judgement of the user.

    value: HTML for the list. show: surface of the measurement; number: number of the result, defect: that of the
    defect, None for others. word: verdict of the instrument, None if there is none; reason: its reason.
    """

    key: str
    sign: str
    colour: str
    title: str
    below: str
    value: str
    rows: tuple[Row, ...]
    judgement: Judgement
    box_um: Box | None = None
    show: int = 0
    levelling: Levelling = Levelling()
    number: int | None = None
    word: Word | None = None
    reason: str = ""
    defect: int | None = None
    shape: str = "disc"
    evidence: Evidence = "height"

    @property
    def is_open(self) -> bool:
        """True if nobody has judged it."""
        return self.judgement.verdict == "open"

    @property
    def judged_as(self) -> str:
        """Judgement of the user in words."""
        verdict = self.judgement.verdict
        return verdict if self.defect is None else JUDGED[verdict]

    @property
    def verdict_text(self) -> str:
        """Verdict of the instrument, if any, and judgement of the user, as text."""
        return self.judged_as if self.word is None else f"{LOOKS[self.word][0]}, {self.judged_as}"


def review_items(
    snapshot: Snapshot, only: ReviewFilter = "all", listing: DefectListing = EVERYTHING
) -> tuple[ReviewItem, ...]:
    """Return the items under review whose verdict matches the filter `only`; defects in list order."""
    items = (item for source in SOURCES for item in source(snapshot, listing))
    return tuple(item for item in items if only in ("all", item.judgement.verdict))


def chosen_item(snapshot: Snapshot, view: View) -> ReviewItem | None:
    """Return the item of a view; the first item if its key is None or unknown; None without items."""
    return item_at(snapshot, view.review) or next(iter(review_items(snapshot, "all", view.defects)), None)


def item_at(snapshot: Snapshot, key: str | None) -> ReviewItem | None:
    """Return the item of a key, listed or not; None if there is none."""
    if (defect := chosen_defect(snapshot, key)) is not None:
        return item_of(defect, classes_of(snapshot.inspection))
    return next((item for item in review_items(snapshot) if item.key == key), None)


def neighbour(snapshot: Snapshot, view: View, by: int) -> ReviewItem | None:
    """Return the next open item, or with negative `by` the previous item; wraps around the ends.

    Without another open item, return the next of the items that match the filter of the view; None without any.
    """
    items, only = review_items(snapshot, "all", view.defects), view.review_filter
    now = view.review or next((item.key for item in items), None)
    index = next((k for k, item in enumerate(items) if item.key == now), -1 if by > 0 else 0)
    round_trip = (items[(index + by * n) % len(items)] for n in range(1, len(items) + 1))
    ahead = [item for item in round_trip if only in ("all", item.judgement.verdict)]
    still_open = (item for item in ahead if by > 0 and item.key != now and item.is_open)
    return next(still_open, next(iter(ahead), None))


def alike(snapshot: Snapshot, view: View) -> tuple[int, ...]:
    """Return the defects that a command for all alike refers to: the marked ones, else open ones of the same class.

    Of those only listed ones, and the one under review.
    """
    if view.marked:
        return tuple(number for number in view.marked if snapshot.inspection.defect(number) is not None)
    if (now := chosen_defect(snapshot, view.review)) is None:
        return ()
    others = on_show(snapshot.inspection.defects, view.defects, view.review_filter)
    same = (d.number for d in others if d.seen_as == now.seen_as and d.judgement == "open" and d.number != now.number)
    return (now.number, *same)


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


def on_show(defects: Iterable[Defect], listing: DefectListing, only: ReviewFilter) -> tuple[Defect, ...]:
    """Return the listed defects whose verdict matches the filter `only`."""
    return tuple(d for d in listed(defects, listing) if only in ("all", VERDICT_OF[d.judgement]))


def first_changed(before: Snapshot, after: Snapshot) -> str | None:
    """Return the key of the first item whose judgement differs between two states; None if none differs."""
    old = {item.key: (item.judgement, item.title) for item in review_items(before)}
    items = (item for item in review_items(after) if old.get(item.key) not in (None, (item.judgement, item.title)))
    return next((item.key for item in items), None)


# -------------------------------------------------------------------------------------------------------------- sources


def _defects(snapshot: Snapshot, listing: DefectListing) -> tuple[ReviewItem, ...]:
    return _listed(snapshot.inspection, listing)


@lru_cache(maxsize=8)
def _listed(state: InspectionState, listing: DefectListing) -> tuple[ReviewItem, ...]:
    table = classes_of(state)
    return tuple(item_of(defect, table) for defect in listed(state.defects, listing))


_items: dict[int, tuple[Defect, ClassTable, ReviewItem]] = {}
"""Cache of review items by defect number: a judgement changes one of thousands."""


def classes_of(state: InspectionState) -> ClassTable:
    """Return the class table of the inspection, the built-in one without an inspection."""
    return state.inspection.recipe.class_table if state.inspection is not None else DEFECT_CLASSES


def item_of(defect: Defect, table: ClassTable = DEFECT_CLASSES) -> ReviewItem:
    """Return a defect as review item."""
    cached = _items.get(defect.number)
    if cached is None or cached[0] is not defect or cached[1] is not table:
        cached = _items[defect.number] = defect, table, _made(defect, table)
    return cached[2]


def _made(defect: Defect, table: ClassTable) -> ReviewItem:
    look, height = table[defect.seen_as], value_texts(defect.height.quantity, signed=True)
    return ReviewItem(
        key=key_of(defect),
        sign=f"D{defect.number}",
        colour=look.colour,
        title=look.title,
        below=_below(defect, table),
        value=Markup("<b>{}</b><small>{} {}</small>").format(_size_text(defect), height[0], height[2]),
        rows=tuple(_defect_rows(defect)),
        judgement=Judgement(key=key_of(defect), verdict=VERDICT_OF[defect.judgement], note=defect.note),
        box_um=bounds_of(defect),
        show=defect.show,
        levelling=defect.levelling,
        reason=_reason(defect),
        defect=defect.number,
        shape=look.shape,
        evidence=defect.evidence,
    )


def _size_text(defect: Defect) -> str:
    """Format the length of a defect; a dash if its size is not resolved."""
    return with_unit(defect.major.value_um, 0 if defect.major.value_um >= 100 else 1) if defect.size_resolved else "—"


def _below(defect: Defect, table: ClassTable) -> str:
    """Describe die, position and proposed class of a defect."""
    where = typeset(f"Die {defect.die}") if defect.die else "Outside of the dies"
    place = f"x {number(defect.center.x_um, 1)}, y {with_unit(defect.center.y_um, 1)}"
    proposed = f"proposed: {table[defect.kind].title.lower()}"
    by = proposed if defect.judged_kind is not None else f"proposed with {number(defect.confidence, 2)}"
    return f"{where} · {place} · {by}"


def learned_text(defect: Defect, table: ClassTable) -> str:
    """Return the class that judgements propose with its share of the votes; empty without one, or once judged."""
    if defect.learned is None or defect.judgement != "open":
        return ""
    kind = defect.learned.kind
    title = JUDGED["rejected"] if kind == NUISANCE else table[kind].title.lower()
    return f"{title}, {100 * defect.learned.share:.0f} % of the votes"


def _reason(defect: Defect) -> str:
    """Describe evidence, score and reasons of detection and classification."""
    repeats = ("on every die: compare with a golden die",) if defect.repeats else ()
    small = () if defect.size_resolved else ("detected, size not resolved",)
    score = f"{number(defect.score, 1)} times the local noise"
    return " · ".join((f"Seen in {SEEN[defect.evidence]}", score, *small, *repeats, *defect.reasons))


def _defect_rows(defect: Defect) -> Iterator[Row]:
    """Yield the measured quantities of a defect; sizes only if they are resolved."""
    yield "Height from its surroundings", *value_texts(defect.height.quantity, signed=True)
    if defect.size_resolved:
        yield "Length", *value_texts(defect.major.quantity)
        yield "Width", *value_texts(defect.minor.quantity)
        yield "Area", *value_texts(defect.area)
        yield "Volume", *value_texts(defect.volume)


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
            rows=tuple(_result_rows(finding)),
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


SOURCES: tuple[Callable[[Snapshot, DefectListing], Iterable[ReviewItem]], ...] = (_defects, _features, _results)


def _kind(finding: AnyResult) -> str:
    titles = {tool: made.title for tool, made in TOOLS.items()}
    tag = {"step_height": "step"}.get(str(finding.__struct_config__.tag), str(finding.__struct_config__.tag))
    words = (titles.get(tag, tag.replace("_", " ").capitalize()), main_label(finding), LAYER_TITLES[finding.surface])
    return " · ".join(word for word in words if word)


def _result_rows(finding: AnyResult) -> Iterator[Row]:
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
