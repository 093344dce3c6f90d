"""HTML of the trial of a plan on stored wafers: changed verdicts with reasons. Pure functions."""

from __future__ import annotations

from wafer_viewer.gui.presenters.measurement import format_quantity
from wafer_viewer.gui.presenters.verdict import LOOKS, state
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.job.revision_trial import NotTried, Trial, TriedWafer, VerdictChange
from wafer_viewer.session.state.operator_state import Operating

MOST_CHANGES = 40
"""Largest number of changes listed; the rest is only counted."""


def trial(done: Trial | None, trying: bool, outdated: bool = False) -> str:
    """Return the last trial; empty if there was none. outdated: the plan has changed since."""
    if trying:
        return html.head("On stored wafers") + html.empty("Stored wafers are being judged by this plan.")
    if done is None:
        return ""
    head = html.head("On stored wafers", done.job)
    said = html.note(_tone(done), "Verdicts change" if done.n_changes else "No verdict changes", done.summary)
    changes = [(wafer, change) for wafer in done.wafers for change in wafer.changes]
    rows = [_change(wafer, change) for wafer, change in changes[:MOST_CHANGES]]
    more = len(changes) - len(rows)
    rest = html.empty(f"And {more} more: wafer-viewer release --against lists them all.") if more else ""
    table = html.table(["Wafer, feature", "Before", "Now"], rows, "   ") if rows else ""
    since = html.note("attention", "The plan has changed since", "Try it again.") if outdated else ""
    left_out = "".join(_left_out(item) for item in done.not_tried)
    return f'{head}{since}{said}{table}{rest}{left_out}<div style="height:8px"></div>'


def before_release(now: Operating, outdated: bool) -> str:
    """Return the trial summary shown before the release of a plan."""
    if now.trial is None or outdated:
        since = "since it was changed" if now.trial is not None else "yet"
        return html.note("busy", f"Not tried on stored wafers {since}", "It is not known whether verdicts change.")
    return html.note(_tone(now.trial), "On stored wafers", now.trial.summary)


def _tone(done: Trial) -> html.Tone:
    return "attention" if done.n_changes or done.not_tried else "good"


def _change(wafer: TriedWafer, change: VerdictChange) -> str:
    why = html.safe(html.with_micro_sign(" ".join(change.why)))
    name = f"{html.safe(wafer.wafer_id or wafer.dataset)}, {html.safe(change.feature)}<small>{why}</small>"
    before = _word(change.before) + (_value(change) if change.measured_before != change.measured_after else "")
    return html.row([name, before, _word(change.after)], "   ")


def _value(change: VerdictChange) -> str:
    texts = [
        format_quantity(quantity)
        for quantity in (change.measured_before, change.measured_after)
        if quantity is not None
    ]
    return f"<small>{html.safe(' → '.join(texts))}</small>" if texts else ""


def _word(word: Word | None) -> str:
    return state(word) if word in LOOKS else '<span class="wv-lab">not judged</span>'


def _left_out(item: NotTried) -> str:
    words = f"{item.dataset} was not judged. {item.why}"
    return f'<div class="wv-lab" style="margin-top:4px">{html.safe(html.with_micro_sign(words))}</div>'
