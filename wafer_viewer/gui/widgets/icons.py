"""Cached access to viser's icons: viser reopens its archive of five thousand icons for each one, 60 ms each time."""

from __future__ import annotations

import functools
import threading
import zipfile

import viser._gui_api
import viser._gui_handles
import viser._icons

_reading = threading.Lock()


@functools.cache
def svg(name: str) -> str:
    """Return the text of an icon's ``<svg>`` element."""
    with _reading:
        return _archive().read(f"{name}.svg").decode()


@functools.cache
def _archive() -> zipfile.ZipFile:
    return zipfile.ZipFile(viser._icons.ICONS_DIR / "tabler-icons.zip")


def quicken() -> None:
    """Make viser's own widgets use the cached icons. Pinned to viser 1.1, whose internals it replaces."""
    for module in (viser._icons, viser._gui_api, viser._gui_handles):
        vars(module)["svg_from_icon"] = svg
