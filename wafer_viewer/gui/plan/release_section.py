"""Section that prepares a plan for operators: alignment corners, features with limits, release."""

from __future__ import annotations

from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number
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
from wafer_viewer.gui.presenters.plan import trial
from wafer_viewer.gui.presenters.verdict import RULES, limits
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, command_button, in_a_row, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.model.acquisition.sample import Marks
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Dies, Feature
from wafer_viewer.model.measurement.result_rows import title_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.session.state.snapshot import Snapshot


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
