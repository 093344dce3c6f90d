"""Saved views, stored with the dataset, links to them, and the camera pose that survives a reload."""

from __future__ import annotations

from functools import partial
from typing import Any
from urllib.parse import quote

import msgspec
import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.gui.dialogs.dialog import Confirm, ask_name, ask_text
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import not_on_defect, surface_not_shown
from wafer_viewer.gui.scene.camera_presets import CameraPose
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.state.view_state import SavedCamera, View, keep_standpoint
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Command, spoken, with_precondition
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.job import SavedView
from wafer_viewer.session.state.snapshot import Snapshot

WITH_KEYS = 9
"""Number of views that have a key, shift and their number."""
LOOKED = ("look", "colour_by", "colours", "range_um", "exaggeration", "hillshade", "all_in_focus", "show", "levelling")
"""Fields of the view that are stored in a saved view."""


class SavedViews:
    """Commands of saved views: save, go to, link to, rename, delete, undo."""

    def __init__(self, page: Page, scene: SceneView) -> None:
        self._page, self._scene = page, scene
        page.on_pick("view", lambda key: self.go_to(int(key)))
        page.on_pick("view-link", lambda key: self._tell_link(int(key)))
        page.on_pick("view-linked", self._follow)
        page.on_pick("view-save", lambda _: self.ask_name())
        page.on_pick("view-rename", lambda key: self._ask_other_name(int(key)))
        page.on_pick("view-delete", lambda key: self._delete(int(key)))
        page.on_pick("view-undo", lambda _: page.ask("Nothing was undone", page.session.notebook.undo()))

    def commands(self) -> list[Command]:
        """Return the command that saves a view."""
        save = Command("Save view…", "0", self.ask_name, viser.Icon.BOOKMARK_PLUS, "shift", "Look")
        return with_precondition(surface_not_shown, save)

    def going(self, snapshot: Snapshot) -> list[Command]:
        """Return the commands that go to the saved views; the first ones have their numbers as keys."""
        return [self._going_to(saved) for saved in snapshot.notebook.book.views] if snapshot.dataset is not None else []

    def _going_to(self, saved: SavedView) -> Command:
        key, held = (f"{saved.number}", "shift") if saved.number <= WITH_KEYS else (None, None)
        name = f"Go to view: {saved.name}"
        act, elsewhere = partial(self.go_to, saved.number), not_on_defect
        return Command(name, key, act, viser.Icon.BOOKMARK, held, "Look", listed=False, here=elsewhere)

    def ask_name(self) -> None:
        """Open the dialog that saves the camera pose and the display settings under a name."""
        page, pose = self._page, self._scene.pose
        if page.session.snapshot.dataset is None or pose is None or not page.view.on_surface:
            return
        view, verb, field = page.view, page.session.notebook.save_view, "Without a name it is called by its number"
        below = "Kept with the dataset: every browser can come back to it."
        save = lambda dialog: verb(saved(view, pose, dialog.own))  # noqa: E731 - short
        answer = Confirm("Save view", viser.Icon.BOOKMARK_PLUS, save, "The view was not saved")
        ask_text(page, "Save view", below, ("Name", "", field), answer)

    def go_to(self, number: int) -> None:
        """Go to a saved view."""
        page, saved = self._page, self._page.session.snapshot.notebook.book.view(number)
        if saved is None:
            return
        step = page.view.step if page.view.on_surface else "surface"
        page.change(step=step, frame_k=None, slice_z_um=None, why=None, **choices(saved, page.session.snapshot))
        self._scene.draw(page.session.snapshot, page.view)  # before the camera moves: another surface is framed anew
        self._scene.go_to(CameraPose(np.array(saved.position_mm), np.array(saved.look_at_mm)))

    def _tell_link(self, number: int) -> None:
        """Say that the address of the page, which its script has changed, leads to a view."""
        saved = self._page.session.snapshot.notebook.book.view(number)
        if saved is not None:
            told = "The address of this page leads to it now: copy it and send it to whoever may open this page."
            self._page.say(f"Link to {saved.name}", told, "good")

    def _follow(self, link: str) -> None:
        """Go to the view that the address of the page names, ``number:dataset``."""
        number, _, name = link.partition(":")
        data = self._page.session.snapshot.dataset
        if data is None or data.path.name != name:
            self._page.say("The view is of another dataset", f"This link leads to {name}: open it first.", "attention")
        elif self._page.session.snapshot.notebook.book.view(int(number)) is None:
            self._page.say("The view is gone", f"{name} has no view {number} any more.", "attention")
        else:
            self.go_to(int(number))

    def _ask_other_name(self, number: int) -> None:
        page, saved = self._page, self._page.session.snapshot.notebook.book.view(number)
        if saved is None:
            raise DatasetError(f"There is no view {number}: it was deleted.")
        rename = partial(page.session.notebook.rename_view, number)
        ask_name(page, "Rename the view", "The name appears in every browser's list.", saved.name, rename)

    def _delete(self, number: int) -> None:
        self._page.ask("The view was not changed", self._page.session.notebook.delete_view(number))


