"""Calibrations of the instrument: list of the kinds, the chosen one with its result and values, and its history."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import date
from functools import partial
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.run_chart import MOST_POINTS, HistoryPoint, history_chart_html
from wafer_viewer.draw.number_format import NOTHING, number, plural, share, value_and_u
from wafer_viewer.gui.dialogs.dialog import Confirm, Dialog, ask, sign_dialog
from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html, NumberOrEmpty
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.gauge import day
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Command
from wafer_viewer.gui.widgets.number_field import option_label
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import (
    KINDS,
    NOT_MEASURED,
    CalibrationKind,
    CalibrationOption,
    CalibrationRecord,
    Characteristic,
)
from wafer_viewer.session.calibration.calibration_controller import FOCUS_RANGE_UM
from wafer_viewer.session.state.instrument_state import CalibrationHistory, CalibrationState, PendingCalibration
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

ICON = viser.Icon
NOT_RUN, NOT_KEPT, NOT_DISCARDED = "Calibration failed", "Nothing was kept", "The result was not discarded"
NOT_READ = "The calibrations were not read"
MOST_ROWS = 12
"""Number of newest calibrations of a kind in the table of the history."""
SIMULATED = Markup('<em class="wv-sim alone">SIMULATED</em>')


def calibration_list(here: Here[None]) -> Elements | None:
    """Return the kinds of calibration; a click chooses one."""
    view = here.view
    if not view.at_instrument:
        return None
    listed = kinds_list(here.snapshot.calibration, view.calibration) + not_measured()
    return [Html(listed)]


def calibration_dock(here: Here[None]) -> Elements:
    """Return the history of the chosen kind."""
    chart = history_chart(here.snapshot.calibration.history(here.view.calibration))
    return [Html(Markup('<div class="wv-below">{}</div>').format(chart))]


def instrument_step(here: Here[None]) -> Elements | None:
    """Return one kind of calibration: what runs, the result that waits, signed values, and what comes next."""
    page, snapshot, view = here.page, here.snapshot, here.view
    if not view.at_instrument or view.explains:
        return None
    state, kind = snapshot.calibration, view.calibration
    history, pending = state.history(kind), state.pending
    damaged = html.note("fault", NOT_READ, state.problem) if state.problem else Markup()
    own = pending is not None and pending.result.kind == kind
    why = why_not_keep(snapshot) if own else why_not_run(snapshot, kind)
    look = "" if own else " wv-at-foot"  # the button that discards is there
    values = in_force(history) + history_table(history) + next_scans(snapshot.rig.calibration)
    away = Button("Discard…", partial(discard, page), ICON.TRASH, commands=True, failed=NOT_DISCARDED)
    return [
        Html(kind_title(kind) + next_due(state, kind)),
        Html(page.notes(snapshot) + damaged),
        Html(running(snapshot) + waiting(pending, state, kind)),
        Html(values),
        Html(html.why_not(why, look)),
        Buttons([away], 34, at_foot=True) if own else None,
        _lead(page, kind, own=own, possible=why is None),
    ]


INSTRUMENT_PICKS: Picks[None] = {
    "gauge-look": lambda here, look: look_at(here.page, instrument=look == "instrument"),
    "calibration-kind": lambda here, kind: here.page.change(calibration=kind),
    "calibration-live": lambda here, _: here.page.change(step="plan", live=True),
}


def _lead(page: Page, kind: CalibrationKind, *, own: bool, possible: bool) -> Button:
    """Return the leading button: keep a result of this kind, evaluate the gauge checks, or run on the rig."""
    if own:
        label, icon, act, failed = "Keep…", ICON.SIGNATURE, keep, NOT_KEPT
    elif KINDS[kind].source == "gauge checks":
        label, icon, act, failed = "Evaluate the checks", ICON.MATH_FUNCTION, run, NOT_RUN
    else:
        label, icon, act, failed = "Run here…", ICON.PLAYER_PLAY, run, NOT_RUN
    action = "Calibration accepted" if own else None
    return Button(
        label,
        partial(act, page),
        icon,
        "leading",
        disabled=not possible,
        commands=True,
        action=action,
        failed=failed,
        key=label,
    )


def instrument_commands(page: Page) -> list[Command]:
    """Return the commands of the instrument."""

    def command(name: str, act: Callable[[], None], icon: Any, why_not: Any = no_result) -> Command:
        return Command(name, None, act, icon, group="Gauge check", here=_at_instrument, why_not=why_not)

    def possible(snapshot: Snapshot, view: View) -> str | None:
        return why_not_run(snapshot, view.calibration)

    def in_gauge(_: Snapshot, view: View) -> bool:
        return view.step == "gauge"

    def other() -> None:
        look_at(page, instrument=not page.view.instrument)

    name, icon = "Gauge blocks or instrument", ICON.MICROSCOPE
    return [
        Command(name, None, other, icon, group="Gauge check", here=in_gauge),
        command("Run the calibration…", partial(run, page), ICON.PLAYER_PLAY, possible),
        command("Keep the calibration…", partial(keep, page), ICON.SIGNATURE),
        command("Discard the calibration…", partial(discard, page), ICON.TRASH),
    ]


def no_result(snapshot: Snapshot, _: View) -> str | None:
    """Require a result that waits."""
    return None if snapshot.calibration.pending is not None else "no result waits."


def _at_instrument(_: Snapshot, view: View) -> bool:
    return view.at_instrument


def look_at(page: Page, *, instrument: bool) -> None:
    """Show the instrument or the gauge blocks."""
    page.change(instrument=instrument, why=None)
    if instrument:  # the command line may have added a record
        page.ask(NOT_READ, page.session.calibration.refresh())


def run(page: Page) -> None:
    """Evaluate the gauge checks, or ask for the options of a calibration on the rig."""
    kind = page.view.calibration
    if KINDS[kind].source == "gauge checks":
        page.ask(NOT_RUN, page.session.calibration.run(kind))
    else:
        run_dialog(page, kind)


def keep(page: Page) -> None:
    """Open the dialog that signs the result; it repeats the values and asks for a name and a reason."""
    if (pending := page.session.snapshot.calibration.pending) is None:
        return
    below = "It is recorded permanently, and the next scans use it. Datasets stay as they are."
    simulated = SIMULATED if pending.simulated else Markup()
    value = in_words(pending.result.characteristics[0])
    sign_dialog(
        page,
        f"Keep: {KINDS[pending.result.kind].title}?",
        below,
        Markup('<div style="padding:2px 0 8px"><b>{}</b> {}</div>').format(value, simulated),
        ("Keep and sign", ICON.SIGNATURE),
        page.session.calibration.keep,
        NOT_KEPT,
        signer=("Signed by", "Who signs the calibration; recorded in the log"),
    )


def discard(page: Page) -> None:
    """Open the dialog that discards the result."""
    if (pending := page.session.snapshot.calibration.pending) is None:
        return
    below = "Nothing is recorded, and the values in force stay. This cannot be undone."
    away = Confirm("Discard the result", ICON.TRASH, lambda _: page.session.calibration.discard(), NOT_DISCARDED)
    ask(page, f"Discard: {KINDS[pending.result.kind].title}?", below, away)


Given = Mapping[str, float | None]
"""Values of a run by name: the options of its kind, `focus_range_um` and `exposure_us`."""


def run_dialog(page: Page, kind: CalibrationKind) -> None:
    """Open the dialog that runs a calibration at the present position of the stage, with its options."""
    one, limits = KINDS[kind], page.session.snapshot.rig.limits

    def contents(here: Dialog[Given]) -> Elements:
        def field(name: str, label: str, hint: str, **limits: Any) -> NumberOrEmpty:
            put: Callable[[float | None], None] = lambda value: here.hold({**here.own, name: value})  # noqa: E731 - short
            return NumberOrEmpty(label, here.own.get(name), put, hint, **limits)

        camera = limits.camera if limits is not None else None
        least, most = (camera.exposure_min_us, camera.exposure_max_us) if camera is not None else (None, None)
        return [
            Html(place(here.snapshot.rig, one.needs)),
            *(field(o.name, option_label(o), o.about, **_limits(o)) for o in one.options),
            field("focus_range_um", "z range, µm", "Range about this z in which the focus is searched, µm", over=0),
            field("exposure_us", "Exposure, µs", "For all frames; empty: found automatically", least=least, most=most),
        ]

    def begin(here: Dialog[Given]) -> Any:
        given = {option.name: here.own[option.name] for option in one.options}
        focus_range_um = here.own["focus_range_um"] or FOCUS_RANGE_UM
        return page.session.calibration.run(kind, focus_range_um, here.own["exposure_us"], **given)

    own = {option.name: option.default for option in one.options}
    own |= {"focus_range_um": FOCUS_RANGE_UM, "exposure_us": None}
    below = f"{one.about} The stage moves: check that nothing is in the way."
    Dialog(page, f"Run here: {one.title}", below, Confirm("Run here", ICON.PLAYER_PLAY, begin, NOT_RUN), own, contents)


def _limits(option: CalibrationOption) -> dict[str, Any]:
    whole = isinstance(option.default, int)
    return {"least": 1 if whole else 0, "integer": whole}


def kind_title(kind: CalibrationKind) -> Markup:
    """Return the title of a kind, with what it needs, and the link to the live picture for one on the rig."""
    one = KINDS[kind]
    live = Markup('<span class="wv-action" {}>See it live</span>').format(html.pick("calibration-live"))
    return html.title(one.title, f"Needs {one.needs}.", live if one.source == "rig" else "")


def next_due(state: CalibrationState, chosen: CalibrationKind) -> Markup:
    """Return the link to the next kind in the order of work that is due; empty if no other one is."""
    order = tuple(KINDS)
    after = order.index(chosen) + 1
    due: list[CalibrationKind] = [kind for kind in order[after:] + order[: after - 1] if state.history(kind).is_due]
    if not due:
        return Markup()
    link = html.link(KINDS[due[0]].title, "calibration-kind", due[0])
    return Markup('<div class="wv-lab" style="margin-top:6px">Next due: {}</div>').format(link)


def kinds_list(state: CalibrationState, chosen: CalibrationKind) -> Markup:
    """Return the kinds in the order of work, each with its first value and due day; a click chooses one."""
    n_due = state.n_due
    head = html.head("Calibrations", f"{n_due} due" if n_due else "none due", first=True)
    rows = Markup("").join(_kind_row(state.history(kind), kind == chosen) for kind in KINDS)
    return Markup('{}<div class="wv-kinds">{}</div>').format(head, rows)


def not_measured() -> Markup:
    """Return the characteristics that no calibration here measures, and what they need."""
    rows = Markup("").join(
        Markup("<div><b>{}</b><span>{}</span></div>").format(titled(name), needs)
        for name, needs in NOT_MEASURED.items()
    )
    return Markup('{}<div class="wv-kinds still">{}</div><div style="height:8px"></div>').format(
        html.head("Not measured here"), rows
    )


def running(snapshot: Snapshot) -> Markup:
    """Return the running calibration: its step, its progress, and the link that cancels it; empty without one."""
    now = snapshot.calibration.running
    if now is None:
        return Markup()
    work = next((work for work in snapshot.works if work.title == now.title), None)
    cancel = Markup("<span>stopping</span>") if work is not None and work.stopping else Markup()
    if work is not None and work.cancellable:
        cancel = html.command_link("Cancel", "cancel", work.id)
    return Markup(
        '{head}<div class="wv-calibrating" role="status">'
        '<div class="wv-big" style="font-size:30px">{share}</div><div>{words}</div>{bar}'
        '<div class="wv-lab">Cancel brings the rig to rest; nothing is recorded. {cancel}</div></div>'
    ).format(
        head=html.head(now.title),
        share=share(now.fraction, 0),
        words=now.words or "Starting",
        bar=html.bar(now.fraction),
        cancel=cancel,
    )


def waiting(pending: PendingCalibration | None, state: CalibrationState, kind: CalibrationKind) -> Markup:
    """Return the result that waits, or the link to it while another kind is shown; empty without one."""
    if pending is None:
        return Markup()
    own = pending.result.kind
    if own == kind:
        return result(pending, state.history(own))
    link = html.link("Show it", "calibration-kind", own)
    return html.note("attention", "A result is waiting", f"{KINDS[own].title}: keep or discard it.", link)


def result(pending: PendingCalibration, history: CalibrationHistory) -> Markup:
    """Return the result that waits: every characteristic before and now with its U, then large changes and notes."""
    found, simulated = pending.result, SIMULATED if pending.simulated else Markup()
    head = html.head("Result, not applied yet", Markup("{} k = 2").format(simulated))
    rows = [_result_row(one, _before(one, history)) for one in found.characteristics]
    table = html.table(["", "Before", "Now", "U"], rows, " nnn")
    sets = "" if found.sets else "For information: the next scans do not use it."
    return head + table + _changes(found.characteristics, history) + _lines((*found.notes, sets))


def in_force(history: CalibrationHistory) -> Markup:
    """Return the values of the newest signed calibration with U, days and signature; a note before the first."""
    record = history.newest
    if record is None:
        return html.head("Signed value") + html.empty("Not measured yet.", "Its values with U will be shown here.")
    simulated = SIMULATED if record.simulated else Markup()
    rows = [_value_row(one) for one in record.result.characteristics]
    pairs = [("Made", _day(record.at)), (_due_word(history), _day(record.due)), ("Signed by", record.signed_by)]
    if record.why:
        pairs.append(("Reason", record.why))
    head = html.head("Signed value", Markup("{} k = 2").format(simulated))
    return head + html.table(["", "Value", "U"], rows, " nn") + html.pairs(pairs)


def history_table(history: CalibrationHistory) -> Markup:
    """Return the signed calibrations of a kind, newest first; empty before the second."""
    records = history.records
    if len(records) < 2:
        return Markup()
    unit = html.typeset(records[-1].result.characteristics[0].unit)
    rows = [_history_row(record) for record in reversed(records[-MOST_ROWS:])]
    heads = ["Day", f"Value, {unit}" if unit not in ("", "1") else "Value", "U", "Signed by"]
    return html.head("History", str(len(records))) + html.table(heads, rows, " nn ")


def history_chart(history: CalibrationHistory) -> Markup:
    """Return the panel below the scene: the first characteristic of a kind over its calibrations."""
    title = KINDS[history.kind].title
    if not history.records:
        head = Markup('<div class="wv-dock"><b>{}</b></div>').format(title)
        empty = html.empty("Signed values of this calibration are drawn here, each with its U.")
        return Markup('{}<div class="wv-run-empty">{}</div>').format(head, empty)
    newest = history.records[-1].result.characteristics[0]
    label = labelled(newest)
    n, shown = len(history.records), min(len(history.records), MOST_POINTS)
    counted = f"last {shown} of {n}" if shown < n else plural(n, "calibration")
    head = Markup(
        '<div class="wv-dock wv-run-head"><b>{}</b><span class="dim wv-cut" title="{}">{}</span>{}'
        '<span class="wv-end"><span class="wv-hint">bars are U, k = 2</span></span></div>'
    ).format(label, counted, counted, SIMULATED if history.records[-1].simulated else "")
    points = [_point(record) for record in history.records]
    return head + history_chart_html(points, f"History of {newest.name}", label)


def next_scans(calibration: Calibration | None) -> Markup:
    """Return the values that the next scans use, with U."""
    if calibration is None:
        return html.head("The next scans use") + html.empty("The rig has no calibration.")
    rows = [
        _plain_row("Pixel size, µm", calibration.pixel_um, 2 * calibration.u_pixel_um),
        _plain_row("Camera rotation, mrad", calibration.camera_rotation_rad * 1e3, _milli(calibration)),
        _plain_row("Trigger delay, µs", calibration.trigger_delay_us, _twice(calibration.u_trigger_delay_us)),
        _plain_row("z scale", calibration.z_scale, 2 * calibration.u_z_scale * calibration.z_scale, 6),
    ]
    simulated = SIMULATED if calibration.simulated else ""
    due = Markup("{} k = 2 · due {}").format(simulated, _day(calibration.due))
    table = html.table(["", "Value", "U"], rows, " nn")
    return html.head("The next scans use", due) + table + Markup('<div style="height:10px"></div>')


def why_not_run(snapshot: Snapshot, kind: CalibrationKind) -> str | None:
    """Return why a calibration cannot be run now, to follow "Not yet:"; None if it can."""
    rig, state = snapshot.rig, snapshot.calibration
    if state.running is not None:
        return "a calibration is running."
    if state.pending is not None:
        return "keep or discard the result first."
    if KINDS[kind].source == "gauge checks":
        return None
    if snapshot.scanning:
        return "a scan is running. Stop it or wait for its end."
    if not snapshot.draft.confirmed:
        return "the sample on the stage is not confirmed. Confirm it in Plan."
    if rig.state != "ready":
        reasons = {"working": f"the rig is at work ({rig.message}).", "moving": "the stage is moving."}
        return reasons.get(rig.state, f"the rig is not ready ({rig.state}).")
    return None if rig.calibration is not None else "the rig has no calibration to start from."


def why_not_keep(snapshot: Snapshot) -> str | None:
    """Return why the result cannot be kept now, to follow "Not yet:"; None if it can."""
    return "a scan is running. Keep it when it has ended." if snapshot.scanning else None


def place(rig: RigStatus, needs: str) -> Markup:
    """Return what a calibration needs under the objective, and the position of the stage."""
    axes = " · ".join(
        f"{axis} {number(um / 1000, 4, signed=True)}"
        for axis, um in (("X", rig.x_um), ("Y", rig.y_um), ("Z", rig.z_um))
    )
    return Markup('<div class="wv-calibration-place"><div>Under the objective</div><b>{}</b>{}</div>').format(
        titled(needs), html.pairs([("Here", f"{axes} mm")])
    )


def in_words(one: Characteristic) -> str:
    """Return a characteristic in words, ``Trigger delay 62.6 ± 4.7 µs``."""
    return f"{titled(one.name)} {_with_u(one)}"


def titled(name: str) -> str:
    """Return the name of a characteristic with a capital; symbols of axes stay small."""
    return name if name.startswith(("x-", "z ")) else name[:1].upper() + name[1:]


def labelled(one: Characteristic) -> str:
    """Return the name of a characteristic with its unit."""
    return titled(one.name) if one.unit in ("", "1") else f"{titled(one.name)}, {html.typeset(one.unit)}"


def _kind_row(history: CalibrationHistory, chosen: bool) -> Markup:
    title, record = KINDS[history.kind].title, history.newest
    sign, tone = (viser.Icon.ALERT_TRIANGLE, "attention") if history.is_due else (viser.Icon.CIRCLE_CHECK, "good")
    if record is None:
        value, due = f"needs {KINDS[history.kind].needs}", "not measured"
    else:
        one = record.result.characteristics[0]
        value, due = f"{_with_u(one)} · {_day(record.at)}", f"{_due_word(history)} {_day(record.due)}"
        due += " · SIMULATED" if record.simulated else ""
    return Markup(
        '<div class="go{sel}" aria-label="{title}, {due}" aria-pressed="{pressed}" {pick}>'
        '<i style="color:var(--{tone})">{icon}</i>'
        '<b>{title}</b><span>{value}</span><span style="color:var(--{tone})">{due}</span></div>'
    ).format(
        sel=" sel" if chosen else "",
        title=title,
        due=due[:1].lower() + due[1:],
        pressed=str(chosen).lower(),
        pick=html.pick("calibration-kind", history.kind),
        tone=tone,
        icon=html.icon(sign, 17),
        value=value,
    )


def _with_u(one: Characteristic) -> str:
    value, u = value_and_u(one.value, one.expanded)
    unit = "" if one.unit in ("", "1") else f" {html.typeset(one.unit)}"
    return f"{value} ± {u}{unit}"


def _value_row(one: Characteristic) -> Markup:
    value, u = value_and_u(one.value, one.expanded)
    name = Markup('<span title="{}">{}</span>').format(one.standard or one.name, labelled(one))
    return html.row([name, value, u], " nn")


def _result_row(one: Characteristic, before: Characteristic | None) -> Markup:
    value, u = value_and_u(one.value, one.expanded)
    old = _old_value(one, before)
    shown = NOTHING if old is None else value_and_u(old, one.expanded)[0]
    return html.row([labelled(one), shown, Markup("<b>{}</b>").format(value), u], " nnn")


def _history_row(record: CalibrationRecord) -> Markup:
    one = record.result.characteristics[0]
    value, u = value_and_u(one.value, one.expanded)
    signed = Markup('<span class="wv-cut wv-short" title="{why}">{by}</span>').format(
        why=record.why or record.signed_by, by=record.signed_by
    )
    return html.row([_day(record.at), value, u, signed], " nn ")


def _before(one: Characteristic, history: CalibrationHistory) -> Characteristic | None:
    """Return the characteristic of the same name in the newest signed calibration."""
    record = history.newest
    if record is None:
        return None
    return next((old for old in record.result.characteristics if old.name == one.name), None)


def _old_value(one: Characteristic, before: Characteristic | None) -> float | None:
    """Return the value in force before: that of the calibration, else that of the newest record."""
    return one.before if one.before is not None else before.value if before is not None else None


def _changes(found: Sequence[Characteristic], history: CalibrationHistory) -> Markup:
    """Return a note about the changes that are larger than their U."""
    large: list[str] = []
    for one in found:
        before = _before(one, history)
        old = _old_value(one, before)
        if old is not None and one.expanded > 0 and abs(one.value - old) > one.expanded:
            change = value_and_u(one.value - old, one.expanded, signed=True)[0]
            unit = "" if one.unit in ("", "1") else f" {one.unit}"
            large.append(f"{titled(one.name)} {change}{unit}")
    if not large:
        return Markup()
    text = f"{'; '.join(large)}. Check sample, objective and cables before you keep it."
    return html.note("attention", "It differs from before by more than its U", text)


def _lines(notes: Sequence[str]) -> Markup:
    lines = Markup("").join(Markup("<div>{}</div>").format(html.typeset(note)) for note in notes if note)
    return Markup('<div class="wv-notes">{}</div>').format(lines) if lines else Markup()


def _point(record: CalibrationRecord) -> HistoryPoint:
    one = record.result.characteristics[0]
    title = f"{_day(record.at)} · {_with_u(one)} · {record.signed_by}"
    return HistoryPoint(one.value, one.expanded, _day(record.at), title)


def _plain_row(name: str, value: float, expanded: float | None, digits: int = 2) -> Markup:
    shown, u = value_and_u(value, expanded or None, digits)
    return html.row([name, shown, u if expanded else "not known"], " nn")


def _milli(calibration: Calibration) -> float | None:
    u = _twice(calibration.u_camera_rotation_rad)
    return u * 1e3 if u is not None else None


def _twice(u: float | None) -> float | None:
    return 2 * u if u is not None else None


def _due_word(history: CalibrationHistory) -> str:
    return "Due since" if history.is_due else "Due"


def _day(moment: str) -> str:
    return day(date.fromisoformat(moment[:10]))
