"""Panel of the live view: drive, light, area and depth to scan, and their use for the plan."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, share, value_and_u, with_unit
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import MOVE_S, Debouncer, guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    Command,
    HtmlBlock,
    command_button,
    controlled,
    in_a_row,
    leading,
    set_prop,
    with_decimals,
)
from wafer_viewer.gui.widgets.number_field import OptionalNumber, number_of, role_label, text_of
from wafer_viewer.model.acquisition.positioners import PositionerState
from wafer_viewer.session.acquisition.live_controller import LiveLook, exposure_us
from wafer_viewer.session.planning.plan_editor import covering_grid, one_field
from wafer_viewer.session.state.instrument_state import LiveFrame, LiveState
from wafer_viewer.session.state.snapshot import Snapshot

# -------------------------------------------------------------------------------------------------------------- jog pad


STEPS_UM = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Steps in x and y."""
Z_SHARE = 1 / 50
"""Step in z as a share of that in x and y: a field is about fifty depths of field wide."""
FAST = 10
"""Factor with Shift."""
JOG_STEPS_S = 4.0
"""Steps in a second of a jog."""
NOT_MOVED = "The stage did not move"
_ICON = viser.Icon
KEYS: tuple[tuple[int, str, Any, str], ...] = (
    (7, "Step ÷", _ICON.MINUS, "step"),
    (8, "Y +", _ICON.ARROW_UP, "xy"),
    (9, "Z up", _ICON.ARROW_BAR_TO_UP, "z"),
    (4, "X \u2212", _ICON.ARROW_LEFT, "xy"),
    (5, "Focus", _ICON.FOCUS_CENTERED, "focus"),
    (6, "X +", _ICON.ARROW_RIGHT, "xy"),
    (1, "Step ×", _ICON.PLUS, "step"),
    (2, "Y \u2212", _ICON.ARROW_DOWN, "xy"),
    (3, "Z down", _ICON.ARROW_BAR_TO_DOWN, "z"),
)
"""Digit, name, icon and kind, in the order of a keypad."""


@dataclass(frozen=True, slots=True)
class JogWord:
    """Word of the script: number of the press, direction of each axis, and whether Shift is held."""

    hold: int
    x: int
    y: int
    z: int
    fast: bool


def parse_word(key: str) -> JogWord:
    """Parse the word of a held key."""
    hold, x, y, z, fast = (int(part) for part in key.split(","))
    return JogWord(hold, x, y, z, bool(fast))


def parse_step(key: str) -> JogWord:
    """Parse the word of a tapped key."""
    return parse_word(f"0,{key}")


def next_step_um(step_um: float, by: int) -> float:
    """Return the next larger or smaller step."""
    nearest = min(range(len(STEPS_UM)), key=lambda k: abs(STEPS_UM[k] - step_um))
    return STEPS_UM[min(max(nearest + by, 0), len(STEPS_UM) - 1)]


def distances_um(word: JogWord, step_um: float) -> tuple[float, float, float]:
    """Return the step of a word along x, y and z in um."""
    along = step_um * (FAST if word.fast else 1)
    return word.x * along, word.y * along, word.z * along * Z_SHARE


def pad_html() -> Markup:
    """Return the pad. It stays the same, so that it keeps the focus."""
    keys = Markup("").join(
        Markup('<span class="wv-key {kind}" data-n="{n}"><kbd>{n}</kbd>{icon}<b>{name}</b></span>').format(
            kind=kind, n=n, icon=html.icon(sign, 18), name=name
        )
        for n, name, sign, kind in KEYS
    )
    return Markup(
        '<div class="wv-pad" role="application" tabindex="0" aria-label="Drive the stage: the digits as on a keypad; '
        'Escape leaves" data-needs-control>{}</div>'
    ).format(keys)


