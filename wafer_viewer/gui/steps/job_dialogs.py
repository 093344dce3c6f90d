"""Dialogs of jobs: selection, alignment corners, features, dies, trial, release."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.dialogs.dialog import Confirm, Dialog
from wafer_viewer.gui.dialogs.file_dialog import FileDialog
from wafer_viewer.gui.elements.elements import Dropdown, Element, Elements, Html, Input, NumberPair, Stack, Text
from wafer_viewer.gui.elements.form import form, spec_input
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.results import KeptFeature, kept_features
from wafer_viewer.gui.steps.preflight_lines import lines
from wafer_viewer.gui.steps.trial import before_release, trial_is_old
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.number_field import Pair, number_of, pair_of, pair_text, text_of
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.sample import AlignmentMark, Marks
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import DecisionRule, Die, Dies, Feature, on_die
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.tools import TOOLS, ToolOptions
from wafer_viewer.model.quantity import Unit
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Setting, Spec, Within, replace, settings_of
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.planning.preflight import PreflightCheck
from wafer_viewer.session.state.snapshot import JobEntry

NOT_CHANGED, NOT_RELEASED, NOT_TRIED = "The plan was not changed", "The job was not released", "The trial failed"
ICON = viser.Icon
KEEP = "Keep"
PITCH, DIE = "Pitch, µm", "Die, µm"
MEASURED_HINT = "Typed in, or as a kept result: its tool, regions and settings"


def edit(page: Page, failed: str = NOT_CHANGED, then: Callable[[Any], None] | None = None, **changes: Any) -> None:
    """Change fields of the plan."""
    page.ask(failed, page.session.edit_job(replace(required_job(page), **changes)), then)


def required_job(page: Page) -> Job:
    """Return the plan. Raises PlanError if there is none."""
    if (job := page.session.snapshot.draft.job) is None:
        raise PlanError("There is no plan yet: lay a field grid over the sample first.")
    return job


# --------------------------------------------------------------------------------------------------- jobs and the start


def jobs_dialog(page: Page) -> None:
    """Open the dialog that loads a released job."""

    def contents(here: FileDialog[None]) -> Elements:
        return [Html(job_table(here.snapshot.operating.jobs, "job-in-dialog")), *here.files()]

    def listed(here: FileDialog[None], key: str) -> None:
        here.close()
        load_job(page, Path(key))

    def typed(here: FileDialog[None]) -> None:
        if here.is_empty:
            raise PlanError("No job is chosen: click one, or its file.")
        load_job(page, here.path())

    below = f"In {page.session.snapshot.data_folder / 'jobs'}, or a file elsewhere."
    answer = Confirm("Use this job", ICON.FOLDER_OPEN, typed, "The job was not loaded")
    page.on_pick(
        "job-in-dialog",
        partial(listed, FileDialog(page, "Released jobs", below, answer, "job", None, contents, rows=5)),
    )


def load_job(page: Page, path: Path) -> None:
    """Load a released job for the next wafer."""
    page.ask("The job was not loaded", page.session.jobs.take_up(path), lambda _: page.change(everything=False))


def job_table(entries: tuple[JobEntry, ...], what: str) -> Markup:
    """Return the table of released jobs; a click on one picks `what`."""
    if not entries:
        return html.empty("No job is released yet.")

    def line(entry: JobEntry) -> Markup:
        since = Markup(' · <b style="color:var(--attention)">edited, no longer released</b>') if entry.edited else ""
        name = Markup("{}<small>revision {}{}</small>").format(entry.product, entry.revision, since)
        return html.row([name, str(entry.n_fields), str(entry.n_features)], " nn", html.command_pick(what, entry.path))

    return html.table(["Released job", "Fields", "Features"], [line(entry) for entry in entries], " nn")


def start_dialog(page: Page, checks: tuple[PreflightCheck, ...], begin: Callable[[Any], None]) -> None:
    """Ask for confirmation of the open preflight checks before the scan starts."""
    below = "The scan can start, but this needs attention:"
    listed = [Html(lines([check for check in checks if check.state != "ok"]))]
    answer = Confirm("Start", ICON.PLAYER_PLAY, begin, "The scan did not start")
    Dialog(page, "Start anyway?", below, answer, None, lambda _: listed)


# -------------------------------------------------------------------------------------------------------------- release


class _ReleaseForm(Spec, frozen=True, kw_only=True):
    product: Annotated[str, Setting("Product", "Product on the wafer, by which an operator chooses the job")]
    revision: Annotated[str, Setting("Revision", "Of the job; a released revision cannot be changed")]
    why: Annotated[str, Setting("Reason", "Recorded in the log", "not given")] = ""


def trial_dialog(page: Page) -> None:
    """Open the dialog that applies the plan to stored wafers and lists changed verdicts; nothing is released."""
    required_job(page)
    below = "Shows which verdicts would change, and why. Nothing stored is overwritten; a changed recipe takes longer."

    def contents(here: FileDialog[str]) -> Elements:
        hint = "Name of the result that is judged"
        return [*here.files(), Text("Reconstruction", here.own, here.hold, hint)]

    def begin(here: FileDialog[str]) -> Any:
        return page.session.trials.begin((here.path(),), here.own.strip() or DEFAULT_RESULT)

    title, answer, data = (
        "Try on stored wafers",
        Confirm("Try it", ICON.HISTORY, begin, NOT_TRIED),
        page.session.snapshot,
    )
    FileDialog(page, title, below, answer, "wafers", DEFAULT_RESULT, contents, rows=7, chosen=str(data.data_folder))


def release_dialog(page: Page) -> None:
    """Open the dialog that releases the plan under a product and a revision; it is then immutable."""
    job, now = required_job(page), page.session.snapshot
    below = "Operators run it in four steps. It cannot be changed afterwards; a change is a new revision."

    def fields(here: Here[_ReleaseForm]) -> Elements:
        before = before_release(now.operating, trial_is_old(now))
        return [Html(before), *form(here.own, here.put, "product", "revision", "why")]

    def release(here: Dialog[_ReleaseForm]) -> None:
        own = here.own
        why, product, revision = own.why.strip(), own.product.strip(), own.revision.strip()
        now.control.require_reason(why)
        if not (product and revision):
            raise PlanError("Product and revision both need a name: an operator chooses by them.")

        def write(_: Any) -> None:
            page.ask(NOT_RELEASED, page.session.jobs.release(why), lambda path: page.say("Released", str(path)))

        edit(page, then=write, product=product, revision=revision)

    own = _ReleaseForm(product=job.product or job.sample.product, revision=job.revision)
    Dialog(page, "Release the job", below, Confirm("Release", ICON.LOCK, release, NOT_RELEASED), own, fields)


# -------------------------------------------------------------------------------------------------------------- corners


@dataclass(frozen=True, slots=True)
class _CornersForm:
    """Marks before they are checked."""

    places: tuple[AlignmentMark, ...]
    limit_um: float


def corners_dialog(page: Page) -> None:
    """Open the dialog that names the two alignment corners of this product."""
    marks = required_job(page).marks or suggested_marks(page.session.snapshot.overview)
    below = "Corners of dies, far apart, in wafer µm: the middle of the wafer is (0, 0), its notch points down."

    def fields(here: Here[_CornersForm]) -> Elements:
        corners = (one for n in range(len(here.own.places)) for one in _corner_inputs(here, n))
        return [*corners, spec_input(Marks, "limit_um", here.own.limit_um, partial(here.put, "limit_um"))]

    def keep(here: Dialog[_CornersForm]) -> None:
        edit(page, marks=Marks(places=here.own.places, limit_um=here.own.limit_um), alignment=None)

    answer = Confirm(KEEP, ICON.CHECK, keep, "The corners were not changed")
    Dialog(page, "Alignment corners", below, answer, _CornersForm(marks.places, marks.limit_um), fields)


def _corner_inputs(here: Here[_CornersForm], n: int) -> tuple[Element, Element]:
    mark = here.own.places[n]

    def change(**changes: Any) -> None:
        places = here.own.places
        here.keep(places=(*places[:n], replace(places[n], **changes), *places[n + 1 :]))

    name_hint, at_hint = "Name that an operator finds the corner by", "Where the corner is on the wafer, µm"
    put_at = lambda at: change(x_um=at[0], y_um=at[1])  # noqa: E731 - as the other one
    return (
        Text(f"Corner {n + 1}", mark.name, lambda name: change(name=name.strip()), name_hint),
        NumberPair("x, y, µm", (mark.x_um, mark.y_um), put_at, at_hint, decimals=2),
    )


def suggested_marks(overview: Overview | None) -> Marks:
    """Return the outer lower corners of leftmost and rightmost die, nearest to y = 0; zeros for fewer than two dies."""
    dies = overview.dies_um if overview is not None else ()
    if len(dies) < 2:
        return Marks(places=(AlignmentMark(name="", x_um=0.0, y_um=0.0), AlignmentMark(name="", x_um=0.0, y_um=0.0)))
    boxes = [Region.polygon(*die).bounds_um for die in dies]
    left = min(boxes, key=lambda b: (round(b[0]), abs(b[1] + b[3])))
    right = max(boxes, key=lambda b: (round(b[2]), -abs(b[1] + b[3])))
    return Marks(
        places=(
            AlignmentMark(name="leftmost die, lower left corner", x_um=round(left[0], 1), y_um=round(left[1], 1)),
            AlignmentMark(name="rightmost die, lower right corner", x_um=round(right[2], 1), y_um=round(right[1], 1)),
        )
    )


# ----------------------------------------------------------------------------------------------------------------- dies


DIES_TEXT = (
    "A lattice in wafer µm, by the lower left corner of its first die. Those that lie within the fields are kept."
)


_AtLeastOne = Annotated[float, Within(1)]


class _DiesForm(Spec, frozen=True, kw_only=True):
    pitch: Annotated[str, Setting(PITCH, "From die to die, to the right and upwards; over 0")]
    size: Annotated[str, Setting(DIE, "Width and height of a die; over 0")]
    first_um: Annotated[
        tuple[float, float],
        Setting("First die, µm", "Lower left corner of the lowest die at the left, wafer µm", decimals=2),
    ]
    counts: Annotated[
        tuple[_AtLeastOne, _AtLeastOne], Setting("Across, up", "Number of dies side by side, and above each other")
    ]


def dies_dialog(page: Page) -> None:
    """Open the dialog that defines the lattice of dies; dies outside of the scanned fields are dropped."""
    job = required_job(page)
    start = lattice_of(job.dies) if job.dies is not None else suggested_dies(page.session.snapshot.overview)

    def keep(here: Dialog[_DiesForm]) -> None:
        edit(page, dies=within_fields(_lattice_of_form(here.own), required_job(page)))

    own = _DiesForm(
        pitch=pair_text(_given(start.pitch_x_um, start.pitch_y_um)),
        size=pair_text(_given(start.width_um, start.height_um)),
        first_um=(start.x0_um, start.y0_um),
        counts=(start.cols, start.rows),
    )
    Dialog(page, "Dies", DIES_TEXT, Confirm(KEEP, ICON.CHECK, keep, "The dies were not changed"), own)


def _lattice_of_form(own: _DiesForm) -> Dies:
    """Return the lattice of the form. Raises WaferViewerError if it is incomplete."""
    steps, given = pair_of(own.pitch, PITCH, over=0), pair_of(own.size, DIE, over=0)
    sides = given or steps
    if sides is None:
        raise PlanError("Die and pitch are not given: type at least one of them, such as 300 × 200.")
    if steps is None and own.counts != (1, 1):
        raise PlanError("The pitch of the dies is not given: type it, or 1 across and 1 up for a single die.")
    return Dies(
        width_um=sides[0],
        height_um=sides[1],
        rows=int(own.counts[1]),
        cols=int(own.counts[0]),
        pitch_x_um=steps[0] if steps is not None else 0.0,
        pitch_y_um=steps[1] if steps is not None else 0.0,
        x0_um=own.first_um[0],
        y0_um=own.first_um[1],
    )


def _given(x_um: float, y_um: float) -> Pair | None:
    """Return a pair for the input; a 0 (single row or column) takes the other value; None if both are 0."""
    return (x_um or y_um, y_um or x_um) if x_um or y_um else None


def within_fields(lattice: Dies, job: Job) -> Dies:
    """Return the dies of a lattice whose corners and centre lie within fields. Raises PlanError if there are none."""
    if job.grid is None:
        return lattice
    fields = [_box(f.x_um, f.y_um, job.grid.field_width_um, job.grid.field_height_um) for f in job.grid.fields()]
    listed = tuple(die for die in lattice.all() if all(_in_any(x, y, fields) for x, y in _places(die, lattice)))
    if not listed:
        raise PlanError(
            "No die of this lattice lies within the fields of the plan: correct the lattice, or add fields."
        )
    return Dies(width_um=lattice.width_um, height_um=lattice.height_um, listed=listed)


def lattice_of(dies: Dies) -> Dies:
    """Return dies as a lattice: as entered, or derived from the listed dies."""
    return dies if not dies.listed else _lattice([(d.x_um, d.y_um) for d in dies.listed], dies.width_um, dies.height_um)


def suggested_dies(overview: Overview | None) -> Dies:
    """Return the lattice of the dies in the overview; a single die of zero size if there are none."""
    boxes = [Region.polygon(*die).bounds_um for die in (overview.dies_um if overview is not None else ())]
    if not boxes:
        return Dies(width_um=0.0, height_um=0.0, rows=1, cols=1)
    x0, y0, x1, y1 = boxes[0]
    return _lattice([box[:2] for box in boxes], x1 - x0, y1 - y0)


def relative_to_die(places: tuple[Region, ...], dies: Dies) -> tuple[Region, ...]:
    """Return regions in wafer µm relative to the corner of their die. Raises PlanError if they lie on no die."""
    boxes = [place.bounds_um for place in places]
    x_um = (min(box[0] for box in boxes) + max(box[2] for box in boxes)) / 2
    y_um = (min(box[1] for box in boxes) + max(box[3] for box in boxes)) / 2
    for die in dies.all():
        if 0 <= x_um - die.x_um <= dies.width_um and 0 <= y_um - die.y_um <= dies.height_um:
            back = Die(name=die.name, x_um=-die.x_um, y_um=-die.y_um)
            return tuple(on_die(place, back) for place in places)
    raise PlanError("The places lie on no die: choose a result that was measured on one, or correct the dies.")


def _lattice(corners: list[tuple[float, float]], width_um: float, height_um: float) -> Dies:
    xs, ys = (sorted({round(corner[k], 1) for corner in corners}) for k in (0, 1))
    pitch_x, pitch_y = ((values[1] - values[0]) if len(values) > 1 else 0.0 for values in (xs, ys))
    return Dies(
        width_um=round(width_um, 1),
        height_um=round(height_um, 1),
        rows=len(ys),
        cols=len(xs),
        pitch_x_um=round(pitch_x, 1),
        pitch_y_um=round(pitch_y, 1),
        x0_um=xs[0],
        y0_um=ys[0],
    )


def _places(die: Die, lattice: Dies) -> Iterator[tuple[float, float]]:
    """Yield the corners of a die and its centre."""
    for across, up in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 0.5)):
        yield die.x_um + across * lattice.width_um, die.y_um + up * lattice.height_um


def _box(x_um: float, y_um: float, width_um: float, height_um: float) -> tuple[float, float, float, float]:
    return x_um - width_um / 2, y_um - height_um / 2, x_um + width_um / 2, y_um + height_um / 2


def _in_any(x_um: float, y_um: float, boxes: list[tuple[float, float, float, float]]) -> bool:
    return any(x0 <= x_um <= x1 and y0 <= y_um <= y1 for x0, y0, x1, y1 in boxes)


# -------------------------------------------------------------------------------------------------------------- feature


BY_HAND, AS_BEFORE, MAIN = "as typed below", "as before", "the main one"
STAYS = "The feature was not changed"
FEATURE_TEXT = "A step height as typed below, or any result kept on the surface shown, with the limits of a good wafer."
_NUMBERS = ("nominal", "lower_limit", "upper_limit")
_CORNERS = ("Upper, µm", "– to, µm", "Lower, µm", "– to, µm")
"""Labels of opposite corners of the two regions of a step."""


@dataclass(frozen=True, slots=True)
class FeatureForm:
    """Feature under construction; a chosen kept result sets tool, regions and quantity.

    source: name of the kept result. corners: of the regions of a step.
    """

    source: str = BY_HAND
    name: str = ""
    tool: ToolName = "step"
    quantity: str = MAIN
    unit: Unit = "um"
    nominal: str = ""
    lower_limit: str = ""
    upper_limit: str = ""
    decision_rule: DecisionRule = "guard_band"
    per_die: bool = False
    places: tuple[Region, ...] = ()
    options: ToolOptions | None = None
    corners: tuple[Pair, ...] = ((0.0, 0.0),) * len(_CORNERS)

    @classmethod
    def of(cls, old: Feature | None) -> FeatureForm:
        """Return the form of a feature; an empty one without a feature."""
        if old is None:
            return cls()
        same = ("name", "tool", "unit", "decision_rule", "per_die", "places", "options")
        numbers = {name: text_of(getattr(old, name)) for name in _NUMBERS}
        form = cls(AS_BEFORE, quantity=old.quantity or MAIN, **numbers, **{name: getattr(old, name) for name in same})
        return form if old.tool != "step" or not old.places else replace(form, corners=_corners(old.places))

    @property
    def field(self) -> str:
        """Name of the quantity in the result; empty for the main one."""
        return "" if self.quantity == MAIN else self.quantity

    def with_result(self, chosen: KeptFeature) -> FeatureForm:
        """Return the form with the tool, the regions and the options of a kept result."""
        corners = _corners(chosen.places, 1) if chosen.tool == "step" else self.corners
        return replace(self, tool=chosen.tool, places=chosen.places, options=chosen.options, corners=corners)

    def with_quantity(self, chosen: KeptFeature) -> FeatureForm:
        """Return the form with the unit of its quantity, and its value as the nominal value."""
        quantity = self.quantity if self.quantity in chosen.quantities else MAIN
        form = replace(self, quantity=quantity, unit=chosen.unit("" if quantity == MAIN else quantity))
        return replace(form, nominal=text_of(round(chosen.value(form.field), 2)))


def feature_dialog(page: Page, n: int | None = None) -> None:
    """Open the dialog of a feature. n: index of the job's feature to change; None for a new one."""
    job, stored = required_job(page), kept_features(page.session.snapshot)
    old = job.features[n] if n is not None else None

    def keep(here: Dialog[FeatureForm]) -> None:
        own = here.own
        features = required_job(page).features
        places = _required_places(own, job.dies, counted=old is not None and old.per_die and own.source not in stored)
        made = feature_of(own, places, f"{TOOLS[own.tool].title} {len(features) + 1}")
        edit(page, features=(*features, made) if n is None else (*features[:n], made, *features[n + 1 :]))

    inputs = partial(_feature_inputs, stored=stored, first=AS_BEFORE if old else BY_HAND, dies=job.dies)
    Dialog(page, "Feature", FEATURE_TEXT, Confirm(KEEP, ICON.CHECK, keep, STAYS), FeatureForm.of(old), inputs)


