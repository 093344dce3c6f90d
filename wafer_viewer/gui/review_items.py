"""What is under review: the features of a job's verdict, the gravest first, and results, all as one kind of item.

Another kind of thing to be judged, such as a defect, joins by a function in `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import viser

from wafer_viewer.gui.kept_places import Box, bounds_of
from wafer_viewer.gui.measure_words import letter, list_text, of_what, sign_colour, value_texts
from wafer_viewer.gui.verdict_words import LOOKS, in_short
from wafer_viewer.gui.view import ReviewFilter
from wafer_viewer.model.alignment import Alignment
from wafer_viewer.model.feature import on_die
from wafer_viewer.model.findings import AnyFinding
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.levelling import Levelling
from wafer_viewer.model.measuring import TOOLS
from wafer_viewer.model.notebook import Judgement, key_of_result, keys_of_features
from wafer_viewer.model.plan import Job
from wafer_viewer.model.quantities import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.verdict import Judged, Word
from wafer_viewer.session.state import Snapshot

Row = tuple[str, str, str, str]
"""Name, value, U, unit."""
VERDICTS = {"open": "open", "accepted": "accepted", "rejected": "rejected"}
VERDICT_LOOKS = {
    "open": (viser.Icon.CIRCLE_DASHED, "ink3"),
    "accepted": (viser.Icon.CIRCLE_CHECK, "good"),
    "rejected": (viser.Icon.CIRCLE_X, "fault"),
}
"""Sign and colour of each judgement; its word stands beside them."""
FILTERS: tuple[tuple[ReviewFilter, str], ...] = (("all", "All"), ("open", "Open"), ("rejected", "Rejected"))
GRAVEST: tuple[Word, ...] = ("fail", "inconclusive", "no verdict", "pass")
"""What a person has to look at first."""
_QUANTITIES = {
    "pt": "Pt",
    "flt_t": "FLTt",
    "flt_t_minimum_zone": "FLTt, minimum zone",
    "flt_q": "FLTq",
    "dz": "Δz",
    "deviation": "Error",
    "reference": "Certificate",
}


@dataclass(frozen=True, slots=True)
class ReviewItem:
    """One thing to be judged: its sign, where it is, its numbers, what the instrument says, what people say.

    value: what the list shows, HTML. show: the surface it was measured on; number: of the result it is, if it is one.
    word: what the instrument says of it, and `said` why; None where it says nothing.
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
    said: str = ""

    @property
    def told(self) -> str:
        """What the instrument says and what people say of it, in words."""
        people = VERDICTS[self.judgement.verdict]
        return people if self.word is None else f"{LOOKS[self.word][0]}, {people}"


def review_items(snapshot: Snapshot, only: ReviewFilter = "all") -> tuple[ReviewItem, ...]:
    """Everything under review, of which `only` what is still open, or was rejected."""
    items = tuple(item for source in SOURCES for item in source(snapshot))
    return items if only == "all" else tuple(item for item in items if item.judgement.verdict == only)


def chosen_item(snapshot: Snapshot, key: str | None) -> ReviewItem | None:
    """The item of a key; the first one where none was chosen or it is gone."""
    items = review_items(snapshot)
    return next((item for item in items if item.key == key), items[0] if items else None)


def neighbour(snapshot: Snapshot, key: str | None, by: int, only: ReviewFilter = "all") -> ReviewItem | None:
    """Where one goes from the item of a key, round the ends of the list: on, to the next that is open, or back by one.

    Where no other is open one goes on to the next of those listed, which are `only` some of all.
    """
    items, listed = review_items(snapshot), {item.key for item in review_items(snapshot, only)}
    at = next((k for k, item in enumerate(items) if item.key == key), -1 if by > 0 else 0)
    round_trip = [items[(at + by * n) % len(items)] for n in range(1, len(items) + 1)]
    ahead = [item for item in round_trip if item.key in listed]
    still_open = [item for item in ahead if by > 0 and item.key != key and item.judgement.verdict == "open"]
    return next(iter(still_open or ahead), None)


