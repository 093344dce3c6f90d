"""Live at the bench, a look of the step Plan: drive, light, area and depth to scan, and their use for the plan."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, plural, share, value_and_u, with_unit
from wafer_viewer.gui.elements.elements import (
    Button,
    Buttons,
    Dropdown,
    Elements,
    Html,
    Input,
    Number,
    NumberOrEmpty,
    Stack,
)
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import MOVE_S
from wafer_viewer.gui.widgets.controls import Command
from wafer_viewer.gui.widgets.number_field import role_label
from wafer_viewer.model.acquisition.positioners import PositionerState
from wafer_viewer.session.acquisition.live_controller import LiveLook, exposure_us
from wafer_viewer.session.planning.plan_editor import covering_grid, one_field
from wafer_viewer.session.state.instrument_state import LiveFrame, LiveState
from wafer_viewer.session.state.snapshot import Snapshot

NOT_MOVED, NOT_FOUND, NOT_USED = "The stage did not move", "The focus was not found", "The plan was not changed"
NOT_MARKED, NOT_EXPOSED = "Nothing was marked", "The exposure was not changed"
NOT_KEPT, POSITIONER_NOT_MOVED = "The picture was not saved", "The positioner did not move"
EXPOSURE_HINT = "Of the live picture and of the search for the focus"
NOTHING_MARKED = "mark two corners, or the lowest and the highest point."
ICON = viser.Icon
HISTOGRAM_PX = 44
_KEYS_ON = Markup('<em class="wv-keys-off">click the pad for keys</em><em class="wv-keys-on">keys on · Esc</em>')
_LOCKED = html.style_sheet(".wv-pad{opacity:.45;pointer-events:none}")
_GRIPS = Markup('<div class="wv-lab wv-live-hint">Or drag the two grips of the curve below.</div>')


def live_step(here: Here[JogPad]) -> Elements | None:
    """Return the panel at the right while Plan shows the camera."""
    snapshot, view, page = here.snapshot, here.view, here.page
    if not view.at_bench:
        return None
    live, look, state = snapshot.live, page.session.live.look(), snapshot.rig.state
    off, nothing = state not in ("ready", "moving"), live.area_um is None and live.range_um is None
    button = partial(Button, commands=True)
    focus = button("Go to focus", partial(_go_to_focus, page), ICON.FOCUS_CENTERED, disabled=state != "ready")
    up = button("Up to safe z", partial(_up, page), ICON.ARROW_BAR_TO_UP, disabled=state != "ready")
    marks = [button(name, partial(_mark, page, act), icon, disabled=off) for name, icon, _, act in marks_of(page)]
    use = button("Use for the plan", partial(_use_for_plan, page), ICON.CHECK, "leading", disabled=nothing)
    return [
        Html(html.title("Live", "Move the stage, then set where and how deep to scan.")),
        Html(page.notes(snapshot)),
        Html(html.head("Drive", _KEYS_ON)),
        Html(pad_html()),
        Html(_LOCKED if off else "", padded=False),
        Html(step_words(view.jog_step_um)),
        Buttons([focus, up]),
        Html(_search_words(snapshot, look)),
        Html(_light(look.frame)),
        _exposure(page, snapshot),
        Stack(_instrument(page, snapshot.rig.positioners, off)) if snapshot.rig.positioners else None,
        Html(html.head("Where to scan", _area_words(snapshot))),
        Buttons(marks[:2]),
        Html(html.head("How deep", _depth_words(live))),
        Buttons(marks[2:]),
        Html(_GRIPS),
        Html(html.why_not(NOTHING_MARKED if nothing else None)),
        use,
    ]


def live_commands(page: Page) -> list[Command]:
    """Return the commands of the live view with their keys."""

    def at_bench(_: Snapshot, view: View) -> bool:
        return view.at_bench

    def command(name: str, icon: Any, act: Callable[[], Any]) -> Command:
        return Command(name, None, act, icon, group="Plan", here=at_bench)

    def in_plan(_: Snapshot, view: View) -> bool:
        return view.step == "plan"

    def toggle() -> None:
        page.change(live=not page.view.live)

    return [
        Command("Sample or live picture", "C", toggle, ICON.VIDEO, group="Plan", here=in_plan),
        command("Go to focus", ICON.FOCUS_CENTERED, partial(_go_to_focus, page)),
        command("Keep the live picture", ICON.PHOTO_DOWN, partial(_keep_picture, page)),
        command("Up to safe z", ICON.ARROW_BAR_TO_UP, partial(_up, page)),
        *(command(name, icon, partial(_mark, page, act)) for name, _, icon, act in marks_of(page)),
        command("Remove the marks", ICON.X, partial(_mark, page, page.session.live.clear_marks)),
    ]


def marks_of(page: Page) -> list[tuple[str, Any, Any, Callable[[], Future[Any]]]]:
    """Return the marks: name, icon of the button and of the command, and the command of the session."""
    live, (low, high) = page.session.live, (ICON.ARROW_BAR_TO_DOWN, ICON.ARROW_BAR_TO_UP)
    return [
        ("Corner 1 is here", ICON.CIRCLE_NUMBER_1, ICON.MAP_PIN, partial(live.mark_corner, 0)),
        ("Corner 2 is here", ICON.CIRCLE_NUMBER_2, ICON.MAP_PIN, partial(live.mark_corner, 1)),
        ("Lowest is here", low, low, partial(live.mark_end, "lowest")),
        ("Highest is here", high, high, partial(live.mark_end, "highest")),
    ]


def _mark(page: Page, act: Callable[[], Future[Any]]) -> None:
    page.ask(NOT_MARKED, act())


def _up(page: Page) -> None:
    page.ask(NOT_MOVED, page.session.live.up_to_safe_z())


def _go_to_focus(page: Page) -> None:
    page.ask(NOT_FOUND, page.session.live.go_to_focus())


def _exposure(page: Page, snapshot: Snapshot) -> Number:
    def put(us: float) -> Future[Any]:
        return _asked(page, NOT_EXPOSED, page.session.live.set_exposure(float(us)))

    look: dict[str, Any] = {"commands": True, "failed": NOT_EXPOSED, "pause_s": MOVE_S, "step": 10.0, "decimals": 2}
    return Number("Exposure, µs", exposure_us(snapshot), put, EXPOSURE_HINT, least=1.0, **look)


def _asked(page: Page, failed: str, answer: Future[Any]) -> Future[Any]:
    """Report a failure of a command, and return it so that what was typed stands until it is done."""
    page.ask(failed, answer)
    return answer


def _keep_picture(page: Page) -> None:
    """Store the latest frame in the data folder, and offer the file for download."""

    def kept(path: Path) -> None:
        page.say("Picture saved", str(path))
        page.client.send_file_download(path.name, path.read_bytes())

    page.ask(NOT_KEPT, page.session.live.keep_picture(), kept)


def _use_for_plan(page: Page) -> None:
    def used(_: object) -> None:
        page.change(live=False)
        page.say("The plan follows the marks", "Undo restores the previous plan: Ctrl + Z.")

    page.ask(NOT_USED, page.session.live.use_for_plan(), used)


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
    return f"{number(abs(xa - xb), 0)} × {with_unit(abs(ya - yb), 0)} · {plural(n, 'field')}"


def _depth_words(live: LiveState) -> str:
    low, high = live.lowest_um, live.highest_um
    if low is None and high is None:
        return "not marked"
    ends = f"{number(low, 1, signed=True)} … {with_unit(high, 1, signed=True)}"
    return ends if low is None or high is None else f"{ends} · {with_unit(high - low, 1)}"


def _search_words(snapshot: Snapshot, look: LiveLook) -> Markup:
    """Return the focus found at this place, or what the search does."""
    trace, limits = look.trace, snapshot.rig.limits
    if trace.peak_um is not None and trace.u_um is not None:
        value, u = value_and_u(trace.peak_um, 2 * trace.u_um, 2, signed=True)
        text = f"Focus found here at z {value} ± {u} µm (k = 2)."
    elif limits is not None:
        reach = with_unit(6 * limits.depth_of_field_um, 0)
        text = f"Go to focus looks ± {reach} around, farther if needed, and stops at the best focus."
    else:
        text = ""
    return Markup('<div class="wv-lab">{}</div>').format(text)


ELSEWHERE = "\u2013"
"""Choice that is shown while a positioner is at none of its named positions."""
GOES_THERE = "It moves there after Enter or a pause in typing"


def _instrument(page: Page, states: tuple[PositionerState, ...], off: bool) -> Elements:
    return [Html(html.head("Instrument", words(states))), *(positioner(page, state, off) for state in states)]


def positioner(page: Page, state: PositionerState, off: bool = False) -> Input:
    """Return the input of a positioner: its named positions, or its position, empty while it is not homed."""
    at, role, named = state.reading, state.limits.descriptor, state.limits.named

    def move(to: str | float | None) -> Future[Any] | None:
        if to in (None, ELSEWHERE):
            return None
        return _asked(page, POSITIONER_NOT_MOVED, page.session.live.set_positioner(at.name, to))

    look: dict[str, Any] = {"disabled": off, "commands": True, "failed": POSITIONER_NOT_MOVED, "pause_s": MOVE_S}
    if named:
        return Dropdown(role.title, at.named or ELSEWHERE, move, GOES_THERE, options=(ELSEWHERE, *named), **look)
    position = None if at.position is None else round(at.position, role.digits)
    return NumberOrEmpty(role_label(role), position, move, GOES_THERE, **look)


def words(states: tuple[PositionerState, ...]) -> str:
    """Return which positioners are not homed, and what turning them does to z."""
    lost = [state.limits.descriptor.title for state in states if state.reading.position is None]
    if lost:
        return f"not homed: {', '.join(lost)}"
    return "z goes up before it turns" if any(state.limits.descriptor.lifts_z for state in states) else ""


# -------------------------------------------------------------------------------------------------------------- jog pad


STEPS_UM = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Steps in x and y."""
Z_SHARE = 1 / 50
"""Step in z as a share of that in x and y: a field is about fifty depths of field wide."""
FAST = 10
"""Factor with Shift."""
JOG_STEPS_S = 4.0
"""Steps in a second of a jog."""
KEYS: tuple[tuple[int, str, Any, str], ...] = (
    (7, "Step ÷", ICON.MINUS, "step"),
    (8, "Y +", ICON.ARROW_UP, "xy"),
    (9, "Z up", ICON.ARROW_BAR_TO_UP, "z"),
    (4, "X \u2212", ICON.ARROW_LEFT, "xy"),
    (5, "Focus", ICON.FOCUS_CENTERED, "focus"),
    (6, "X +", ICON.ARROW_RIGHT, "xy"),
    (1, "Step ×", ICON.PLUS, "step"),
    (2, "Y \u2212", ICON.ARROW_DOWN, "xy"),
    (3, "Z down", ICON.ARROW_BAR_TO_DOWN, "z"),
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
        "<small><kbd>Shift</kbd> ten times. Hold a key to jog; release it to stop.</small></div>"
    ).format(with_unit(step_um, 0), with_unit(step_um * Z_SHARE, 1))