def saved(view: View, pose: CameraPose, name: str) -> SavedView:
    """Return the saved view of a browser's view and camera pose; lengths are rounded to 1e-6 mm."""
    x, y, z = (round(float(mm), 6) for mm in pose.position)
    at_x, at_y, at_z = (round(float(mm), 6) for mm in pose.look_at)
    looked = {key: getattr(view, key) for key in LOOKED}
    return SavedView(name=name, position_mm=(x, y, z), look_at_mm=(at_x, at_y, at_z), **looked)


def choices(saved: SavedView, snapshot: Snapshot) -> dict[str, Any]:
    """Return the view changes of a saved view; unknown styles get the default, a missing field the whole surface."""
    looked = {key: getattr(saved, key) for key in LOOKED}
    data = snapshot.dataset
    if saved.show > 0 and (data is None or saved.show not in data.stamps):
        looked["show"] = 0
    try:
        valid = msgspec.convert({key: looked[key] for key in ("look", "colour_by")}, View)
    except msgspec.ValidationError:
        return {**looked, "look": View().look, "colour_by": View().colour_by}
    return {**looked, "look": valid.look, "colour_by": valid.colour_by}


def views_html(snapshot: Snapshot, view: View) -> Markup:
    """Return the list of the left panel as HTML; empty without a surface."""
    if not view.on_surface or snapshot.dataset is None:
        return Markup()
    state = snapshot.notebook
    rows = [_row(saved, snapshot.dataset.path.name) for saved in state.book.views]
    listed = html.table([], rows) if rows else ""
    undone = state.can_undo and view.step != "review"  # where judgements are taken back, too
    undo = html.command_link("undo", "view-undo") if undone else Markup()
    save = html.command_link("Save view…", "view-save", title="Key Shift + 0")
    title = "3000 px wide, with scale and colours · Key P"
    picture = Markup('<span class="wv-link" title="{}" {}>Picture</span>').format(title, html.pick("picture"))
    foot = Markup('<div style="display:flex;justify-content:space-between;margin:4px 6px 6px">{}{}{}</div>').format(
        save, picture, undo
    )
    return html.head("Views") + listed + foot


def _row(saved: SavedView, dataset: str) -> Markup:
    key = Markup("<kbd>{}</kbd>").format(spoken(str(saved.number), "shift")) if saved.number <= WITH_KEYS else Markup()
    name = Markup('<span class="wv-cut wv-short" title="Look from here" {}>{}</span>').format(
        html.pick("view", saved.number), saved.name
    )
    link = Markup(
        '<span class="wv-act" title="{0}" aria-label="{0}" data-link="view={1}&amp;of={2}" {3}>{4}</span>'
    ).format(
        f"Link to {saved.name}",
        saved.number,
        quote(dataset, safe=""),
        html.pick("view-link", saved.number),
        html.icon(viser.Icon.LINK, 14),
    )
    return html.row(
        [
            name,
            key,
            link
            + _act("view-rename", saved, "Rename", viser.Icon.PENCIL)
            + _act("view-delete", saved, "Delete", viser.Icon.TRASH),
        ],
        "  n",
    )


def _act(what: str, saved: SavedView, word: str, sign: Any) -> Markup:
    label = f"{word} {saved.name}"
    attributes = Markup('title="{}" aria-label="{}"').format(label, label)
    return Markup('<span class="wv-act" {} {}>{}</span>').format(
        attributes, html.command_pick(what, saved.number), html.icon(sign, 14)
    )


MOVED_MM = 1e-5


class Viewpoint:
    """Saves and restores the camera pose of a dataset or step."""

    def __init__(self, page: Page, scene: SceneView) -> None:
        self._page, self._scene = page, scene
        self._saved: SavedCamera | None = None

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Restore the camera pose on the first call; save it later whenever it has changed."""
        key = camera_key(snapshot, view)
        if self._saved is None:
            self._saved = self._page.recalled.standpoint
            if self._saved.of == key:
                self._scene.reopen(CameraPose(np.array(self._saved.position_mm), np.array(self._saved.look_at_mm)))
            return
        pose = self._scene.pose
        if pose is not None and not (key == self._saved.of and _same(pose, self._saved)):
            self._saved = SavedCamera(key, _vector(pose.position), _vector(pose.look_at))
            keep_standpoint(self._page.client, self._saved)


def camera_key(snapshot: Snapshot, view: View) -> str:
    """Return the key of a camera pose: the dataset's path on a surface, else the step."""
    data = snapshot.dataset
    return f"{data.path}" if view.on_surface and data is not None else view.step


def _same(pose: CameraPose, saved: SavedCamera) -> bool:
    now = (*_vector(pose.position), *_vector(pose.look_at))
    return all(abs(a - b) < MOVED_MM for a, b in zip(now, (*saved.position_mm, *saved.look_at_mm), strict=True))


def _vector(place: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in place)
    return x, y, z