def _results(snapshot: Snapshot) -> Iterator[ReviewItem]:
    for finding in snapshot.findings:
        key = key_of_result(finding.number)
        yield ReviewItem(
            key=key,
            sign=letter(finding),
            colour=sign_colour(finding),
            title=finding.name or letter(finding),
            below=_kind(finding),
            value=list_text(finding),
            rows=tuple(_rows(finding)),
            judgement=snapshot.notebook.book.judgement(key),
            box_um=bounds_of(finding),
            show=finding.show,
            levelling=finding.levelling,
            number=finding.number,
            word=finding.verdict if isinstance(finding, GaugeCheck) else None,
            said=finding.why if isinstance(finding, GaugeCheck) else "",
        )


def _features(snapshot: Snapshot) -> Iterator[ReviewItem]:
    verdict, data = snapshot.operating.verdict, snapshot.dataset
    if verdict is None or data is None:
        return
    keyed = enumerate(zip(keys_of_features(verdict), verdict.items, strict=True), 1)
    for n, (key, judged) in sorted(keyed, key=lambda of: GRAVEST.index(of[1][1].word)):
        places = _places(judged, data.job)
        yield ReviewItem(
            key=key,
            sign=f"F{n}",
            colour="",
            title=judged.name,
            below="Feature of the released job" if verdict.released else "Feature of the job",
            value=in_short(judged),
            rows=_feature_rows(judged),
            judgement=snapshot.notebook.book.judgement(key),
            box_um=_box_on_stage(places, data.job.alignment),
            word=judged.word,
            said=judged.why,
        )


SOURCES: tuple[Callable[[Snapshot], Iterator[ReviewItem]], ...] = (_features, _results)


def _kind(finding: AnyFinding) -> str:
    titles = {tool: made.title for tool, made in TOOLS.items()}
    tag = {"step_height": "step"}.get(str(finding.__struct_config__.tag), str(finding.__struct_config__.tag))
    words = (titles.get(tag, tag.replace("_", " ").capitalize()), of_what(finding), f"{finding.surface} heights")
    return " · ".join(word for word in words if word)


def spoken(name: str) -> str:
    """A name of the program as words."""
    return name.replace("_", " ").capitalize()


def _rows(finding: AnyFinding) -> Iterator[Row]:
    for name in finding.__struct_fields__:
        held = getattr(finding, name)
        if isinstance(held, Length | Quantity):
            quantity = held.quantity if isinstance(held, Length) else held
            yield (_QUANTITIES.get(name, spoken(name)), *value_texts(quantity))


def _feature_rows(judged: Judged) -> tuple[Row, ...]:
    feature, what = judged.feature, judged.feature.quantity or TOOLS[judged.feature.tool].title
    measured = ((_QUANTITIES.get(what, spoken(what)), *value_texts(judged.measured)),) if judged.measured else ()
    named = (("Nominal", feature.nominal), ("Lower limit", feature.lower_limit), ("Upper limit", feature.upper_limit))
    given = [(name, Quantity(value=value, unit=feature.unit)) for name, value in named if value is not None]
    texts = [(name, *value_texts(quantity)) for name, quantity in given]
    return (*measured, *((name, value, "", unit) for name, value, _, unit in texts))


def _places(judged: Judged, job: Job) -> list[Region]:
    """Where a feature was measured, in wafer um."""
    dies = job.dies.all() if job.dies is not None and judged.die else ()
    die = next((die for die in dies if die.name == judged.die), None)
    return [place if die is None else on_die(place, die) for place in judged.feature.places]


def _box_on_stage(places: list[Region], alignment: Alignment | None) -> Box | None:
    """The upright rectangle on the stage round places on the wafer; None round no places."""
    boxes = [place.bounds_um for place in places]
    corners = [(x, y) for x0, y0, x1, y1 in boxes for x in (x0, x1) for y in (y0, y1)]
    if alignment is not None:
        corners = [alignment.to_stage(x, y) for x, y in corners]
    xs, ys = [x for x, _ in corners], [y for _, y in corners]
    return (min(xs), min(ys), max(xs), max(ys)) if corners else None
