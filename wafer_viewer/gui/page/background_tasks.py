"""List of background jobs: progress, time left, dependencies, and a Cancel link."""

from __future__ import annotations

import viser

from wafer_viewer.draw.number_format import duration, share
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.session.state.snapshot import Snapshot, Work

HINT_S = 3.0
"""Times left below this are not shown: they are over before they can be read."""


def job_list(snapshot: Snapshot, view: View) -> str:
    """Return the running and queued jobs; finished ones are not listed, failures appear among the notes."""
    if not snapshot.works:
        idle = html.empty("Reconstruction and stitching", "will be shown here.")
        return html.head("Jobs") + idle if view.step == "acquire" else ""
    jobs = "".join(_job(work, snapshot) for work in snapshot.works)
    return html.head("Jobs", str(len(snapshot.works))) + jobs


def state_of(work: Work, snapshot: Snapshot) -> str:
    """Describe the state of a job."""
    if work.fraction is None:
        if not snapshot.compute_ready:
            return "queued: waiting for the workers"
        return f"queued: waiting for {work.waits_for}" if work.waits_for else "running"
    left_s = work.seconds_left
    left = f"{duration(left_s)} left · " if left_s is not None and left_s >= HINT_S else ""
    return left + share(work.fraction, 0)


def _job(work: Work, snapshot: Snapshot) -> str:
    name = f"Cancel: {html.safe(work.title)}"
    cross = html.icon(viser.Icon.X, 14)
    link = f'<span class="wv-link" title="{name}" aria-label="{name}" {html.pick("cancel", work.id)}>{cross}</span>'
    stop = link if work.cancellable else '<span class="dim">stopping</span>' if work.stopping else ""
    waits = work.fraction is None and (bool(work.waits_for) or not snapshot.compute_ready)
    bar = "" if waits else html.bar(work.fraction)
    return (
        f'<div class="wv-job"><div><b title="{html.safe(work.title)}">{html.safe(work.title)}</b>'
        f"<span>{html.safe(state_of(work, snapshot))} {stop}</span></div>{bar}</div>"
    )
