"""Sections of a plan: what the rig searches for, and the release to operators."""

from __future__ import annotations

from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.plan.job_dialogs import (
    corners_dialog,
    dies_dialog,
    edit,
    feature_dialog,
    release_dialog,
    required_job,
    trial_dialog,
    trial_is_old,
)
from wafer_viewer.gui.presenters import plan as words
from wafer_viewer.gui.presenters.plan import trial
from wafer_viewer.gui.presenters.verdict import RULES, limits
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import HtmlBlock, ToggleGroup, command_button, in_a_row, set_prop
from wafer_viewer.model.acquisition.procedure import ExposureLevels, FoundExposure
from wafer_viewer.model.acquisition.sample import Marks
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Dies, Feature
from wafer_viewer.model.measurement.result_rows import title_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Snapshot

# ------------------------------------------------------------------------------------------------------ release section


class ReleaseSection:
    """Folded section with tables of corners and features; read-only for a released job."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.gui
        self._folder = gui.add_folder("For operators", expand_by_default=False, visible=False)
        with self._folder:
            self._words = HtmlBlock(gui)
            self._buttons = [
                self._button("Corners…", viser.Icon.MAP_PIN, corners_dialog),
                self._button("Feature…", viser.Icon.STAIRS_UP, feature_dialog),
                self._button("Release…", viser.Icon.LOCK, release_dialog),
            ]
            in_a_row(gui, self._buttons, 34)
            self._tried = HtmlBlock(gui)
            self._try = self._button("Try on wafers…", viser.Icon.HISTORY, trial_dialog)
            self._dies = self._button("Dies…", viser.Icon.GRID_DOTS, dies_dialog)
            in_a_row(gui, [self._dies, self._try], 34)
            self._copy = self._button("Copy to a new plan", viser.Icon.COPY, self._to_copy)
            in_a_row(gui, [self._copy], 34)
        page.on_pick("feature", lambda key: feature_dialog(page, int(key)))
        page.on_pick("no-feature", lambda key: self._drop(int(key)))

    def show(self, snapshot: Snapshot) -> None:
        """Update the section."""
        job = snapshot.draft.job
        set_prop(self._folder, "visible", job is not None)
        if job is None:
            return
        self._words.show(_corners(job.marks) + _dies(job.dies) + _features(job))
        self._tried.show(trial(snapshot.operating.trial, snapshot.operating.trying, trial_is_old(snapshot)))
        for handle in (*self._buttons, self._dies, self._try):
            set_prop(handle, "visible", not job.released)
        set_prop(self._copy, "visible", job.released)

    def _button(self, name: str, icon: Any, ask: Any) -> Any:
        act = guarded(self._page, "The plan was not changed")(lambda _: ask(self._page))
        return command_button(self._page.gui, name, icon, act, action="Plan saved")

    def _to_copy(self, page: Page) -> None:
        page.ask("The job was not changed", page.session.jobs.copy(), lambda _: page.change(everything=False))

    def _drop(self, n: int) -> None:
        features = required_job(self._page).features
        edit(self._page, features=(*features[:n], *features[n + 1 :]))


def _corners(marks: Marks | None) -> Markup:
    if marks is None:
        return html.head("Alignment") + html.empty("Two corners of dies to align wafers by.")
    rows = [html.row([m.name, number(m.x_um, 1), number(m.y_um, 1)], " nn") for m in marks.places]
    head = html.head("Alignment", f"residual at most {number(marks.limit_um, 1)} µm")
    return head + html.table(["Corner, wafer µm", "x", "y"], rows, " nn")


def _dies(dies: Dies | None) -> Markup:
    """Return number and size of the dies; empty if none are defined."""
    if dies is None:
        return Markup()
    summary = f"{len(dies.all())} of {number(dies.width_um, 0)} × {number(dies.height_um, 0)} µm"
    return html.head("Dies", summary)


def _features(job: Job) -> Markup:
    if not job.features:
        return html.head("Features") + html.empty("Any quantity of a tool, with its limits, gives a verdict.")
    rows = [_feature(n, feature, job.released) for n, feature in enumerate(job.features)]
    return html.head("Features") + html.table(["Name", "Nominal", "Limits", ""], rows, " nn ")


def _feature(n: int, feature: Feature, released: bool) -> Markup:
    where = " · on every die" if feature.per_die else "" if feature.has_place else " · no place"
    tool = TOOLS[feature.tool]
    what = " · ".join(part for part in (tool.title, title_of(tool.result, feature.quantity)) if part)
    name = Markup("{name}<small>{what}{where}<br>{rules}</small>").format(
        name=feature.name, what=what, where=where, rules=RULES[feature.decision_rule]
    )
    pick = html.command_pick("no-feature", n, "Plan saved")
    away = Markup('<span class="wv-link" title="Remove" {}>{}</span>').format(pick, html.icon(viser.Icon.X, 14))
    cells = [name, number(feature.nominal, 2), limits(feature), "" if released else away]
    return html.row(cells, " nn ", "" if released else html.command_pick("feature", n, "Plan saved"))


# ------------------------------------------------------------------------------------------------------ search sections


FAILED = "The exposure was not found"


class ExposureSection:
    """Search for the exposure of the plan; its progress and its cancel button are in the list of running work."""

    def __init__(self, page: Page) -> None:
        self._page = page
        find = guarded(page, FAILED)(lambda _: self._search())
        icon = viser.Icon.BRIGHTNESS_UP
        self._find = command_button(page.gui, "Find the exposure", icon, find, action="Plan saved")
        in_a_row(page.gui, [self._find])
        self._result = HtmlBlock(page.gui)
        page.on_pick("bracket", lambda _: page.ask("The bracket was not taken", page.session.take_bracket()))

    def show(self, snapshot: Snapshot) -> None:
        """Update the button and the result."""
        draft = snapshot.draft
        released = draft.job is not None and draft.job.released
        set_prop(self._find, "disabled", released or draft.plan is None or not snapshot.rig.can_start)
        self._result.show(result(snapshot))

    def _search(self) -> None:
        self._page.ask(FAILED, self._page.session.find_exposure())


def result(snapshot: Snapshot) -> Markup:
    """Return the exposure found and what it was found from, as long as the plan has it; else empty."""
    found, job = snapshot.exposure, snapshot.draft.job
    if found is None or job is None or job.exposures_us not in (found.single_us, found.bracket_us):
        return Markup()
    single = found.single
    exposure_us = with_unit(single.exposure_us, _digits(single.exposure_us), "µs")
    facts = (
        f"Brightest pixels at {share(single.level, 0)} of white in field {single.brightest_field}; looked at "
        f"{_fields(found)}, {len(found.z_um)} positions over {with_unit(found.z_um[-1], 1)}."
    )
    return html.note("good", f"{exposure_us} suits the brightest field", facts) + _bracket(found, job.exposures_us)


def _bracket(found: FoundExposure, exposures_us: tuple[float, ...]) -> Markup:
    """Return the proposed bracket with its figures and the link that takes it; empty if there is none."""
    if not found.bracket:
        return Markup()
    rows = [html.row(_cells(levels), "nnn") for levels in found.bracket]
    table = html.table(["Exposure, µs", "Clipped", "Dark"], rows, "nnn")
    if exposures_us == found.bracket_us:
        return table
    dark = f"{share(found.single.dark_fraction)} of the pixels are darker than 5 % of white"
    link = Markup('<span class="wv-link" {}>Take the bracket</span>').format(
        html.command_pick("bracket", action="Plan saved")
    )
    return html.note("attention", "One exposure leaves dark areas", f"{dark}: a bracket shows them.", link) + table


def _cells(levels: ExposureLevels) -> list[str]:
    exposure = number(levels.exposure_us, _digits(levels.exposure_us))
    return [exposure, share(levels.clipped_fraction), share(levels.dark_fraction)]


def _digits(exposure_us: float) -> int:
    return 0 if exposure_us >= 100 else 1


def _fields(found: FoundExposure) -> str:
    n = len(found.fields)
    return f"field {found.fields[0]}" if n == 1 else f"fields {', '.join(map(str, found.fields))}"


ALLOW_FOR = ((1.0, "1 u"), (2.0, "2 u"), (3.0, "3 u"))
"""Coverage factors with their titles."""
LOOK_FAILED = "The focus was not looked for"


class FollowSection:
    """Coarse look and the windows that follow it; the look is in the list of running work while it runs."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._head = HtmlBlock(page.gui)
            self._allow = ToggleGroup(page.gui, "Allow for", ALLOW_FOR, self._allow_for)
            look = guarded(page, LOOK_FAILED)(lambda _: page.ask(LOOK_FAILED, page.session.look_for_focus()))
            more = guarded(page, LOOK_FAILED)(lambda _: page.ask(LOOK_FAILED, page.session.look_at_more_places()))
            self._look = command_button(page.gui, "Look for the focus", viser.Icon.CROSSHAIR, look)
            self._more = command_button(page.gui, "More places", viser.Icon.PLUS, more)
            in_a_row(page.gui, [self._look, self._more])
            self._windows = HtmlBlock(page.gui)
        page.on_pick("focus-row", lambda row: page.change(focus_row=int(row)))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the section; it is hidden while the plan does not follow the focus."""
        draft = snapshot.draft
        follow = draft.job.follow_focus if draft.job is not None else None
        set_prop(self._folder, "visible", follow is not None)
        if draft.job is None or follow is None:
            return
        shown = words.followed(draft, view.focus_row)
        idle = draft.plan is not None and snapshot.rig.can_start
        everywhere = shown is not None and len(shown.look.places) >= len(shown.plan.fields)
        set_prop(self._look, "disabled", not idle)
        set_prop(self._more, "disabled", not idle or shown is None or everywhere)
        self._allow.show(follow.coverage_factor)
        self._head.show(words.head(draft, shown))
        self._windows.show(words.windows(shown))

    def _allow_for(self, factor: float) -> None:
        job = self._page.session.snapshot.draft.job
        if job is None or job.follow_focus is None:
            return
        follow = replace(job.follow_focus, coverage_factor=factor)
        self._page.ask("The allowance was not changed", self._page.session.edit_job(replace(job, follow_focus=follow)))
