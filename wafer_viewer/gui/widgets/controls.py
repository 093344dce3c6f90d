"""Commands of the page, and helpers for viser's widgets."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any, Literal, get_type_hints

import viser
from markupsafe import Markup, escape
from viser import _assignable_props_api as api

from wafer_viewer.gui.state.view_state import View
from wafer_viewer.session.state.snapshot import Snapshot

# -------------------------------------------------------------------------------------------------------------- command


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
    "delete": "Delete",
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


# ------------------------------------------------------------------------------------------------------------- controls


Gui = viser.GuiApi


def add_html(gui: Gui, content: Markup | Literal[""], order: float | None = None) -> viser.GuiHtmlHandle:
    """Add an element of HTML to the page; text that is not Markup is escaped."""
    return gui.add_html(str(escape(content)), order=order)


def set_props(handle: Any, **props: Any) -> None:
    """Set the properties of a viser handle that have changed."""
    for name, value in props.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)


@contextlib.contextmanager
def always_mounted(gui: Gui) -> Generator[None]:
    """Context for content that stays on the page while panels are folded, because viser removes folded content.

    Of the changes within one panel in 50 ms, viser sends only the last: what must not replace another goes into a panel
    of its own.
    """
    panel = gui.add_panel()
    with panel.add_tab("·"):
        add_html(gui, Markup('<div class="wv-ov wv-frame"></div>'))
        yield
    panel.float(x=0, y=0, width=1, height=1)


@functools.cache
def prop_types(props: type) -> dict[str, Any]:
    """Return the type of each property by name."""
    return get_type_hints(props)


def cache_prop_types() -> None:
    """Make viser use the cached types: half of the server's work to build a page. Pinned to viser 1.1."""
    hints = property(lambda handle: prop_types(type(handle._impl.props)))
    api.AssignablePropsBase._prop_hints = hints  # pyright: ignore[reportAttributeAccessIssue]
