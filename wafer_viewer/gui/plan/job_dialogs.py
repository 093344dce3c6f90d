"""Dialogs of jobs: selection, alignment corners, features, dies, trial, release."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import plan as preflight
from wafer_viewer.gui.presenters.plan import before_release
from wafer_viewer.gui.presenters.results import KeptFeature, kept_features
from wafer_viewer.gui.presenters.verdict import RULES
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import HtmlBlock, duo, set_prop, with_decimals
from wafer_viewer.gui.widgets.number_field import OptionalNumber, OptionalPair, Pair
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.sample import AlignmentMark, Marks
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Die, Dies, Feature, on_die
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.tools import TOOLS, ToolOptions
from wafer_viewer.model.quantity import Unit
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.planning.preflight import PreflightCheck
from wafer_viewer.session.state.snapshot import JobEntry, Snapshot

BY_HAND = "as typed below"


def jobs_dialog(page: Page) -> None:
    """Open the dialog that loads a released job."""
    snapshot = page.session.snapshot
    dialog = Dialog(page, "Released jobs", f"In {snapshot.data_folder / 'jobs'}, or a file elsewhere.")
    with dialog.modal:
        HtmlBlock(page.gui, job_table(snapshot.operating.jobs, "job-in-dialog"))
        files = FileList(dialog, "job", rows=5)

    def listed(key: str) -> None:
        dialog.close()
        load_job(page, Path(key))

    def typed() -> None:
        if files.is_empty:
            raise PlanError("No job is chosen: click one, or its file.")
        load_job(page, files.path())

    page.on_pick("job-in-dialog", listed)
    dialog.answers("Use this job", viser.Icon.FOLDER_OPEN, typed, "The job was not loaded")


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


def start_dialog(page: Page, checks: tuple[PreflightCheck, ...], start: Callable[[], None]) -> None:
    """Ask for confirmation of the open preflight checks before the scan starts."""
    open_ones = tuple(check for check in checks if check.state != "ok")
    dialog = Dialog(page, "Start anyway?", "The scan can start, but this needs attention:")
    with dialog.modal:
        HtmlBlock(page.gui, preflight.lines(open_ones))
    dialog.answers("Start", viser.Icon.PLAYER_PLAY, start, "The scan did not start")


def corners_dialog(page: Page) -> None:
    """Open the dialog that names the two alignment corners of this product."""
    job = required_job(page)
    marks = job.marks or suggested_marks(page.session.snapshot.overview)
    below = "Corners of dies, far apart, in wafer µm: the middle of the wafer is (0, 0), its notch points down."
    dialog, gui = Dialog(page, "Corners to align by", below), page.gui
    with dialog.modal:
        rows = [
            (
                gui.add_text(f"Corner {n + 1}", mark.name),
                with_decimals(gui.add_vector2("x, y, µm", (mark.x_um, mark.y_um), step=0.1), 2),
            )
            for n, mark in enumerate(marks.places)
        ]
        limit = with_decimals(gui.add_number("Limit, µm", marks.limit_um, min=0.1, step=0.5), 2)

    def keep() -> None:
        places = tuple(
            AlignmentMark(name=name.value.strip(), x_um=position.value[0], y_um=position.value[1])
            for name, position in rows
        )
        edit(page, marks=Marks(places=places, limit_um=limit.value), alignment=None)

    dialog.answers("Keep", viser.Icon.CHECK, keep, "The corners were not changed")


def trial_dialog(page: Page) -> None:
    """Open the dialog that applies the plan to stored wafers and lists changed verdicts; nothing is released."""
    required_job(page)
    below = "Shows which verdicts would change, and why. Nothing stored is overwritten; a changed recipe takes longer."
    dialog = Dialog(page, "Try on stored wafers", below)
    with dialog.modal:
        files = FileList(dialog, "wafers", rows=7)
        files.field.value = str(page.session.snapshot.data_folder)
        result = page.gui.add_text("Reconstruction", DEFAULT_RESULT)

    def begin() -> None:
        paths = (files.path(),)
        page.ask("The trial failed", page.session.trials.begin(paths, result.value.strip() or DEFAULT_RESULT))

    dialog.answers("Try it", viser.Icon.HISTORY, begin, "The trial failed")


def release_dialog(page: Page) -> None:
    """Open the dialog that releases the plan under a product and a revision; it is then immutable."""
    job = required_job(page)
    below = "Operators run it with four actions. It cannot be changed afterwards; a change is a new revision."
    dialog, now = Dialog(page, "Release the job", below), page.session.snapshot
    with dialog.modal:
        HtmlBlock(page.gui, before_release(now.operating, trial_is_old(now)))
        product = page.gui.add_text("Product", job.product or job.sample.product)
        revision = page.gui.add_text("Revision", job.revision)
        why = page.gui.add_text("Reason", "")

    def release() -> None:
        now.control.require_reason(why.value)
        if not (product.value.strip() and revision.value.strip()):
            raise PlanError("Product and revision both need a name: an operator chooses by them.")
        edit(page, then=write, product=product.value.strip(), revision=revision.value.strip())

    def write(_: Any) -> None:
        failed = "The job was not released"
        page.ask(failed, page.session.jobs.release(why.value.strip()), lambda path: page.say("Released", str(path)))

    dialog.answers("Release", viser.Icon.LOCK, release, "The job was not released")


def trial_is_old(now: Snapshot) -> bool:
    """Return whether the plan differs from the one tried; product and revision are ignored."""
    tried, job = now.operating.trial_of, now.draft.job
    if tried is None or job is None or now.operating.trial is None:
        return False
    return replace(tried, product=job.product, revision=job.revision) != job


def edit(page: Page, then: Callable[[Any], None] | None = None, **changes: Any) -> None:
    """Change fields of the plan."""
    page.ask("The plan was not changed", page.session.edit_job(replace(required_job(page), **changes)), then)


def required_job(page: Page) -> Job:
    """Return the plan. Raises PlanError if there is none."""
    if (job := page.session.snapshot.draft.job) is None:
        raise PlanError("There is no plan yet: lay a field grid over the sample first.")
    return job


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


DIES_TEXT = (
    "A lattice in wafer µm, by the lower left corner of its first die. Those that lie within the fields are kept."
)


def dies_dialog(page: Page) -> None:
    """Open the dialog that defines the lattice of dies; dies outside of the scanned fields are dropped."""
    job = required_job(page)
    start = lattice_of(job.dies) if job.dies is not None else suggested_dies(page.session.snapshot.overview)
    dialog, gui = Dialog(page, "Dies", DIES_TEXT), page.gui
    with dialog.modal:
        pitch = OptionalPair(gui, "Pitch, µm", _given(start.pitch_x_um, start.pitch_y_um), over=0)
        size = OptionalPair(gui, "Die, µm", _given(start.width_um, start.height_um), over=0)
        first = with_decimals(gui.add_vector2("First die, µm", (start.x0_um, start.y0_um), step=1.0), 2)
        counts = gui.add_vector2("Across, up", (start.cols, start.rows), min=(1, 1), step=1)

    def keep() -> None:
        steps, sides = pitch.value, size.value or pitch.value
        if sides is None:
            raise PlanError("Die and pitch are not given: type at least one of them, such as 300 × 200.")
        if steps is None and counts.value != (1, 1):
            raise PlanError("The pitch of the dies is not given: type it, or 1 across and 1 up for a single die.")
        lattice = Dies(
            width_um=sides[0],
            height_um=sides[1],
            rows=int(counts.value[1]),
            cols=int(counts.value[0]),
            pitch_x_um=steps[0] if steps is not None else 0.0,
            pitch_y_um=steps[1] if steps is not None else 0.0,
            x0_um=first.value[0],
            y0_um=first.value[1],
        )
        edit(page, dies=within_fields(lattice, required_job(page)))

    dialog.answers("Keep", viser.Icon.CHECK, keep, "The dies were not changed")


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


AS_BEFORE = "as before"
MAIN = "the main one"
STAYS = "The feature was not changed"
FEATURE_TEXT = "A step height as typed below, or any result kept on the surface shown, with the limits of a good wafer."


def feature_dialog(page: Page, n: int | None = None) -> None:
    """Open the dialog of a feature. n: index of the job's feature to change; None for a new one."""
    features = required_job(page).features
    FeatureDialog(page, features[n] if n is not None else None, n)


