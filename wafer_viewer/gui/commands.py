"""Hotkeys, each of them also in the command palette (Ctrl + K). W A S D Q E and the arrows belong to the camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser

from wafer_viewer.gui.guard import guarded
from wafer_viewer.gui.page import Page


@dataclass(frozen=True, slots=True)
class Command:
    """One thing to do, its key, and what it is called in the palette."""

    name: str
    key: Any
    act: Callable[[], Any]
    icon: Any = None
    modifier: Any = None


def add_commands(page: Page, commands: list[Command]) -> None:
    """Make commands known to the browser."""
    for command in commands:
        handle = page.gui.add_command(command.name, hotkey=command.key, modifier=command.modifier, icon=command.icon)
        handle.on_trigger(guarded(page, f"{command.name} came to nothing")(lambda _, c=command: c.act()))


def looking(look: Callable[[str], None]) -> list[Command]:
    """Ways to look at the scene."""
    ways = (
        ("Top", "T", "top"),
        ("Front", "F", "front"),
        ("Three-quarter view", "I", "iso"),
        ("Show all", "home", "all"),
    )
    return [Command(name, key, lambda w=way: look(w), viser.Icon.EYE) for name, key, way in ways]
