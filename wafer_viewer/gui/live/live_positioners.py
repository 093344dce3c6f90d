"""Rows of the positioners in the panel of Live: a number with its unit, or a choice of named positions."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callback_timing import MOVE_S, Debouncer
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, controlled, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.number_field import OptionalNumber, number_of, role_label, text_of
from wafer_viewer.model.acquisition.positioners import PositionerState
from wafer_viewer.session.state.snapshot import Snapshot

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
