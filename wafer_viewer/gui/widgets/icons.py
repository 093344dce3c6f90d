"""viser's icons, its archive of five thousand opened once: viser opens it anew for each icon, 60 ms a time."""

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
    """The text of an icon's ``<svg>`` element."""
    with _reading:
        return _archive().read(f"{name}.svg").decode()


@functools.cache
def _archive() -> zipfile.ZipFile:
    return zipfile.ZipFile(viser._icons.ICONS_DIR / "tabler-icons.zip")


def quicken() -> None:
    """Have viser's own widgets take their icons from here. Pinned to viser 1.1, whose internals these are."""
    for module in (viser._icons, viser._gui_api, viser._gui_handles):
        vars(module)["svg_from_icon"] = svg
