"""Commands registered with the browser: those that apply to the present state, under their present names.

A command that is not possible notifies why when it is chosen, by key or in the palette.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.command import Command
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.html import with_micro_sign
from wafer_viewer.session.state.snapshot import Snapshot

Source = Callable[[Snapshot], Sequence[Command]]
Name = tuple[str, Any, Any]
"""Name, key and modifier of a command."""


class Palette:
    """Registration of the fixed commands and of `more`, which depend on the snapshot."""

    def __init__(self, page: Page, commands: Sequence[Command], more: Source) -> None:
        self._page, self._commands, self._more = page, commands, more
        self._known: dict[Name, Any] = {}

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the browser's list up to date."""
        everything = (*self._commands, *self._more(snapshot))
        now = {_name(c): c for c in everything if c.here is None or c.here(snapshot, view)}
        for gone in self._known.keys() - now.keys():
            self._known.pop(gone).remove()
        for name, command in now.items():
            if name not in self._known:
                self._known[name] = self._add(command)

    def _add(self, command: Command) -> Any:
        handle = self._page.gui.add_command(
            command.name,
            description=command.group,
            hotkey=command.key,
            modifier=command.modifier,
            icon=command.icon,
        )
        heard = guarded(self._page, f"{command.name} failed")(lambda _: carry_out(self._page, command))
        handle.on_trigger(heard)
        return handle


def carry_out(page: Page, command: Command) -> None:
    """Carry out a command, or notify why it is not possible."""
    why = command.why_not(page.session.snapshot, page.view) if command.why_not is not None else None
    if why is None:
        command.act()
    else:
        page.say(command.name.removesuffix("…"), f"Not now: {with_micro_sign(why)}", "attention")


def _name(command: Command) -> Name:
    return command.name, command.key, command.modifier
