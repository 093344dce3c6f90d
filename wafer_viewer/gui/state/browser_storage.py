"""Browser state that persists over a reload: identity, panel layout, camera and view.

It is stored in the browser itself. Settings of one dataset are restored for that dataset only.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, TypeVar, get_type_hints

import msgspec
import viser

from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.errors import WaferViewerError, parser_errors_as
from wafer_viewer.session.state.snapshot import Fault

VIEW_KEY, SELF_KEY, CAMERA_KEY = "wafer-viewer-view", "wafer-viewer-browser", "wafer-viewer-camera"
EVERYWHERE = (
    *("step", "look", "colour_by", "colours", "exaggeration", "hillshade", "all_in_focus", "fields", "dark"),
    *("point_px", "depth_shade", "tour", "live", "jog_step_um", "instrument", "calibration"),
)
"""View settings that apply to every dataset; all others belong to the dataset they were chosen for."""
OF = "of"
WAIT_S = 15.0
"""Timeout of a storage request. A browser busy with the page answers late; without an answer the page uses defaults."""
Vector = tuple[float, float, float]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PanelLayout:
    """Widths of the side panels in pixels, and their folded state."""

    left_px: int | None = None
    right_px: int | None = None
    left_folded: bool = False
    right_folded: bool = False


@dataclass(frozen=True, slots=True)
class BrowserIdentity:
    """Identity of a browser: session key, name, panel layout and pending notes."""

    key: str = ""
    name: str = ""
    layout: PanelLayout = PanelLayout()
    notes: tuple[Fault, ...] = ()


@dataclass(frozen=True, slots=True)
class SavedCamera:
    """Saved camera position and point looked at, in mm, for the dataset `of`."""

    of: str = ""
    position_mm: Vector = (0.0, 0.0, 0.0)
    look_at_mm: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Remembered:
    """Stored state of a browser: identity, view, and the settings for the dataset `of`."""

    browser: BrowserIdentity = BrowserIdentity()
    view: View = View()
    of: str = ""
    chosen: dict[str, Any] = field(default_factory=dict)
    standpoint: SavedCamera = SavedCamera()


def recall(client: viser.ClientHandle) -> Remembered:
    """Return the stored state of a browser; the default without an answer. All items are requested concurrently."""

    def ask(key: str) -> str:
        return client.local_storage.get_item(key, timeout=WAIT_S) or "{}"

    try:
        with ThreadPoolExecutor(3, thread_name_prefix="recall") as asking:
            view, browser, camera = asking.map(ask, (VIEW_KEY, SELF_KEY, CAMERA_KEY))
    except (RuntimeError, TimeoutError):
        return Remembered()
    return replace(read(view), browser=read_self(browser), standpoint=_as(_items(camera), SavedCamera) or SavedCamera())


def read(text: str) -> Remembered:
    """Return a view from its text; settings unknown to this version are omitted."""
    stored = _items(text)
    chosen = {name: value for name, hint in _hints().items() if (value := _as(stored.get(name), hint)) is not None}
    view = View(**{name: value for name, value in chosen.items() if name in EVERYWHERE})
    rest = {name: value for name, value in chosen.items() if name not in EVERYWHERE}
    return Remembered(view=view, of=str(stored.get(OF, "")), chosen=rest)


def read_self(text: str) -> BrowserIdentity:
    """Return a browser identity from its text."""
    return _as(_items(text), BrowserIdentity) or BrowserIdentity()


def write(view: View, of: str) -> str:
    """Return a view as text, with the dataset it was chosen for."""
    return msgspec.json.encode({**{f.name: getattr(view, f.name) for f in fields(View)}, OF: of}).decode()


def keep(client: viser.ClientHandle, before: View, after: View, of: str) -> None:
    """Store the view in the browser if it has changed."""
    if before != after:
        client.local_storage.set_item(VIEW_KEY, write(after, of))


def keep_self(client: viser.ClientHandle, browser: BrowserIdentity) -> None:
    """Store the identity in the browser."""
    client.local_storage.set_item(SELF_KEY, msgspec.json.encode(browser).decode())


def keep_standpoint(client: viser.ClientHandle, standpoint: SavedCamera) -> None:
    """Store the camera pose in the browser."""
    client.local_storage.set_item(CAMERA_KEY, msgspec.json.encode(standpoint).decode())


def changed(view: View, **changes: Any) -> View:
    """Return a view with some settings changed; unknown names raise TypeError.

    Height ranges are reset when the surface or its zero changes.
    """
    unknown = set(changes) - {f.name for f in fields(View)}
    if unknown:
        raise TypeError(f"A view has no {', '.join(sorted(unknown))}.")
    after = replace(view, **changes)
    if (after.show, after.levelling) == (view.show, view.levelling):
        return after
    return replace(after, brush_um=changes.get("brush_um"), clip=replace(after.clip, heights_um=None))


@cache
def _hints() -> dict[str, Any]:
    return get_type_hints(View)


def _items(text: str) -> dict[str, Any]:
    with suppress(WaferViewerError), parser_errors_as(lambda _: WaferViewerError("It cannot be read.")):
        return msgspec.json.decode(text, type=dict[str, Any])
    return {}


def _as(value: Any, kind: type[T]) -> T | None:
    """Return a value converted to a type; None if that fails, usually for data of another version."""
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, WaferViewerError):
        return None
