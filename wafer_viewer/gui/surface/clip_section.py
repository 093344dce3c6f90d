"""Clip box of a point cloud: its six faces as numbers, and buttons that place or remove it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import viser

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.clip_box import ClipBoxFaces
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, button, in_a_row, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.clipping import Box, Span

FAILED = "The clip box was not changed"
DECIMALS = 2
Ends = tuple[float, float]
AXES = ("X", "Y", "Z")


class ClipSection:
    """Section shown for point clouds; the handles on the faces of the box in the scene are equivalent."""

    def __init__(self, page: Page, seen_um: Callable[[], Box | None]) -> None:
        self._page = page
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            HtmlBlock(gui, html.head("Clip box", "Drag its balls, or type"))
            self._ends = [self._field(axis) for axis in range(3)]
            place = [
                self._button("To view", viser.Icon.EYE, seen_um),
                self._button("To selection", viser.Icon.MARQUEE_2, lambda: page.view.selection),
            ]
            in_a_row(gui, place, 30)
            ends = [
                self._button("Whole surface", viser.Icon.BOX, self._whole),
                button(gui, "Reset", viser.Icon.X, lambda _: self._reset()),
            ]
            in_a_row(gui, ends, 30)
            self._to_selection, self._reset_button = place[1], ends[1]

    def show(self, view: View) -> None:
        """Bring the section up to date."""
        there = view.look == "points"
        set_prop(self._folder, "visible", there)
        if not there:
            return
        known = self._known(view)
        for axis, field in enumerate(self._ends):
            field.enable(known is not None)
            if known is not None:
                low, high = known[axis]
                field.show((round(low, DECIMALS), round(high, DECIMALS)))
        set_prop(self._to_selection, "disabled", view.selection is None)
        set_prop(self._reset_button, "disabled", view.clip.box_um is None and view.clip.heights_um is None)

    def _button(self, label: str, icon: Any, box: Callable[[], Box | None]) -> Any:
        return button(self._page.gui, label, icon, guarded(self._page, FAILED)(lambda _: self._put(box())))

    def _known(self, view: View) -> tuple[Ends, Ends, Ends] | None:
        """Return the extent of the box along each axis; the whole surface where nothing is clipped."""
        on_show = self._page.on_show
        if on_show is None:
            return None
        x0, y0, x1, y1 = view.clip.box_um or on_show.box_um
        return (x0, x1), (y0, y1), view.clip.heights_um or all_heights_um(self._page, on_show)

    def _whole(self) -> Box:
        on_show = self._page.on_show
        if on_show is None:
            raise MeasureError("The surface is not drawn yet: place the box when it is.")
        return on_show.box_um

    def _field(self, axis: int) -> BoundInput[Any]:
        handle = self._page.gui.add_vector2(f"{AXES[axis]}, µm", (0.0, 0.0), step=0.1)
        return BoundInput(handle, lambda event: self._type(axis, event.target.value), self._page, FAILED)

    def _type(self, axis: int, ends: Ends) -> None:
        low, high = float(ends[0]), float(ends[1])
        if not low < high:
            raise MeasureError(f"{AXES[axis]} ends at {high:g} um, before it begins at {low:g} um: swap them.")
        known = self._known(self._page.view)
        if known is None:
            return
        if axis == 2:
            self._clip(heights_um=(low, high))
            return
        (x0, x1), (y0, y1) = known[:2]
        self._clip(box_um=(low, y0, high, y1) if axis == 0 else (x0, low, x1, high))

    def _put(self, box_um: Box | None) -> None:
        """Clip to a rectangle in stage um; None clips to all of the surface, so that its faces can be dragged."""
        self._clip(box_um=box_um or self._whole())

    def _reset(self) -> None:
        self._clip(box_um=None, heights_um=None)

    def _clip(self, **changes: Box | Span | None) -> None:
        self._page.change(clip=replace(self._page.view.clip, **changes))  # pyright: ignore[reportArgumentType]


def clip_box_callback(page: Page) -> Callable[[ClipBoxFaces, str], ClipBoxFaces]:
    """Return the callback for the box dragged in the scene; a face that was never moved clips nothing."""

    def moved(faces: ClipBoxFaces, key: str) -> ClipBoxFaces:
        clip, on_show = page.view.clip, page.on_show
        if key.startswith("z") and on_show is not None:
            low, high = clip.heights_um or all_heights_um(page, on_show)
            to_um = faces.heights_um[int(key[1])]
            clip = replace(clip, heights_um=(low, to_um) if key[1] == "1" else (to_um, high))
        else:
            clip = replace(clip, box_um=faces.box_um)
        page.change(clip=clip)
        return ClipBoxFaces(clip.box_um or faces.box_um, clip.heights_um or faces.heights_um)

    return moved


def all_heights_um(page: Page, on_show: DisplayedSurface) -> Span:
    """Return the lowest and the highest displayed point, um; includes rejected points if they are drawn."""
    told = page.statistics
    if told is None or not told.n_heights:
        return on_show.heights_um
    low, high = told.span_um if told.counts else on_show.heights_um
    if told.refused is not None and told.refused.n_heights:
        low, high = min(low, told.refused.span_um[0]), max(high, told.refused.span_um[1])
    return low, high
