"""The list of background work: how far it is, how long it still takes, what it waits for, and a way to stop it."""

from __future__ import annotations

import viser

from wafer_viewer.draw.number_format import duration, share
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.session.state.snapshot import Snapshot, Work

HINT_S = 3.0
"""What takes less than this is over before it can be read."""


def job_list(snapshot: Snapshot, view: View) -> str:
    """What is at work; what is over is not listed, what failed stands among the notes."""
    if not snapshot.works:
        idle = html.empty("Reconstruction and stitching", "will be shown here.")
        return html.head("Jobs") + idle if view.step == "acquire" else ""
    jobs = "".join(_job(work, snapshot) for work in snapshot.works)
    return html.head("Jobs", str(len(snapshot.works))) + jobs


def state_of(work: Work, snapshot: Snapshot) -> str:
    """How a job stands, in words."""
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