def step_words(step_um: float) -> Markup:
    """Return the steps, and what Shift and a held key do."""
    return Markup(
        '<div class="wv-steps"><span>Step, X and Y<b>{}</b></span><span>Step, Z<b>{}</b></span>'
        "<small><kbd>Shift</kbd> ten times. Hold a key: it jogs, and stops when you let go.</small></div>"
    ).format(with_unit(step_um, 0), with_unit(step_um * Z_SHARE, 1))


class JogPad:
    """Words of the pad's script to commands of the session; a word that is overtaken by a later one is dropped."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._lock = threading.Lock()
        self._hold = 0
        """Latest press; words of an earlier one come late."""
        self._released = False
        page.on_pick("live-jog", self._jog)
        page.on_pick("live-step", self._step)
        page.on_pick("live-smaller", lambda _: self._resize(-1))
        page.on_pick("live-larger", lambda _: self._resize(1))
        page.on_pick("live-watch", self._watch)
        page.on_close(self._let_go)

    def _jog(self, key: str) -> None:
        word = parse_word(key)
        at_rest = not (word.x or word.y or word.z)
        with self._lock:
            if word.hold < self._hold or (word.hold == self._hold and self._released):
                return
            self._hold, self._released = word.hold, at_rest
            step_um = self._page.view.jog_step_um
            speeds = (JOG_STEPS_S * um for um in distances_um(word, step_um))
            answer = self._page.session.live.jog(word.hold, *speeds)
        self._page.ask(NOT_MOVED, answer)

    def _step(self, key: str) -> None:
        step = distances_um(parse_step(key), self._page.view.jog_step_um)
        self._page.ask(NOT_MOVED, self._page.session.live.step(*step))

    def _resize(self, by: int) -> None:
        self._page.change(jog_step_um=next_step_um(self._page.view.jog_step_um, by))

    def _watch(self, _: str) -> None:
        """Keep the view on; a browser that only looks on sees it while the holder of the controls does."""
        page = self._page
        if page.session.snapshot.control.holds(page.browser.key):
            page.ask("The live view did not begin", page.session.live.watch())

    def _let_go(self) -> None:
        """Stop a jog of a page that closes."""
        with self._lock:
            if self._hold and not self._released:
                self._released = True
                answer: Future[None] = self._page.session.live.jog(self._hold, 0.0, 0.0, 0.0)
                answer.add_done_callback(lambda done: done.exception())


# ----------------------------------------------------------------------------------------------------------- live panel


NOT_FOUND, NOT_USED, NOT_MARKED = "The focus was not found", "The plan was not changed", "Nothing was marked"
NOT_EXPOSED = "The exposure was not changed"
ICON = viser.Icon
HISTOGRAM_PX = 44


class LivePanel:
    """Panel at the right while Plan shows the camera."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()
        page.on_pick("live-focus", lambda _: self._go_to_focus())
        page.on_pick("live-keep", lambda _: self._keep_picture())

    def commands(self) -> list[Command]:
        """Return the commands with their keys."""
        live = self._page.session.live

        def at_bench(_: Snapshot, view: View) -> bool:
            return view.at_bench

        def in_plan(_: Snapshot, view: View) -> bool:
            return view.step == "plan"

        marks = (
            ("Corner 1 is here", lambda: live.mark_corner(0), ICON.MAP_PIN),
            ("Corner 2 is here", lambda: live.mark_corner(1), ICON.MAP_PIN),
            ("Lowest is here", lambda: live.mark_end("lowest"), ICON.ARROW_BAR_TO_DOWN),
            ("Highest is here", lambda: live.mark_end("highest"), ICON.ARROW_BAR_TO_UP),
            ("Remove the marks", live.clear_marks, ICON.X),
        )
        return [
            Command("Sample or live picture", "C", self._toggle, ICON.VIDEO, group="Plan", here=in_plan),
            Command("Go to focus", None, self._go_to_focus, ICON.FOCUS_CENTERED, group="Plan", here=at_bench),
            Command("Keep the live picture", None, self._keep_picture, ICON.PHOTO_DOWN, group="Plan", here=at_bench),
            Command("Up to safe z", None, self._up, ICON.ARROW_BAR_TO_UP, group="Plan", here=at_bench),
            *(
                Command(
                    name, None, lambda act=act: self._page.ask(NOT_MARKED, act()), icon, group="Plan", here=at_bench
                )
                for name, act, icon in marks
            ),
        ]

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the panel."""
        set_prop(self._folder, "visible", view.at_bench)
        if not view.at_bench:
            return
        live, look = snapshot.live, self._page.session.live.look()
        free = snapshot.rig.state in ("ready", "moving")
        self._notes.show(self._page.notes(snapshot))
        self._steps.show(step_words(view.jog_step_um))
        self._free.show("" if free else html.style_sheet(".wv-pad{opacity:.45;pointer-events:none}"))
        self._search.show(_search_words(snapshot, look))
        self._light.show(_light(look.frame))
        if not self._exposure_edits.under_way:
            self._exposure.show(exposure_us(snapshot))
        self._positioners.show(snapshot)
        self._where.show(html.head("Where to scan", _area_words(snapshot)))
        self._deep.show(html.head("How deep", _depth_words(live)))
        for handle in self._marks:
            set_prop(handle, "disabled", not free)
        for handle in self._drives:
            set_prop(handle, "disabled", snapshot.rig.state != "ready")
        nothing = live.area_um is None and live.range_um is None
        set_prop(self._use, "disabled", nothing)
        why = "Not yet: mark two corners, or the lowest and the highest point." if nothing else ""
        self._why.show(why and Markup('<div class="wv-why">{}</div>').format(why))

    def _build(self) -> None:
        page, gui = self._page, self._page.gui
        HtmlBlock(gui, html.title("Live", "Drive the sample, then tell the scan where and how deep."))
        self._notes = HtmlBlock(gui)
        state = Markup('<em class="wv-keys-off">click the pad for keys</em><em class="wv-keys-on">keys on · Esc</em>')
        HtmlBlock(gui, html.head("Drive", state))
        HtmlBlock(gui, pad_html())
        self._free = HtmlBlock(gui, padded=False)
        self._steps = HtmlBlock(gui)
        JogPad(page)
        self._drives = (
            self._button("Go to focus", ICON.FOCUS_CENTERED, NOT_FOUND, self._go_to_focus),
            self._button("Up to safe z", ICON.ARROW_BAR_TO_UP, "The stage did not move", self._up),
        )
        in_a_row(gui, self._drives)
        self._search = HtmlBlock(gui)
        self._light = HtmlBlock(gui)
        exposure = controlled(with_decimals(gui.add_number("Exposure, µs", 100.0, min=1.0, step=10.0), 2))
        self._exposure_edits = Debouncer(self._set_exposure, guarded(page, NOT_EXPOSED), MOVE_S)
        self._exposure: BoundInput[float] = BoundInput(
            exposure, lambda _: self._exposure_edits.made(), page, NOT_EXPOSED
        )
        self._positioners = PositionerRows(page)
        live = page.session.live
        self._where = HtmlBlock(gui)
        corners = (
            self._mark("Corner 1 is here", ICON.CIRCLE_NUMBER_1, lambda: live.mark_corner(0)),
            self._mark("Corner 2 is here", ICON.CIRCLE_NUMBER_2, lambda: live.mark_corner(1)),
        )
        in_a_row(gui, corners)
        self._deep = HtmlBlock(gui)
        ends = (
            self._mark("Lowest is here", ICON.ARROW_BAR_TO_DOWN, lambda: live.mark_end("lowest")),
            self._mark("Highest is here", ICON.ARROW_BAR_TO_UP, lambda: live.mark_end("highest")),
        )
        in_a_row(gui, ends)
        self._marks = (*corners, *ends)
        HtmlBlock(gui, Markup('<div class="wv-lab wv-live-hint">Or drag the two grips of the curve below.</div>'))
        self._why = HtmlBlock(gui)
        self._use = self._button("Use for the plan", ICON.CHECK, NOT_USED, self._use_for_plan)
        leading(gui, self._use)

    def _button(self, label: str, icon: Any, failed: str, act: Any) -> Any:
        return command_button(self._page.gui, label, icon, guarded(self._page, failed)(lambda _: act()))

    def _mark(self, label: str, icon: Any, act: Any) -> Any:
        return self._button(label, icon, NOT_MARKED, lambda: self._page.ask(NOT_MARKED, act()))

    def _toggle(self) -> None:
        self._page.change(live=not self._page.view.live)

    def _up(self) -> None:
        self._page.ask("The stage did not move", self._page.session.live.up_to_safe_z())

    def _set_exposure(self) -> Future[Any]:
        answer = self._page.session.live.set_exposure(float(self._exposure.value))
        self._page.ask(NOT_EXPOSED, answer)
        return answer

    def _go_to_focus(self) -> None:
        self._page.ask(NOT_FOUND, self._page.session.live.go_to_focus())

    def _keep_picture(self) -> None:
        """Store the latest frame in the data folder, and offer the file for download."""
        page = self._page

        def kept(path: Path) -> None:
            page.say("Picture saved", str(path))
            page.client.send_file_download(path.name, path.read_bytes())

        page.ask("The picture was not saved", page.session.live.keep_picture(), kept)

    def _use_for_plan(self) -> None:
        page = self._page

        def used(_: object) -> None:
            page.change(live=False)
            page.say("The plan follows the marks", "Undo brings the plan before back: Ctrl + Z.")

        page.ask(NOT_USED, page.session.live.use_for_plan(), used)


def _search_words(snapshot: Snapshot, look: LiveLook) -> Markup:
    """Return the focus found at this place, or what the search does."""
    trace, limits = look.trace, snapshot.rig.limits
    if trace.peak_um is not None and trace.u_um is not None:
        value, u = value_and_u(trace.peak_um, 2 * trace.u_um, 2, signed=True)
        text = f"Focus found here at z {value} ± {u} µm (k = 2)."
    elif limits is not None:
        reach = with_unit(6 * limits.depth_of_field_um, 0)
        text = f"Go to focus looks ± {reach} around, farther if it has to, and ends on the best."
    else:
        text = ""
    return Markup('<div class="wv-lab">{}</div>').format(text)


def _light(frame: LiveFrame | None) -> Markup:
    """Return head and histogram of the light."""
    if frame is None:
        return html.head("Light") + html.empty("The histogram of the picture", "will be shown here.")
    white = 65535 if frame.image.dtype.itemsize == 2 else 255
    limit = Markup('<b class="{}">{}</b>').format("fault" if frame.saturated else "", share(frame.saturated, 2))
    words = Markup("brightest <b>{}</b> of {} · at the limit {}").format(
        number(frame.brightest, 0), number(white, 0), limit
    )
    return html.head("Light", words) + histogram_svg(frame.histogram)


def histogram_svg(counts: tuple[int, ...]) -> Markup:
    """Return the histogram with square roots of the counts; the last class, at the limit, is red."""
    most = max(counts, default=0) or 1
    bars = "".join(
        f"M{k} {HISTOGRAM_PX}V{HISTOGRAM_PX * (1 - (n / most) ** 0.5):.1f}h1V{HISTOGRAM_PX}z"
        for k, n in enumerate(counts)
        if n
    )
    return Markup(
        '<div class="wv-live-hist"><svg viewBox="0 0 {n} {h}" preserveAspectRatio="none" role="img" '
        'aria-label="Histogram of grey values"><path d="{bars}"/><rect x="{last}" width="1" height="{h}"/></svg></div>'
    ).format(n=len(counts), h=HISTOGRAM_PX, bars=bars, last=len(counts) - 1)


def _area_words(snapshot: Snapshot) -> str:
    live, limits = snapshot.live, snapshot.rig.limits
    if live.area_um is None or limits is None:
        n_marked = sum(corner is not None for corner in live.corners)
        return f"{n_marked} of 2 corners marked"
    (xa, ya), (xb, yb) = live.area_um
    job = snapshot.draft.job
    grid = job.grid if job is not None and job.grid is not None else one_field(limits)
    grid = covering_grid(grid, (0.0, 0.0), (abs(xa - xb), abs(ya - yb)))
    n = grid.rows * grid.cols
    return f"{number(abs(xa - xb), 0)} × {with_unit(abs(ya - yb), 0)} · {n} field{'s' if n > 1 else ''}"


def _depth_words(live: LiveState) -> str:
    low, high = live.lowest_um, live.highest_um
    if low is None and high is None:
        return "not marked"
    ends = f"{number(low, 1, signed=True)} … {with_unit(high, 1, signed=True)}"
    return ends if low is None or high is None else f"{ends} · {with_unit(high - low, 1)}"


POSITIONER_NOT_MOVED = "The positioner did not move"
ELSEWHERE = "\u2013"
"""Choice that is shown while a positioner is at none of its named positions."""


class PositionerRow:
    """Row of one positioner, which moves when the typing pauses: half a number is no goal."""

    def __init__(self, page: Page, state: PositionerState) -> None:
        self._page, self._name, self._limits = page, state.reading.name, state.limits
        self._edits = Debouncer(self._move, guarded(page, POSITIONER_NOT_MOVED), MOVE_S)
        handle = controlled(self._handle())
        self._input: BoundInput[str] = BoundInput(handle, lambda _: self._edits.made(), page, POSITIONER_NOT_MOVED)

    def show(self, state: PositionerState, free: bool) -> None:
        """Show the position, unless another is being typed or driven to."""
        self._input.enable(free)
        if not self._edits.under_way:
            self._input.show(shown_value(state))

    def _handle(self) -> Any:
        gui, role = self._page.gui, self._limits.descriptor
        if self._limits.named:
            return gui.add_dropdown(role.title, (ELSEWHERE, *self._limits.named), initial_value=ELSEWHERE)
        return OptionalNumber(gui, role_label(role)).handle

    def _move(self) -> Future[Any] | None:
        text = self._input.value
        to = text if self._limits.named else number_of(text, role_label(self._limits.descriptor))
        if to is None or to == ELSEWHERE:
            return None
        answer = self._page.session.live.set_positioner(self._name, to)
        self._page.ask(POSITIONER_NOT_MOVED, answer)
        return answer


class PositionerRows:
    """Rows of the positioners of the rig; they are built when the rig names them."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folder = page.gui.add_folder(None, visible=False)
        self._rows: dict[str, PositionerRow] = {}
        self._words: HtmlBlock | None = None

    def show(self, snapshot: Snapshot) -> None:
        """Update the rows."""
        states = snapshot.rig.positioners
        if states and not self._rows:
            self._build(states)
        set_prop(self._folder, "visible", bool(states))
        free = snapshot.rig.state in ("ready", "moving")
        for state in states:
            self._rows[state.reading.name].show(state, free)
        if self._words is not None:
            self._words.show(html.head("Instrument", words(states)))

    def _build(self, states: tuple[PositionerState, ...]) -> None:
        with self._folder:
            self._words = HtmlBlock(self._page.gui)
            self._rows = {state.reading.name: PositionerRow(self._page, state) for state in states}


def shown_value(state: PositionerState) -> str:
    """Return the value of a row: the named position, or the number; empty while it is not homed."""
    limits, at = state.limits, state.reading
    if limits.named:
        return at.named or ELSEWHERE
    return "" if at.position is None else text_of(round(at.position, limits.descriptor.digits))


def words(states: tuple[PositionerState, ...]) -> str:
    """Return which positioners are not homed, and what turning them does to z."""
    lost = [state.limits.descriptor.title for state in states if state.reading.position is None]
    if lost:
        return f"not homed: {', '.join(lost)}"
    return "z goes up before it turns" if any(state.limits.descriptor.lifts_z for state in states) else ""
