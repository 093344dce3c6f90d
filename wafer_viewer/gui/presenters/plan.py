"""HTML of a plan: warnings, strategies with cost, preflight checks, and the trial on stored wafers. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import THIN, duration, number, size, with_unit
from wafer_viewer.draw.quantities import format_quantity
from wafer_viewer.gui.presenters.verdict import LOOKS, state
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.plan import Price
from wafer_viewer.model.job import NotTried, Trial, TriedWafer, VerdictChange
from wafer_viewer.model.quantity import Word
from wafer_viewer.session.planning.preflight import PreflightCheck, State
from wafer_viewer.session.state.snapshot import Draft, Operating, Snapshot

_GAP = Markup('<div style="height:8px"></div>')


def history(draft: Draft) -> Markup:
    """Return the undo and redo actions of the title."""

    def action(what: str, name: str, sign: Any, possible: bool) -> Markup:
        state = html.command_pick(what) if possible else Markup('aria-disabled="true"')
        return Markup('<span class="wv-action{possible}" title="{name}" {state}>{icon}</span>').format(
            possible="" if possible else " off", name=name, state=state, icon=html.icon(sign, 17)
        )

    return action("undo", "Undo · Ctrl + Z", viser.Icon.ARROW_BACK_UP, draft.can_undo) + action(
        "redo", "Redo · Ctrl + Shift + Z", viser.Icon.ARROW_FORWARD_UP, draft.can_redo
    )


def grid(snapshot: Snapshot) -> Markup:
    """Return the head of the field grid, or what is missing for a grid."""
    job = snapshot.draft.job
    if job is None:
        return html.head("Field grid") + html.empty("Waits for the size of the sample.") + _on_stage(snapshot)
    if job.grid is None:
        return html.head("Fields", f"{len(job.fields)} fields from the plan's list")
    grid = job.grid
    n = grid.rows * grid.cols
    extent = f"{number(grid.width_um, 0)} × {with_unit(grid.height_um, 0)}"
    return html.head("Field grid", f"{n} field{'s' if n > 1 else ''} · {extent}")


def _on_stage(snapshot: Snapshot) -> Markup:
    """Return a link that lays the grid over the sample on the stage; empty without an overview."""
    if snapshot.overview is None:
        return Markup()
    link = Markup('<span class="wv-link" {}>Use the sample on the stage</span>').format(
        html.command_pick("cover", action="Plan saved")
    )
    return Markup('<div class="wv-why">{}</div>').format(link)


def sweep(draft: Draft) -> Markup:
    """Return the head of the focus sweep; empty without a job."""
    if draft.job is None:
        return Markup()
    sweep = draft.job.sweep
    return html.head("Focus sweep", f"{sweep.n_frames} frames · {with_unit(sweep.range_um, 1)}")


def depth_of_field_warning(snapshot: Snapshot, draft: Draft) -> Markup:
    """Return a warning if the z step exceeds half the depth of field."""
    limits = snapshot.rig.limits
    if draft.job is None or limits is None:
        return Markup()
    half_um, step_um = limits.depth_of_field_um / 2, draft.job.sweep.z_step_um
    if step_um <= half_um + 1e-9:
        return Markup()
    fact = f"{with_unit(step_um, 2)} is over half the depth of field, {with_unit(half_um, 1)}"
    sign = html.icon(viser.Icon.ALERT_TRIANGLE, 18)
    return html.note("attention", "The step is coarse", f"{fact}: heights become less certain.", sign=sign)


def strategies(snapshot: Snapshot, draft: Draft) -> Markup:
    """Return all strategies with their time, and time and disk space of the chosen one."""
    if draft.job is None:
        waiting = html.empty("Every strategy is listed here with its time", "as soon as there is a grid.")
        return html.head("Strategy") + waiting + _GAP
    if draft.plan is None:
        return (
            html.head("Strategy")
            + html.empty(
                html.with_micro_sign(draft.problem)
                if draft.problem
                else "The time of every strategy is being estimated."
            )
            + _by_hand(draft.job.strategy)
            + _GAP
        )
    plan, limits = draft.plan, snapshot.rig.limits
    rate = f" at {number(limits.camera.frame_rate_hz, 0)} frames/s" if limits else ""
    best_s = min((p.predicted_s for p in plan.prices if p.predicted_s), default=0.0)
    rows = [_price_row(price, best_s, price.strategy == plan.strategy) for price in _by_price(plan.prices)]
    free = draft.free_bytes
    figures = [
        html.figure("Predicted time", duration(plan.predicted_s)),
        _size_figure("On disk", plan.bytes_on_disk),
        _size_figure("Free", free, "fault" if free is not None and free < plan.bytes_on_disk else "good"),
    ]
    return (
        html.head("Strategy", f"for {number(plan.n_frames, 0)} frames{rate}")
        + html.table(["", "Time", "Motions", "× best"], rows, " nnn")
        + _by_hand(draft.job.strategy)
        + _GAP
        + html.columns(figures)
        + _GAP
    )


def start_hint(draft: Draft, why_not: str | None) -> Markup:
    """Return the line above the button: why it is disabled, else the cost of the scan (visible in low windows only)."""
    if why_not is not None:
        return Markup('<div class="wv-why wv-at-foot">Not yet: {}</div>').format(html.with_micro_sign(why_not))
    if draft.plan is None:
        return Markup()
    free = f", {size(draft.free_bytes)} free" if draft.free_bytes is not None else ""
    cost = Markup("<b>{}</b> · {} on disk{}").format(
        duration(draft.plan.predicted_s), size(draft.plan.bytes_on_disk), free
    )
    return Markup('<div class="wv-why wv-at-foot wv-low-only">{}</div>').format(cost)


def _by_price(prices: tuple[Price, ...]) -> list[Price]:
    return sorted(prices, key=lambda p: (p.ruled_out is not None, p.predicted_s or 0.0))


def _price_row(price: Price, best_s: float, chosen: bool) -> Markup:
    name = Markup("{}").format(price.title)
    if price.look_s:
        look = f"{'about ' if price.estimated else ''}{duration(price.look_s)} of it coarse look"
        name += Markup("<small>{}</small>").format(look)
    if price.ruled_out is not None or price.predicted_s is None:
        why = html.with_micro_sign(price.ruled_out or "not estimated")
        return Markup('<tr class="off"><td colspan="4">{}<small>{}</small></td></tr>').format(name, why)
    ratio = price.predicted_s / best_s if best_s else 1.0
    cells = [name, duration(price.predicted_s), number(price.motions, 0), number(ratio, 2 if ratio < 9.95 else 1)]
    return html.row(cells, " nnn", html.command_pick("strategy", price.strategy, "Plan saved"), "sel" if chosen else "")


def _by_hand(strategy: str) -> Markup:
    """Return a link that undoes the manual choice of a strategy; empty if it is automatic."""
    if strategy == "auto":
        return Markup()
    link = Markup('<span class="wv-link" {}>Use the fastest</span>').format(
        html.command_pick("strategy", "auto", "Plan saved")
    )
    return Markup('<div class="wv-lab" style="padding:4px 6px">Chosen by hand. {}</div>').format(link)


def _size_figure(label: str, n_bytes: int | None, tone: Any = None) -> Markup:
    value, _, unit = size(n_bytes).rpartition(THIN)
    return html.figure(label, value or unit, unit if value else "", tone=tone)


SIGNS: dict[State, tuple[Any, str]] = {
    "ok": (viser.Icon.CIRCLE_CHECK, "ok"),
    "attention": (viser.Icon.ALERT_TRIANGLE, "attention"),
    "stop": (viser.Icon.HAND_STOP, "stop"),
}


def section(checks: Sequence[PreflightCheck], name: str = "Before the start") -> Markup:
    """Return all checks under a head with the number of open ones; empty without checks."""
    if not checks:
        return Markup()
    open_lines = sum(check.state != "ok" for check in checks)
    status = "all fine" if not open_lines else f"{open_lines} of {len(checks)} to look at"
    return html.head(name, status) + lines(checks)


def lines(checks: Sequence[PreflightCheck]) -> Markup:
    """Return the checks without a head."""
    return Markup('<div class="wv-checks" role="list" aria-label="Preflight">{}</div>').format(
        Markup("").join(map(_line, checks))
    )


def _line(check: PreflightCheck) -> Markup:
    sign, word = SIGNS[check.state]
    mend = Markup(" <b>{}</b>").format(html.with_micro_sign(check.mend)) if check.mend else Markup()
    label = Markup('<span role="img" aria-label="{}">{}</span>').format(word, html.icon(sign, 17))
    text = Markup("<span>{}{}</span>").format(html.with_micro_sign(check.found), mend)
    return Markup('<div class="{state}" role="listitem">{label}<em>{what}</em>{text}</div>').format(
        state=check.state, label=label, what=check.what, text=text
    )


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
    why = html.with_micro_sign(" ".join(change.why))
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
    return Markup('<div class="wv-lab" style="margin-top:4px">{}</div>').format(html.with_micro_sign(words))
