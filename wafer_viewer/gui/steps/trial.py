"""Trial of a plan on stored wafers, as the panel and the release show it."""

from __future__ import annotations

from markupsafe import Markup

from wafer_viewer.draw.quantities import format_quantity
from wafer_viewer.gui.presenters.verdict import LOOKS, state
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.job import NotTried, Trial, TriedWafer, VerdictChange
from wafer_viewer.model.quantity import Word
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Operating, Snapshot

MOST_CHANGES = 40
"""Largest number of changes listed; the rest is only counted."""


def trial(done: Trial | None, trying: bool, outdated: bool = False) -> Markup:
    """Return the last trial; empty if there was none. outdated: the plan has changed since."""
    if trying:
        return html.head("On stored wafers") + html.empty("Stored wafers are being judged by this plan.")
    if done is None:
        return Markup()
    head = html.head("On stored wafers", done.job)
    outcome = html.note(_tone(done), "Verdicts change" if done.n_changes else "No verdict changes", done.summary)
    changes = [(wafer, change) for wafer in done.wafers for change in wafer.changes]
    rows = [_change(wafer, change) for wafer, change in changes[:MOST_CHANGES]]
    more = len(changes) - len(rows)
    rest = html.empty(f"And {more} more: wafer-viewer release --against lists them all.") if more else ""
    table = html.table(["Wafer, feature", "Before", "Now"], rows, "   ") if rows else ""
    since = html.note("attention", "The plan has changed since", "Try it again.") if outdated else ""
    left_out = Markup("").join(_left_out(item) for item in done.not_tried)
    return Markup('{head}{since}{outcome}{table}{rest}{left_out}<div style="height:8px"></div>').format(
        head=head, since=since, outcome=outcome, table=table, rest=rest, left_out=left_out
    )


def before_release(now: Operating, outdated: bool) -> Markup:
    """Return the trial summary shown before the release of a plan."""
    if now.trial is None or outdated:
        since = "since it was changed" if now.trial is not None else "yet"
        return html.note("busy", f"Not tried on stored wafers {since}", "It is not known whether verdicts change.")
    return html.note(_tone(now.trial), "On stored wafers", now.trial.summary)


def _tone(done: Trial) -> html.Tone:
    return "attention" if done.n_changes or done.not_tried else "good"


def _change(wafer: TriedWafer, change: VerdictChange) -> Markup:
    why = html.typeset(" ".join(change.why))
    name = Markup("{}, {}<small>{}</small>").format(wafer.wafer_id or wafer.dataset, change.feature, why)
    before = _word(change.before) + (_value(change) if change.measured_before != change.measured_after else "")
    return html.row([name, before, _word(change.after)], "   ")


def _value(change: VerdictChange) -> Markup:
    texts = [
        format_quantity(quantity)
        for quantity in (change.measured_before, change.measured_after)
        if quantity is not None
    ]
    return Markup("<small>{}</small>").format(" → ".join(texts)) if texts else Markup()


def _word(word: Word | None) -> Markup:
    return state(word) if word in LOOKS else Markup('<span class="wv-lab">not judged</span>')


def _left_out(item: NotTried) -> Markup:
    words = f"{item.dataset} was not judged. {item.why}"
    return html.remark(words, "margin-top:4px")


def trial_is_old(now: Snapshot) -> bool:
    """Return whether the plan differs from the one tried; product and revision are ignored."""
    tried, job = now.operating.trial_of, now.draft.job
    if tried is None or job is None or now.operating.trial is None:
        return False
    return replace(tried, product=job.product, revision=job.revision) != job