def _feature_inputs(
    here: Here[FeatureForm], *, stored: dict[str, KeptFeature], first: str, dies: Dies | None
) -> Elements:
    """Return the inputs; regions last, so that the dropdowns above open over them and not over the buttons."""
    own, chosen = here.own, stored.get(here.own.source)
    settings = settings_of(Feature)

    def take(source: str) -> None:
        form, result = replace(here.own, source=source), stored.get(source)
        here.hold(form if result is None else form.with_result(result).with_quantity(result))

    def take_quantity(quantity: str) -> None:
        form, result = replace(here.own, quantity=quantity), stored.get(here.own.source)
        here.hold(form if result is None else form.with_quantity(result))

    def field(name: str, **state: Any) -> Input:
        return spec_input(Feature, name, getattr(own, name), partial(here.put, name), **state)

    def optional(name: str) -> Text:
        setting = settings[name].setting
        hint = f"{setting.about}; empty: {setting.empty}"
        return Text(setting.title, getattr(own, name), partial(here.put, name), hint)

    quantities = (MAIN, *chosen.quantities) if chosen is not None else (own.quantity,)
    words = html.typeset(f"{TOOLS[own.tool].title}; its limits are in {own.unit}.")
    return [
        field("name"),
        Dropdown("Measured as", own.source, take, MEASURED_HINT, options=(first, *stored)),
        Dropdown("Quantity", own.quantity, take_quantity, "Number of the result that is judged", options=quantities),
        Html(html.remark(words)),
        optional("nominal"),
        Stack([optional("lower_limit"), optional("upper_limit")], side_by_side=True),
        field("decision_rule"),
        *(_corner_of_region(here, k) for k in range(len(_CORNERS)) if own.tool == "step"),
        field("per_die", disabled=dies is None),
    ]


