"""Commands with keyboard shortcuts, also listed in the command palette (Ctrl + K)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import viser

from wafer_viewer.gui.state.view_state import View
from wafer_viewer.session.state.snapshot import Snapshot

Group = Literal["Go to", "Look", "Plan", "Acquire", "Surface", "Measure", "Gauge check", "Review", "Report", "Page"]
Obstacle = Callable[[Snapshot, View], str | None]
"""Returns the reason why a command is unavailable, phrased to follow "Not now:"; None if available (see
page/preconditions.py)."""
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
    """A command with its key, its title in the palette and its group.

    listed: True if the list of keys contains it.
    why_not: returns the reason for its unavailability, shown when it is chosen nevertheless.
    here: returns whether the command exists in the current state; otherwise palette and keys ignore it.
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
        """Key with its modifiers, ``Ctrl + Shift + Z``; empty without a key."""
        return spoken(self.key, self.modifier) if self.key else ""


def spoken(key: str, modifier: str | None = None) -> str:
    """Return a key with its modifiers as display text."""
    held = [_MODIFIERS[part] for part in modifier.split("+")] if modifier else []
    return " + ".join([*held, _SPOKEN.get(key, key.upper())])


def with_precondition(why_not: Obstacle, *commands: Command) -> list[Command]:
    """Return the commands with a common precondition; existing ones take precedence."""
    return [replace(command, why_not=command.why_not or why_not) for command in commands]


def looking(look: Callable[[str], None]) -> list[Command]:
    """Return the commands for the camera presets."""
    ways = (
        ("Top", "T", "top"),
        ("Front", "F", "front"),
        ("Three-quarter view", "I", "iso"),
        ("Show all", "home", "all"),
    )
    return [Command(name, key, lambda w=mode: look(w), viser.Icon.EYE, group="Look") for name, key, mode in ways]
