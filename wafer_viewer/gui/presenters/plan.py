"""HTML of a plan: warnings, strategies with cost, preflight checks, and the trial on stored wafers. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import ChartAxes, PlotLook, plot_html, round_ticks
from wafer_viewer.draw.charts.wafer_map import MapViewport, map_frame
from wafer_viewer.draw.colormaps import Rgb, table
from wafer_viewer.draw.number_format import THIN, duration, number, size, with_unit
from wafer_viewer.draw.quantities import format_quantity
from wafer_viewer.gui.presenters.verdict import LOOKS, state
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.plan import CoarseLook, Field, FieldFocus, FocusSweep, FollowFocus, Price, ScanPlan
from wafer_viewer.model.job import NotTried, Trial, TriedWafer, VerdictChange
from wafer_viewer.model.quantity import Word
from wafer_viewer.session.planning.preflight import PreflightCheck, State
from wafer_viewer.session.state.snapshot import Draft, Operating, Snapshot

# ---------------------------------------------------------------------------------------------------------------- focus


WINDOW_COLOUR = "#D9480F"
"""Colour of the windows of a row, on map, scene and plot."""
PALE_OVER_DEPTHS = 0.5
"""Uncertainty in depths of field over which a focus is drawn pale."""
_MAP_PX = 250
_LEAST_FOR_TEXT_PX = 19
_LINE, _BAND = "var(--accent)", 0.28


@dataclass(frozen=True, slots=True)
class FollowedPlan:
    """Plan after its coarse look: the focus of each field, and the row of fields that is shown from the side.

    whole_um: ends of the whole sweep.
    """

    plan: ScanPlan
    look: CoarseLook
    follow: FollowFocus
    focus: tuple[FieldFocus, ...]
    row: int
    whole_um: tuple[float, float]

    @property
    def in_row(self) -> list[tuple[Field, FieldFocus]]:
        """Fields of the row with their focus, by rising x."""
        pairs = [pair for pair in zip(self.plan.fields, self.focus, strict=True) if pair[0].row == self.row]
        return sorted(pairs, key=lambda pair: pair[0].x_um)

    @property
    def blank(self) -> frozenset[int]:
        """Numbers of the fields that were looked at and have no focus."""
        return frozenset(place.field for place in self.look.places if not place.found)

    @property
    def looked_at(self) -> frozenset[int]:
        """Numbers of the fields that were looked at."""
        return frozenset(place.field for place in self.look.places)

    def frame_um(self) -> tuple[float, float]:
        """Return width and height of a field."""
        return self.plan.cols * self.plan.pixel_um, self.plan.rows * self.plan.pixel_um

    def window_um(self, field: Field) -> tuple[float, float]:
        """Return the ends of the window of a field."""
        return field.z_start_um, self.plan.sweep.top_um(field)

    def colours(self) -> list[Rgb]:
        """Return the colour of the focus of each field."""
        middles = np.array([one.middle_um for one in self.focus])
        low, span = middles.min(), max(float(np.ptp(middles)), 1e-6)
        colours = table("mako")
        chosen = colours[np.clip((middles - low) / span * (len(colours) - 1), 0, len(colours) - 1).astype(int)]
        return [(int(r), int(g), int(b)) for r, g, b in chosen]

    def opacities(self) -> list[float]:
        """Return the opacity of each field, pale where its uncertainty is large."""
        u_um = np.array([one.u_um for one in self.focus])
        limit_um = PALE_OVER_DEPTHS * (self.plan.depth_of_field_um or self.plan.sweep.z_step_um)
        return np.clip(limit_um / np.maximum(u_um, 1e-6), 0.25, 1.0).tolist()


def followed(draft: Draft, row: int | None) -> FollowedPlan | None:
    """Return the plan after its coarse look; None without a look, or where another strategy is chosen.

    row: the chosen row of fields; None, or one that the plan lacks, for the middle one.
    """
    job, plan = draft.job, draft.plan
    if job is None or plan is None or job.follow_focus is None or plan.coarse_look is None or not draft.focus:
        return None
    rows = sorted({field.row for field in plan.fields})
    shown = row if row in rows else rows[len(rows) // 2]
    starts_um = [field.z_start_um for field in job.all_fields()]
    whole_um = min(starts_um), max(starts_um) + plan.sweep.range_um
    return FollowedPlan(plan, plan.coarse_look, job.follow_focus, draft.focus, shown, whole_um)


def head(draft: Draft, shown: FollowedPlan | None) -> Markup:
    """Return the head of the section: the number of places with a focus, or a note that there was no look yet."""
    if shown is None:
        note = "No coarse look yet: Start scan looks first."
        return html.head("Following") + Markup('<div class="wv-why">{}</div>').format(note)
    places = shown.look.places
    return html.head("Following", f"{len(shown.look.found)} of {len(places)} places in focus")


def windows(shown: FollowedPlan | None) -> Markup:
    """Return the map of places and windows with its legend, and the row from the side; empty without a look."""
    if shown is None:
        return Markup()
    mean = np.mean([low_high[1] - low_high[0] for low_high in map(shown.window_um, shown.plan.fields)])
    mean_text = Markup('<div class="wv-lab">Window of each field, µm · mean {}. Click a row.</div>').format(
        number(float(mean), 0)
    )
    return _map(shown) + _legend() + mean_text + _from_the_side(shown) + _no_focus(shown)


def _map(shown: FollowedPlan) -> Markup:
    """Return the map: colour of the predicted height, length of the window, places looked at and without a focus."""
    width_um, height_um = shown.frame_um()
    fields = shown.plan.fields
    frame = map_frame(fields, width_um, height_um, width_px=_MAP_PX, most_height_px=_MAP_PX)
    if frame is None:
        return Markup()
    cells = [
        _cell(shown, frame, field, colour, opacity)
        for field, colour, opacity in zip(fields, shown.colours(), shown.opacities(), strict=True)
    ]
    return Markup(
        '<svg width="{:.0f}" height="{:.0f}" role="group" aria-label="Windows of the fields" '
        'style="display:block;margin:4px auto">{}{}</svg>'
    ).format(frame.width_px, frame.height_px, Markup("").join(cells), _row_outline(shown, frame))


def _cell(shown: FollowedPlan, frame: MapViewport, field: Field, colour: Rgb, opacity: float) -> Markup:
    width_um, height_um = shown.frame_um()
    x, y = frame.x(field.x_um - width_um / 2), frame.y(field.y_um + height_um / 2)
    w, h = width_um * frame.scale, height_um * frame.scale
    low_um, high_um = shown.window_um(field)
    text = Markup()
    if w >= _LEAST_FOR_TEXT_PX:
        dark = sum(colour) < 380 and opacity > 0.6
        text = Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="middle" font-size="10" fill="{}">{}</text>').format(
            x + w / 2, y + h - 4, "#fff" if dark else "#15202b", number(high_um - low_um, 0)
        )
    sign = _sign(field.number in shown.blank, x + 7, y + 7.5) if field.number in shown.looked_at else ""
    return Markup(
        '<g {}><title>Field {}: window {} to {} µm</title>'
        '<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="#fff"/>'
        '<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="rgb{}" fill-opacity="{:.2f}" '
        'stroke="#fff" stroke-width=".8"/>{}{}</g>'
    ).format(
        html.pick("focus-row", field.row), field.number, number(low_um, 0), number(high_um, 0),
        x, y, w, h, x, y, w, h, colour, opacity, text, sign,
    )  # fmt: skip


def _sign(blank: bool, x: float, y: float) -> Markup:
    """Return the sign of a place: a ring, or an exclamation mark where it has no focus."""
    if blank:
        return Markup(
            '<g><rect x="{:.1f}" y="{:.1f}" width="11" height="12" rx="2" fill="#fff3d6" stroke="#9a6700"/>'
            '<text x="{:.1f}" y="{:.1f}" text-anchor="middle" font-size="10" font-weight="700" fill="#9a4a00">!</text>'
            "</g>"
        ).format(x - 5.5, y - 6, x, y + 3.5)
    return Markup('<circle cx="{:.1f}" cy="{:.1f}" r="3.4" fill="#fff" stroke="#15202b" stroke-width="1.4"/>').format(
        x, y
    )


def _row_outline(shown: FollowedPlan, frame: MapViewport) -> Markup:
    width_um, height_um = shown.frame_um()
    fields = [field for field, _ in shown.in_row]
    x0 = frame.x(fields[0].x_um - width_um / 2)
    x1 = frame.x(fields[-1].x_um + width_um / 2)
    y0 = frame.y(max(f.y_um for f in fields) + height_um / 2)
    y1 = frame.y(min(f.y_um for f in fields) - height_um / 2)
    return Markup(
        '<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="none" stroke="{}" stroke-width="2" '
        'pointer-events="none"/>'
    ).format(x0, y0, x1 - x0, y1 - y0, WINDOW_COLOUR)


def _legend() -> Markup:
    style = "background:#fff;border:1.5px solid #15202b;border-radius:50%;width:10px;height:10px"
    ring = Markup('<i class="wv-sw" style="{}"></i>').format(style)
    row = html.swatch("transparent", WINDOW_COLOUR)
    return html.legend([(ring, "looked at"), (Markup("<b>!</b>"), "no focus"), (row, "row from the side")])


def _no_focus(shown: FollowedPlan) -> Markup:
    """Return a note on the places without a focus; empty if there are none."""
    if not shown.blank:
        return Markup()
    n, numbers = len(shown.blank), ", ".join(map(str, sorted(shown.blank)[:8]))
    name = f"{n} place{'s' if n > 1 else ''} found no focus"
    whole = with_unit(shown.plan.sweep.range_um, 0)
    take = "It takes" if n == 1 else "They take"
    return html.note("attention", name, f"Field{'s' if n > 1 else ''} {numbers}. {take} the whole {whole}.")


def _from_the_side(shown: FollowedPlan) -> Markup:
    """Return the row from the side: focus with its uncertainty, windows, and the whole sweep dashed."""
    row, k = shown.in_row, shown.follow.coverage_factor
    width_um, _ = shown.frame_um()
    sweep, whole = shown.plan.sweep, shown.whole_um
    x_um = row[0][0].x_um - width_um / 2, row[-1][0].x_um + width_um / 2
    pad_um = 0.04 * (whole[1] - whole[0])
    ends = whole[0] - pad_um, whole[1] + pad_um
    x_mm = x_um[0] / 1000, x_um[1] / 1000
    axes = ChartAxes.stretched(x_mm, ends, round_ticks(x_mm, 5), round_ticks(ends, 5, signed=True))
    boxes = Markup("").join(_window(axes, shown, field, width_um, sweep) for field, _ in row)
    drawn = _dashed(axes, whole) + boxes + _band(axes, row, k, shown.blank)
    look = PlotLook(
        f"Row {shown.row + 1} from the side", "z, µm", "x, mm", left_px=44, right_px=8, style="height:190px"
    )
    signs = [
        (html.swatch(_LINE, _LINE), f"focus, ± {k:g} u"),
        (html.swatch("transparent", WINDOW_COLOUR), "window"),
        (html.swatch("transparent", "var(--ink3)", dashed=True), f"whole sweep, {with_unit(sweep.range_um, 0)}"),
    ]
    return html.head(f"Row {shown.row + 1} from the side") + html.legend(signs) + plot_html(axes, look, drawn)


def _window(axes: ChartAxes, shown: FollowedPlan, field: Field, width_um: float, sweep: FocusSweep) -> Markup:
    low_um, high_um = field.z_start_um, sweep.top_um(field)
    x0, x1 = (axes.x.at((field.x_um + side * 0.42 * width_um) / 1000) for side in (-1, 1))
    y0, y1 = axes.y.at(high_um), axes.y.at(low_um)
    dash = "5 4" if field.number in shown.blank else "none"
    return Markup(
        '<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="{}" fill-opacity=".12" stroke="{}" '
        'stroke-width="1.4" stroke-dasharray="{}" vector-effect="non-scaling-stroke"/>'
    ).format(x0, y0, x1 - x0, y1 - y0, WINDOW_COLOUR, WINDOW_COLOUR, dash)


def _dashed(axes: ChartAxes, whole: tuple[float, float]) -> Markup:
    (left, right), (low, high) = axes.x.span, (axes.y.at(whole[0]), axes.y.at(whole[1]))
    return Markup(
        '<path d="M{left:g} {high:.1f}H{right:g}V{low:.1f}H{left:g}Z" fill="none" stroke="var(--ink3)" '
        'stroke-width="1.3" stroke-dasharray="5 4" vector-effect="non-scaling-stroke"/>'
    ).format(left=left, right=right, low=low, high=high)


def _band(axes: ChartAxes, row: Sequence[tuple[Field, FieldFocus]], k: float, blank: frozenset[int]) -> Markup:
    """Return the range in focus, its allowance for uncertainty as a band, over the fields that have a focus."""
    known = [(axes.x.at(field.x_um / 1000), one) for field, one in row if field.number not in blank]
    if not known:
        return Markup()
    upper = [f"{x:.1f} {axes.y.at(one.high_um + k * one.u_um):.1f}" for x, one in known]
    lower = [f"{x:.1f} {axes.y.at(one.low_um - k * one.u_um):.1f}" for x, one in known]
    middle = "L".join(f"{x:.1f} {axes.y.at(one.middle_um):.1f}" for x, one in known)
    return Markup(
        '<path d="M{}Z" fill="{}" fill-opacity="{}"/>'
        '<path d="M{}" fill="none" stroke="{}" stroke-width="2" vector-effect="non-scaling-stroke"/>'
    ).format("L".join([*upper, *reversed(lower)]), _LINE, _BAND, middle, _LINE)


# ----------------------------------------------------------------------------------------------------------------- plan


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
