"""Parts that several panels share: the height of the panel below the scene, the verdict, and the background jobs."""

from __future__ import annotations

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import duration, share
from wafer_viewer.gui.presenters import verdict as words
from wafer_viewer.gui.state.view_state import Below, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.style import PROFILE_PX
from wafer_viewer.session.state.snapshot import COMPILING, KernelProgress, Snapshot, Work

FIRST_WIDTH_PX = 892
"""Initial width, until the browser reports the width of its scene."""

HEIGHTS_PX: dict[Below, int] = {"none": 0, "live": 208, "defect": 208}
"""Heights other than `PROFILE_PX`: the pictures above need the room."""


def bottom_panel_height_px(view: View) -> int:
    """Return the height of the bottom panel in CSS pixels; 0 if no curve is shown."""
    return HEIGHTS_PX.get(view.below, PROFILE_PX)


def unfold(*, more: bool) -> Markup:
    """Return the link that shows everything of a released job, or the operator's actions alone."""
    return html.title_action(
        "Show everything" if more else "Show less", html.pick("everything", "yes" if more else "no")
    )


def awaited(snapshot: Snapshot) -> bool:
    """Return whether the verdict of the open dataset is pending."""
    return has_features(snapshot) and snapshot.operating.verdict is None


def has_features(snapshot: Snapshot) -> bool:
    """Return whether the open dataset's job has a feature to judge."""
    data = snapshot.dataset
    return data is not None and any(feature.has_place for feature in data.job.features)


def verdict_html(snapshot: Snapshot) -> Markup:
    """Return the verdict section; empty if the job has no feature to judge, or while a scan runs."""
    verdict = snapshot.operating.verdict
    if not has_features(snapshot) or snapshot.scanning:
        return Markup()
    if verdict is None:
        return words.waiting(snapshot.operating.judging)
    return (
        words.card(verdict) + words.dies(verdict) + words.features(verdict) + Markup('<div style="height:8px"></div>')
    )


HINT_S = 3.0
"""Times left below this are not shown: they are over before they can be read."""


def job_list(snapshot: Snapshot, view: View) -> Markup:
    """Return the running and queued jobs; finished ones are not listed, failures appear among the notes."""
    compiling = _compilation(snapshot.kernels) if snapshot.kernels is not None else Markup()
    if not snapshot.works and not compiling:
        idle = html.empty("Reconstruction and stitching", "will be shown here.")
        return html.head("Jobs") + idle if view.step == "acquire" else Markup()
    jobs = Markup("").join(_job(work, snapshot) for work in snapshot.works)
    return html.head("Jobs", str(len(snapshot.works) + bool(compiling))) + compiling + jobs


def _compilation(progress: KernelProgress) -> Markup:
    """Return the compilation of the kernels as a job, which nobody needs to cancel."""
    return Markup('<div class="wv-job"><div><b title="{}">{}</b><span>{} of {}</span></div>{}</div>').format(
        progress.words, COMPILING, progress.n_done, progress.n_parts, html.bar(progress.n_done / progress.n_parts)
    )


def state_of(work: Work, snapshot: Snapshot) -> str:
    """Describe the state of a job."""
    if work.fraction is None:
        if not snapshot.compute_ready:
            return f"queued: waiting for the {'workers' if snapshot.kernels is None else 'numerical kernels'}"
        return f"queued: waiting for {work.waits_for}" if work.waits_for else "running"
    left_s = work.seconds_left
    remaining = f"{duration(left_s)} left · " if left_s is not None and left_s >= HINT_S else ""
    return remaining + share(work.fraction, 0)


def _job(work: Work, snapshot: Snapshot) -> Markup:
    name = f"Cancel: {work.title}"
    label = Markup('title="{}" aria-label="{}" {}').format(name, name, html.command_pick("cancel", work.id))
    link = Markup('<span class="wv-link" {}>{}</span>').format(label, html.icon(viser.Icon.X, 14))
    stop = link if work.cancellable else Markup('<span class="dim">stopping</span>') if work.stopping else Markup()
    waits = work.fraction is None and (bool(work.waits_for) or not snapshot.compute_ready)
    bar = "" if waits else html.bar(work.fraction)
    return Markup(
        '<div class="wv-job"><div><b title="{title}">{title}</b><span>{state_of} {stop}</span></div>{bar}</div>'
    ).format(title=work.title, state_of=state_of(work, snapshot), stop=stop, bar=bar)