class FeatureDialog:
    """Feature under construction; a chosen kept result sets tool, regions and quantities."""

    def __init__(self, page: Page, old: Feature | None, n: int | None) -> None:
        self._page, self._old, self._n = page, old, n
        self._tool: ToolName = old.tool if old else "step"
        self._unit: Unit = old.unit if old else "um"
        self._places: tuple[Region, ...] = old.places if old else ()
        self._options: ToolOptions | None = old.options if old else None
        self._was_per_die = old.per_die if old else False
        self._dies = required_job(page).dies
        self._stored = kept_features(page.session.snapshot)
        dialog = Dialog(page, "Feature", FEATURE_TEXT)
        with dialog.modal:
            self._ask_what()
            self._ask_limits()
            self._ask_where()
        self._tell()
        dialog.answers("Keep", viser.Icon.CHECK, self._keep, STAYS)

    def _ask_what(self) -> None:
        gui, old = self._page.gui, self._old
        self._name = gui.add_text("Name", old.name if old else "")
        self._source = gui.add_dropdown("Measured as", (AS_BEFORE if old else BY_HAND, *self._stored))
        self._quantity = gui.add_dropdown("Quantity", ((old.quantity if old else "") or MAIN,))
        self._what = HtmlBlock(gui)
        self._source.on_update(guarded(self._page, STAYS)(lambda _: self._take()))
        self._quantity.on_update(guarded(self._page, STAYS)(lambda _: self._take_quantity()))

    def _ask_limits(self) -> None:
        gui, old = self._page.gui, self._old
        self._nominal = OptionalNumber(gui, "Nominal, µm", old.nominal if old else None)
        duo(gui)
        self._low = OptionalNumber(gui, "Lower limit", old.lower_limit if old else None)
        self._high = OptionalNumber(gui, "Upper limit", old.upper_limit if old else None)
        rule = RULES[old.decision_rule if old else "guard_band"]
        self._rule = gui.add_dropdown("Rule", tuple(RULES.values()), initial_value=rule)

    def _ask_where(self) -> None:
        """Add the region inputs, last, so that the dropdowns above open over them and not over the buttons."""
        gui = self._page.gui
        self._upper = _corners(gui, "Upper", self._places[:1])
        self._lower = _corners(gui, "Lower", self._places[1:2])
        self._every = gui.add_checkbox("On every die", self._was_per_die, disabled=self._dies is None)

    def _take(self) -> None:
        """Take tool, regions, options and quantities from the chosen kept result."""
        if (chosen := self._chosen()) is None:
            return
        self._tool, self._places, self._options = chosen.tool, chosen.places, chosen.options
        self._quantity.options = (MAIN, *chosen.quantities)
        if self._tool == "step":
            for handles, place in zip((self._upper, self._lower), self._places, strict=True):
                _put(handles, place)
        self._take_quantity()

    def _take_quantity(self) -> None:
        """Take the unit of the chosen quantity, and its value as the nominal value."""
        if (chosen := self._chosen()) is not None:
            self._unit = chosen.unit(self._quantity_name)
            self._nominal.value = round(chosen.value(self._quantity_name), 2)
        self._tell()

    def _tell(self) -> None:
        """Show tool and unit; region inputs are visible for steps only."""
        for handle in (*self._upper, *self._lower):
            set_prop(handle, "visible", self._tool == "step")
        words = f"{TOOLS[self._tool].title}; its limits are in {self._unit}."
        self._what.show(Markup('<div class="wv-lab">{}</div>').format(html.with_micro_sign(words)))

    def _chosen(self) -> KeptFeature | None:
        return self._stored.get(self._source.value)

    @property
    def _quantity_name(self) -> str:
        return "" if self._quantity.value == MAIN else self._quantity.value

    def _keep(self) -> None:
        page, features = self._page, required_job(self._page).features
        made = self._made(f"{TOOLS[self._tool].title} {len(features) + 1}")
        changed = (*features, made) if self._n is None else (*features[: self._n], made, *features[self._n + 1 :])
        edit(page, features=changed)

    def _made(self, unnamed: str) -> Feature:
        """Return the feature of the form. Raises PlanError if it is invalid."""
        places = self._required_places()
        return Feature(
            name=self._name.value.strip() or unnamed,
            tool=self._tool,
            quantity=self._quantity_name,
            unit=self._unit,
            nominal=self._nominal.value,
            lower_limit=self._low.value,
            upper_limit=self._high.value,
            decision_rule=next(key for key, title in RULES.items() if title == self._rule.value),
            per_die=self._every.value,
            places=places,
            options=self._options,
        )

    def _required_places(self) -> tuple[Region, ...]:
        """Return the regions on the wafer or relative to a die's corner; convert them only if that choice changed."""
        places = tuple(_region(h) for h in (self._upper, self._lower)) if self._tool == "step" else self._places
        if not places:
            raise PlanError("The feature has no place: choose a result that was kept.")
        counted = self._was_per_die and self._chosen() is None
        if self._dies is None or self._every.value == counted:
            return places
        if counted:
            return tuple(on_die(place, self._dies.all()[0]) for place in places)
        return relative_to_die(places, self._dies)


def _corners(gui: Any, name: str, places: tuple[Region, ...]) -> tuple[Any, Any]:
    """Add inputs for two opposite corners of a rectangle."""
    x0, y0, x1, y1 = places[0].bounds_um if places else (0.0, 0.0, 0.0, 0.0)
    first, last = (
        with_decimals(gui.add_vector2(label, corner, step=0.5), 2)
        for label, corner in ((f"{name}, µm", (x0, y0)), ("– to, µm", (x1, y1)))
    )
    return first, last


def _put(handles: tuple[Any, Any], region: Region) -> None:
    x0, y0, x1, y1 = region.bounds_um
    handles[0].value, handles[1].value = (round(x0, 1), round(y0, 1)), (round(x1, 1), round(y1, 1))


def _region(handles: tuple[Any, Any]) -> Region:
    return Region.rectangle(*handles[0].value, *handles[1].value)
