"""One thing to do with its key: known to the browser, and in the command palette (Ctrl + K)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import viser

from wafer_viewer.gui.guard import guarded
from wafer_viewer.gui.page import Page

Group = Literal["Go to", "Look", "Plan", "Acquire", "Surface", "Measure", "Review", "Report", "Page"]
_SPOKEN = {"escape": "Esc", "pageup": "Page Up", "pagedown": "Page Down", "home": "Home", "enter": "Enter"}
_MODIFIERS = {"cmd/ctrl": "Ctrl", "shift": "Shift", "alt": "Alt"}


@dataclass(frozen=True, slots=True)
class Command:
    """One thing to do, its key, what it is called in the palette, and under which head it stands there.

    listed: whether the sheet of keys has a line for it.
    """

    name: str
    key: Any
    act: Callable[[], Any]
    icon: Any = None
    modifier: Any = None
    group: Group = "Page"
    listed: bool = True

    @property
    def spoken_key(self) -> str:
        """Its key as people say it, ``Ctrl + Shift + Z``; empty without one."""
        return spoken(self.key, self.modifier) if self.key else ""


def spoken(key: str, modifier: str | None = None) -> str:
    """A key with what is held down beside it, as people say it."""
    held = [_MODIFIERS[part] for part in modifier.split("+")] if modifier else []
    return " + ".join([*held, _SPOKEN.get(key, key.upper())])


def add_commands(page: Page, commands: Sequence[Command]) -> None:
    """Make commands known to the browser."""
    for command in commands:
        handle = page.gui.add_command(
            command.name,
            description=command.group,
            hotkey=command.key,
            modifier=command.modifier,
            icon=command.icon,
        )
        handle.on_trigger(guarded(page, f"{command.name} came to nothing")(lambda _, c=command: c.act()))


def looking(look: Callable[[str], None]) -> list[Command]:
    """Ways to look at the scene."""
    ways = (
        ("Top", "T", "top"),
        ("Front", "F", "front"),
        ("Three-quarter view", "I", "iso"),
        ("Show all", "home", "all"),
    )
    return [Command(name, key, lambda w=way: look(w), viser.Icon.EYE, group="Look") for name, key, way in ways]