class JogPad:
    """Words of the pad's script to commands of the session; a word that is overtaken by a later one is dropped."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._lock = threading.Lock()
        self._hold = 0
        """Latest press; words of an earlier one come late."""
        self._released = False
        page.on_close(self._let_go)

    def jog(self, key: str) -> None:
        """Jog, or stop, as the word of a held key says."""
        word = parse_word(key)
        at_rest = not (word.x or word.y or word.z)
        with self._lock:
            if word.hold < self._hold or (word.hold == self._hold and self._released):
                return
            self._hold, self._released = word.hold, at_rest
            speeds = (JOG_STEPS_S * um for um in distances_um(word, self._page.view.jog_step_um))
            answer = self._page.session.live.jog(word.hold, *speeds)
        self._page.ask(NOT_MOVED, answer)

    def _let_go(self) -> None:
        """Stop a jog of a page that closes."""
        with self._lock:
            if self._hold and not self._released:
                self._released = True
                answer: Future[None] = self._page.session.live.jog(self._hold, 0.0, 0.0, 0.0)
                answer.add_done_callback(lambda done: done.exception())


def _step(here: Here[JogPad], key: str) -> None:
    step = distances_um(parse_step(key), here.page.view.jog_step_um)
    here.page.ask(NOT_MOVED, here.page.session.live.step(*step))


def _resize(here: Here[JogPad], by: int) -> None:
    here.page.change(jog_step_um=next_step_um(here.page.view.jog_step_um, by))


def _watch(here: Here[JogPad]) -> None:
    """Keep the view on; a browser that only looks on sees it while the holder of the controls does."""
    page = here.page
    if page.session.snapshot.control.holds(page.browser.key):
        page.ask("The live view did not begin", page.session.live.watch())


LIVE_PICKS: Picks[JogPad] = {
    "live-jog": lambda here, key: here.own.jog(key),
    "live-step": _step,
    "live-smaller": lambda here, _: _resize(here, -1),
    "live-larger": lambda here, _: _resize(here, 1),
    "live-watch": lambda here, _: _watch(here),
    "live-focus": lambda here, _: _go_to_focus(here.page),
    "live-keep": lambda here, _: _keep_picture(here.page),
    "plan-look": lambda here, key: here.page.change(live=key == "live"),
}
"""What words of the pad's script and clicks do."""