def _corner_of_region(here: Here[FeatureForm], k: int) -> NumberPair:
    def put(at: Pair) -> None:
        corners = here.own.corners
        here.keep(corners=(*corners[:k], at, *corners[k + 1 :]))

    hint = "The opposite corner, µm" if k % 2 else "A corner of the region, µm"
    return NumberPair(_CORNERS[k], here.own.corners[k], put, hint, step=0.5, decimals=2)


def feature_of(own: FeatureForm, places: tuple[Region, ...], unnamed: str) -> Feature:
    """Return the feature of a form. Raises WaferViewerError if it is invalid."""
    settings = settings_of(Feature)
    numbers = {name: number_of(getattr(own, name), settings[name].setting.title) for name in _NUMBERS}
    return Feature(
        name=own.name.strip() or unnamed,
        tool=own.tool,
        quantity=own.field,
        unit=own.unit,
        decision_rule=own.decision_rule,
        per_die=own.per_die,
        places=places,
        options=own.options,
        **numbers,
    )


def _required_places(own: FeatureForm, dies: Dies | None, *, counted: bool) -> tuple[Region, ...]:
    """Return the regions on the wafer or relative to a die's corner; convert them only if that choice changed.

    counted: they are relative to a die already.
    """
    ends = own.corners
    steps = Region.rectangle(*ends[0], *ends[1]), Region.rectangle(*ends[2], *ends[3])
    places = steps if own.tool == "step" else own.places
    if not places:
        raise PlanError("The feature has no regions: choose a kept result.")
    if dies is None or own.per_die == counted:
        return places
    if counted:
        return tuple(on_die(place, dies.all()[0]) for place in places)
    return relative_to_die(places, dies)


def _corners(places: tuple[Region, ...], digits: int = 6) -> tuple[Pair, ...]:
    """Return opposite corners of each region."""
    boxes = [[round(end, digits) for end in place.bounds_um] for place in places]
    return tuple(corner for x0, y0, x1, y1 in boxes for corner in ((x0, y0), (x1, y1)))
