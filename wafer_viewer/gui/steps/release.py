"""Part of a plan for operators: corners, features and dies of the job, its trial on stored wafers and its release."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.elements.elements import Button, Buttons, Fold, Html
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.verdict import limits, rule_title
from wafer_viewer.gui.steps.job_dialogs import (
    NOT_CHANGED,
    corners_dialog,
    dies_dialog,
    edit,
    feature_dialog,
    release_dialog,
    required_job,
    trial_dialog,
)
from wafer_viewer.gui.steps.trial import trial, trial_is_old
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.sample import Marks
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Dies, Feature
from wafer_viewer.model.measurement.result_rows import title_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.session.state.snapshot import Snapshot


def release_section(page: Page, snapshot: Snapshot) -> Fold | None:
    """Return the folded section with the tables of corners and features; read-only for a released job."""
    job, operating, icon = snapshot.draft.job, snapshot.operating, viser.Icon
    if job is None:
        return None

    def button(label: str, icon: Any, act: Callable[[Page], Any]) -> Button:
        do = partial(act, page)
        return Button(label, do, icon, commands=True, action="Plan saved", failed=NOT_CHANGED)

    prepare = [
        button("Corners…", icon.MAP_PIN, corners_dialog),
        button("Feature…", icon.STAIRS_UP, feature_dialog),
        button("Release…", icon.LOCK, release_dialog),
    ]
    check = [button("Dies…", icon.GRID_DOTS, dies_dialog), button("Try on wafers…", icon.HISTORY, trial_dialog)]
    return Fold(
        "For operators",
        [
            Html(_corners(job.marks) + _dies(job.dies) + _features(job)),
            Buttons(prepare, 34) if not job.released else None,
            Html(trial(operating.trial, operating.trying, trial_is_old(snapshot))),
            Buttons(check, 34) if not job.released else None,
            Buttons([button("Copy to a new plan", icon.COPY, _copy)], 34) if job.released else None,
        ],
    )


def drop_feature(page: Page, n: int) -> None:
    """Remove a feature from the plan."""
    features = required_job(page).features
    edit(page, features=(*features[:n], *features[n + 1 :]))


def _copy(page: Page) -> None:
    page.ask("The job was not changed", page.session.jobs.copy(), lambda _: page.change(everything=False))


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
        return html.head("Features") + html.empty("A quantity of a tool and its limits give a verdict.")
    rows = [_feature(n, feature, job.released) for n, feature in enumerate(job.features)]
    return html.head("Features") + html.table(["Name", "Nominal", "Limits", ""], rows, " nn ")


def _feature(n: int, feature: Feature, released: bool) -> Markup:
    where = " · on every die" if feature.per_die else "" if feature.has_place else " · no place"
    tool = TOOLS[feature.tool]
    what = " · ".join(part for part in (tool.title, title_of(tool.result, feature.quantity)) if part)
    name = Markup("{name}<small>{what}{where}<br>{rules}</small>").format(
        name=feature.name, what=what, where=where, rules=rule_title(feature)
    )
    away = html.command_link(html.icon(viser.Icon.X, 14), "no-feature", n, "Plan saved", "Remove")
    cells = [name, number(feature.nominal, 2), limits(feature), "" if released else away]
    return html.row(cells, " nn ", "" if released else html.command_pick("feature", n, "Plan saved"))
