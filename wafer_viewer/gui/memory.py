"""What a browser remembers over a reload: its step and the look it chose, kept in the browser itself."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import msgspec
import viser

from wafer_viewer.gui.view import View

KEY = "wafer-viewer-view"
KEPT = ("step", "look", "colour_by", "colours", "exaggeration", "hillshade", "all_in_focus", "fields", "dark")
WAIT_S = 2.0


def recall(client: viser.ClientHandle) -> View:
    """The view this browser had; a fresh one when it has none, or does not answer."""
    try:
        text = client.local_storage.get_item(KEY, timeout=WAIT_S)
    except (RuntimeError, TimeoutError):
        return View()
    return read(text) if text else View()


def read(text: str) -> View:
    """A view from its text; what is not a view, from another version as a rule, is a fresh one."""
    try:
        kept = msgspec.json.decode(text, type=dict[str, Any])
        return msgspec.convert({k: v for k, v in kept.items() if k in KEPT}, View)
    except (msgspec.DecodeError, msgspec.ValidationError):
        return View()


def write(view: View) -> str:
    """A view as text: what is kept of it."""
    return msgspec.json.encode({name: getattr(view, name) for name in KEPT}).decode()


def keep(client: viser.ClientHandle, before: View, after: View) -> None:
    """Have the browser remember, where something that is kept has changed."""
    if write(before) != write(after):
        client.local_storage.set_item(KEY, write(after))


def changed(view: View, **changes: Any) -> View:
    """A view with some choices changed; unknown names raise TypeError."""
    unknown = set(changes) - {f.name for f in fields(View)}
    if unknown:
        raise TypeError(f"A view has no {', '.join(sorted(unknown))}.")
    return replace(view, **changes)
