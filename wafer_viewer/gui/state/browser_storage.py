"""What a browser remembers over a reload: who it is, its panels, its camera, and the look it chose.

It is kept in the browser itself. What only makes sense on one dataset is given back for that dataset alone.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, TypeVar, get_type_hints

import msgspec
import viser

from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.state.snapshot import Fault

VIEW_KEY, SELF_KEY, CAMERA_KEY = "wafer-viewer-view", "wafer-viewer-browser", "wafer-viewer-camera"
EVERYWHERE = (
    *("step", "look", "colour_by", "colours", "exaggeration", "hillshade", "all_in_focus", "fields", "dark"),
    *("point_px", "depth_shade", "tour"),
)
"""What holds for every dataset; the rest of a view belongs to the one it was chosen for."""
OF = "of"
WAIT_S = 15.0
"""A browser that is busy with the page answers late; without its answer the page begins afresh."""
Vector = tuple[float, float, float]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PanelLayout:
    """Widths of the panels at the sides in pixels, and which of them are folded away."""

    left_px: int | None = None
    right_px: int | None = None
    left_folded: bool = False
    right_folded: bool = False


@dataclass(frozen=True, slots=True)
class BrowserIdentity:
    """The browser itself: the key by which the session knows it, its name, its panels, and notes not dealt with yet."""

    key: str = ""
    name: str = ""
    layout: PanelLayout = PanelLayout()
    notes: tuple[Fault, ...] = ()


@dataclass(frozen=True, slots=True)
class SavedCamera:
    """Where the camera stood, in mm, and what it looked at."""

    of: str = ""
    position_mm: Vector = (0.0, 0.0, 0.0)
    look_at_mm: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Remembered:
    """What a browser had: itself, its view, and what it had chosen for the dataset `of`."""

    browser: BrowserIdentity = BrowserIdentity()
    view: View = View()
    of: str = ""
    chosen: dict[str, Any] = field(default_factory=dict)
    standpoint: SavedCamera = SavedCamera()


def recall(client: viser.ClientHandle) -> Remembered:
    """What this browser remembers; nothing when it has nothing, or does not answer. All is asked for at once."""

    def ask(key: str) -> str:
        return client.local_storage.get_item(key, timeout=WAIT_S) or "{}"

    try:
        with ThreadPoolExecutor(3, thread_name_prefix="recall") as asking:
            view, browser, camera = asking.map(ask, (VIEW_KEY, SELF_KEY, CAMERA_KEY))
    except (RuntimeError, TimeoutError):
        return Remembered()
    return replace(read(view), browser=read_self(browser), standpoint=_as(_items(camera), SavedCamera) or SavedCamera())


def read(text: str) -> Remembered:
    """A view from its text; what is not a choice of this version is left out."""
    kept = _items(text)
    chosen = {name: value for name, hint in _hints().items() if (value := _as(kept.get(name), hint)) is not None}
    view = View(**{name: value for name, value in chosen.items() if name in EVERYWHERE})
    rest = {name: value for name, value in chosen.items() if name not in EVERYWHERE}
    return Remembered(view=view, of=str(kept.get(OF, "")), chosen=rest)


def read_self(text: str) -> BrowserIdentity:
    """A browser from its text."""
    return _as(_items(text), BrowserIdentity) or BrowserIdentity()


def write(view: View, of: str) -> str:
    """A view as text, with the dataset it was chosen for."""
    return msgspec.json.encode({**{f.name: getattr(view, f.name) for f in fields(View)}, OF: of}).decode()


def keep(client: viser.ClientHandle, before: View, after: View, of: str) -> None:
    """Have the browser remember its view, where that has changed."""
    if before != after:
        client.local_storage.set_item(VIEW_KEY, write(after, of))


def keep_self(client: viser.ClientHandle, browser: BrowserIdentity) -> None:
    """Have the browser remember itself."""
    client.local_storage.set_item(SELF_KEY, msgspec.json.encode(browser).decode())


def keep_standpoint(client: viser.ClientHandle, standpoint: SavedCamera) -> None:
    """Have the browser remember where the camera stands."""
    client.local_storage.set_item(CAMERA_KEY, msgspec.json.encode(standpoint).decode())


def changed(view: View, **changes: Any) -> View:
    """A view with some choices changed; unknown names raise TypeError.

    Ranges of heights hold for the surface and the zero that they were chosen on.
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
    try:
        return msgspec.json.decode(text, type=dict[str, Any])
    except (msgspec.DecodeError, msgspec.ValidationError):
        return {}


def _as(value: Any, kind: type[T]) -> T | None:
    """A value as its kind; None for what is no such thing, from another version as a rule."""
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, WaferViewerError):
        return None
