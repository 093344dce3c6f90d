"""One thing to do with its key: known to the browser, and in the command palette (Ctrl + K)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import viser

from wafer_viewer.gui.state.view_state import View
from wafer_viewer.session.state.snapshot import Snapshot

Group = Literal["Go to", "Look", "Plan", "Acquire", "Surface", "Measure", "Gauge check", "Review", "Report", "Page"]
Obstacle = Callable[[Snapshot, View], str | None]
"""Says why something is not possible now, in words that follow "Not now:"; None where it is (see obstacles.py)."""
_SPOKEN = {
    "escape": "Esc",
    "pageup": "Page Up",
    "pagedown": "Page Down",
    "home": "Home",
    "enter": "Enter",
    "backspace": "Backspace",
}
_MODIFIERS = {"cmd/ctrl": "Ctrl", "shift": "Shift", "alt": "Alt"}


@dataclass(frozen=True, slots=True)
class Command:
    """One thing to do, its key, what it is called in the palette, and under which head it stands there.

    listed: whether the sheet of keys has a line for it. why_not: says why it is not possible now, when it is chosen all
    the same. here: whether there is such a thing to do at all; as long as not, palette and keys do not know it.
    """

    name: str
    key: Any
    act: Callable[[], Any]
    icon: Any = None
    modifier: Any = None
    group: Group = "Page"
    listed: bool = True
    why_not: Obstacle | None = None
    here: Callable[[Snapshot, View], bool] | None = None

    @property
    def spoken_key(self) -> str:
        """Its key as people say it, ``Ctrl + Shift + Z``; empty without one."""
        return spoken(self.key, self.modifier) if self.key else ""


def spoken(key: str, modifier: str | None = None) -> str:
    """A key with what is held down beside it, as people say it."""
    held = [_MODIFIERS[part] for part in modifier.split("+")] if modifier else []
    return " + ".join([*held, _SPOKEN.get(key, key.upper())])


def unless(why_not: Obstacle, *commands: Command) -> list[Command]:
    """Commands that the same thing stands in the way of."""
    return [replace(command, why_not=command.why_not or why_not) for command in commands]


def looking(look: Callable[[str], None]) -> list[Command]:
    """Ways to look at the scene."""
    ways = (
        ("Top", "T", "top"),
        ("Front", "F", "front"),
        ("Three-quarter view", "I", "iso"),
        ("Show all", "home", "all"),
    )
    return [Command(name, key, lambda w=way: look(w), viser.Icon.EYE, group="Look") for name, key, way in ways]
