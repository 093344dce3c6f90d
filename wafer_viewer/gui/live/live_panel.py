"""Panel of the live view: drive, light, area and depth to scan, and their use for the plan."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, share, value_and_u, with_unit
from wafer_viewer.gui.live.jog_pad import JogPad, pad_html, step_words
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callback_timing import MOVE_S, Debouncer
from wafer_viewer.gui.widgets.command import Command
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    HtmlBlock,
    command_button,
    controlled,
    in_a_row,
    leading,
    set_prop,
    with_decimals,
)
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.number_field import OptionalNumber, number_of, role_label, text_of
from wafer_viewer.model.acquisition.positioners import PositionerState
from wafer_viewer.session.acquisition.live_controller import LiveLook, exposure_us
from wafer_viewer.session.planning.plan_editor import covering_grid, one_field
from wafer_viewer.session.state.live_state import LiveFrame, LiveState
from wafer_viewer.session.state.snapshot import Snapshot

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


NOT_MOVED = "The positioner did not move"
ELSEWHERE = "\u2013"
"""Choice that is shown while a positioner is at none of its named positions."""


class PositionerRow:
    """Row of one positioner, which moves when the typing pauses: half a number is no goal."""

    def __init__(self, page: Page, state: PositionerState) -> None:
        self._page, self._name, self._limits = page, state.reading.name, state.limits
        self._edits = Debouncer(self._move, guarded(page, NOT_MOVED), MOVE_S)
        handle = controlled(self._handle())
        self._input: BoundInput[str] = BoundInput(handle, lambda _: self._edits.made(), page, NOT_MOVED)

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
        self._page.ask(NOT_MOVED, answer)
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
