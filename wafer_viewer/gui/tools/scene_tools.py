"""Dispatcher of the surface tools: their selection by the view, pointer events, and markers of saved results."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import Rgb, rgb
from wafer_viewer.gui.presenters.measurement import sign_colour, symbol
from wafer_viewer.gui.scene.billboards import Billboard, corner_on_screen
from wafer_viewer.gui.scene.camera_controller import CameraController
from wafer_viewer.gui.scene.camera_presets import CameraPose, pixel_ray
from wafer_viewer.gui.scene.drag_handles import CasedLine, DrapedOutline, PlaceMark
from wafer_viewer.gui.scene.heightfield import HeightField, Place, Read, refine_height_field
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface, colours
from wafer_viewer.gui.scene.surface_tiles import SurfaceInfoCache
from wafer_viewer.gui.scene.viewport import ViewAxes
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.clip_box import NAME as CLIP
from wafer_viewer.gui.tools.clip_box import ClipBox, Moved
from wafer_viewer.gui.tools.initial_regions import first_levelling
from wafer_viewer.gui.tools.profile_lines import CursorMoved, LineTools
from wafer_viewer.gui.tools.region_tools import LevelTools, PlaceTools, outline_of
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tool_options import LevelBy, Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import Box

MOST_SIGNS = 60
"""Largest number of marked results, the newest ones, because overlapping labels are illegible."""
_LINE_PX, _SIGN_PX, _RING_PX, _UP_PX = 1.8, 20, 6.0, 1.2
_OFFSET_PX, _ABOVE_PX = 8, 16
_PATH_POINTS = 480
"""Points of a path draped on the surface, beside its own."""
_ROUND = np.linspace(0, 2 * np.pi, 24, endpoint=False)


@dataclass(frozen=True, slots=True)
class _ResultMark:
    """One result: its regions, its label and its selection."""

    places: tuple[Region, ...]
    sign: str
    colour: Rgb
    chosen: bool


class KeptMarks:
    """Markers of the saved results: one node for all outlines of a colour, one node per label."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._marks: list[_ResultMark] = []
        self._lines: dict[Rgb, CasedLine] = {}
        self._signs: list[Billboard] = []

    def show(self, findings: Sequence[AnyResult], view: View) -> None:
        """Show the results that were measured on the surface of a view."""
        marks = [_result_mark(f, view) for f in findings if f.show == view.show][-MOST_SIGNS:]
        if marks == self._marks:
            return
        self.remove()
        self._marks = marks
        outlined = {one.colour for one in marks if not one.chosen}
        self._lines = {c: CasedLine(self._scene, f"kept/line/{k}", c, _LINE_PX) for k, c in enumerate(outlined)}
        self._signs = [
            Billboard(self._scene, f"kept/sign/{k}", one.sign, one.colour, _SIGN_PX) for k, one in enumerate(marks)
        ]

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the markers on the displayed surface."""
        for colour, line in self._lines.items():
            drawn = [p for one in self._marks if one.colour == colour and not one.chosen for p in one.places]
            pieces = np.concatenate([_outline(p, height_field, view_axes.mm_per_pixel) for p in drawn])
            line.lay(pieces, None, 1.6 * view_axes.mm_per_pixel)
        for one, sign in zip(self._marks, self._signs, strict=True):
            _place(sign, one.places[0], height_field, view_axes)

    def remove(self) -> None:
        """Remove all markers from the scene."""
        for part in (*self._lines.values(), *self._signs):
            part.remove()
        self._marks, self._lines, self._signs = [], {}, []


def _result_mark(finding: AnyResult, view: View) -> _ResultMark:
    chosen = finding.number == view.selected
    colour = colours(view.dark).mark if chosen else rgb(sign_colour(finding)[1:])
    return _ResultMark(finding.drawn, symbol(finding), colour, chosen)


def _outline(region: Region, height_field: HeightField, mm_per_pixel: float) -> NDArray[np.float32]:
    """Return the segments of an outline, [n, 2, 3]: a path is draped, a point gets a ring."""
    lift = _UP_PX * mm_per_pixel
    corners = outline_of(region)
    if region.is_path:
        number = np.arange(len(corners))
        along = np.unique(np.concatenate([number, np.linspace(0, number[-1], _PATH_POINTS)]))
        x_um, y_um = (np.interp(along, number, places) for places in corners.T)
        points = height_field.drape(x_um, y_um, lift)
        return np.stack([points[:-1], points[1:]], axis=1)
    if len(corners) == 0:
        ring_um, centre = _RING_PX * 1e3 * mm_per_pixel, region.points[0]
        corners = np.stack([centre.x_um + ring_um * np.cos(_ROUND), centre.y_um + ring_um * np.sin(_ROUND)], axis=1)
    return height_field.drape_outline(corners, lift)


def _place(sign: Billboard, region: Region, height_field: HeightField, view_axes: ViewAxes) -> None:
    """Place a label at the upper left corner of a region on the screen, or at the end of a line."""
    place = Region.point(region.points[-1].x_um, region.points[-1].y_um) if region.is_path else region
    corner, up_px = (
        corner_on_screen(place, height_field, view_axes, -1, 1),
        _ABOVE_PX if region.kind == "point" else _OFFSET_PX,
    )
    sign.place(corner, height_field, view_axes, -_OFFSET_PX, up_px)


_ON_LINE_PX = 9.0
"""Largest distance of a click from the active line that moves a cursor there."""


class Tools:
    """Surface tools. Handles are moved on their own thread, so that drags are followed while tiles are pending."""

    def __init__(self, client: viser.ClientHandle, eye: CameraController, read: Read) -> None:
        self._client, self._eye, self._read = client, eye, read
        self._height_field: HeightField | None = None
        scene = client.scene
        self._lines = LineTools(scene, self._dragged, lambda lines, line: self._lined(lines, line))
        self._places = PlaceTools(scene, self._dragged, lambda places: self._placed(places), self._in_sight)
        self._level = LevelTools(scene, self._dragged, lambda levelling: self._levelled(levelling))
        self._clip = ClipBox(scene, self._dragged, lambda faces, key: self._clipped(faces, key))
        self._results = KeptMarks(scene)
        self._mark: PlaceMark | None = None
        self._lock = threading.RLock()
        self._drags, self._clicks = LatestOnlyWorker("drag"), LatestOnlyWorker("pick")
        self._picked: Callable[[float, float], None] | None = None
        self._lined: Callable[[tuple[Region, ...], int], None] = lambda lines, line: None
        self._placed: Callable[[tuple[Region, ...]], None] = lambda places: None
        self._selected: Callable[[Box], None] = lambda box: None
        self._selecting = False
        self._outline: DrapedOutline | None = None
        self._levelled: Callable[[Levelling], None] = lambda levelling: None
        self._clipped: Moved = lambda faces, key: faces

    def on_pick(self, callback: Callable[[float, float], None]) -> None:
        """Call back with the clicked position on the surface."""
        if self._picked is None:
            self._client.scene.on_click()(self._clicked)
        self._picked = callback

    def on_lines(self, callback: Callable[[tuple[Region, ...], int], None]) -> None:
        """Call back with the profile lines and the number of the moved one."""
        self._lined = callback

    def on_cursor(self, callback: CursorMoved) -> None:
        """Call back when a profile cursor was moved in the scene."""
        self._lines.on_cursor(callback)

    def on_select(self, callback: Callable[[Box], None]) -> None:
        """Call back with a stage rectangle selected by dragging, um."""
        self._selected = callback
        self._client.scene.on_rect_select(modifier="shift")(self._rectangle)

    def on_clip(self, callback: Moved) -> None:
        """Call back with the clip box while the handle of one of its faces is dragged."""
        self._clipped = callback

    def on_places(self, callback: Callable[[tuple[Region, ...]], None]) -> None:
        """Call back with the regions of the active tool."""
        self._placed = callback

    def on_levelling(self, callback: Callable[[Levelling], None]) -> None:
        """Call back when a levelling region has been moved and released."""
        self._levelled = callback

    def first_levelling(self, by: LevelBy) -> Levelling:
        """Return a levelling with initial regions on the surface. Raises MeasureError before a surface is drawn."""
        height_field = self._height_field
        if height_field is None:
            raise MeasureError("The surface is not drawn yet: level it when it is.")
        return first_levelling(by, height_field, self._looked_at())

    def _listen_to_rectangles(self, wanted: bool) -> None:
        """Set whether a drag selects without the Shift key; otherwise it turns the camera."""
        if wanted == self._selecting:
            return
        self._selecting = wanted
        scene = self._client.scene
        if wanted:
            scene.on_rect_select()(self._rectangle)
        else:
            scene.remove_rect_select_callback("all")
            scene.on_rect_select(modifier="shift")(self._rectangle)

    def _rectangle(self, event: viser.SceneRectSelectEvent) -> None:
        corners = event.screen_min, event.screen_max
        self._clicks.ask(lambda: self._select(*corners))

    def _select(self, low: Place, high: Place) -> None:
        """Report the bounding box of the surface under a screen rectangle, whose corners may be off the surface."""
        height_field = self._height_field
        if height_field is None:
            return
        pose, camera = self._eye.pose, self._client.camera
        places: list[Place] = []
        for u, v in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])):
            ray = pixel_ray(pose, camera.fov, camera.image_width / max(1, camera.image_height), u, v)
            places.append(height_field.hit(pose.position, ray) or self._level_place(pose.position, ray))
        xs, ys = zip(*places, strict=True)
        if max(xs) > min(xs) and max(ys) > min(ys):
            self._selected((min(xs), min(ys), max(xs), max(ys)))

    def close(self) -> None:
        """Stop the threads."""
        self._drags.close()
        self._clicks.close()

    def show(
        self, view: View, on_show: DisplayedSurface | None, cache: SurfaceInfoCache, findings: Sequence[AnyResult] = ()
    ) -> None:
        """Show the view's tool, the saved results, the marker and the selection on the displayed surface."""
        height_field = (
            HeightField(cache.relief(on_show), on_show, view.colour_by != "origin") if on_show is not None else None
        )
        with self._lock:
            self._height_field = height_field
            self._show_tools(view, height_field if view.step in ("measure", "gauge") else None)
            self._results.show(
                findings if view.step in ("measure", "review") and height_field is not None else (), view
            )
            self._show_mark(view, height_field)
            self._show_selection(view, height_field)
            if on_show is None:
                self._clip.remove()
            else:
                self._clip.show(view, on_show)
            self._listen_to_rectangles(view.selecting and view.step == "surface" and height_field is not None)
            self._redraw()

    def resize(self) -> None:
        """Redraw after a camera move, because handles keep their size on the screen."""
        self._drags.ask(self._redraw)

    def aim(self, before: CameraPose) -> None:
        """Set the camera's pivot to the visible point in the centre, once the camera rests at `before`.

        The default point looked at has a height between lowest and highest; zooming towards it would enter higher
        parts.
        """
        height_field, pose = self._height_field, self._eye.pose
        if height_field is None or not pose.is_same(before):
            return
        direction = pose.look_at - pose.position
        share = refine_height_field(self._read, height_field, pose.position, direction).reached(
            pose.position, direction
        )
        if share is not None and pose.is_same(self._eye.pose):  # reading took time, and the camera may be elsewhere
            self._eye.aim(pose.position + direction * share)

    def _show_tools(self, view: View, height_field: HeightField | None) -> None:
        if height_field is None or view.tool != "profile":
            self._lines.remove()
        else:
            self._lines.show(view, height_field, self._looked_at())
        for tool in (self._places, self._level):
            if height_field is None:
                tool.remove()
            else:
                tool.show(view, height_field, self._looked_at())

    def _show_mark(self, view: View, height_field: HeightField | None) -> None:
        place = view.why if view.explains and height_field is not None else None
        if place is None:
            if self._mark is not None:
                self._mark.remove()
                self._mark = None
            return
        self._mark = self._mark or PlaceMark(self._client.scene, colours(view.dark).mark)
        self._mark.place = place

    def _show_selection(self, view: View, height_field: HeightField | None) -> None:
        """Show the outline of the selection in the Surface step."""
        box = view.selection if view.step == "surface" and height_field is not None else None
        if box is None:
            if self._outline is not None:
                self._outline.remove()
                self._outline = None
            return
        self._outline = self._outline or DrapedOutline(self._client.scene)
        self._outline.box_um = box

    def _redraw(self) -> None:
        with self._lock:
            if self._height_field is None:
                return
            view_axes = ViewAxes.of(self._eye.pose, self._eye.um_per_pixel() * 1e-3)
            with self._client.atomic():
                for tool in (
                    self._lines,
                    self._places,
                    self._level,
                    self._results,
                    self._clip,
                    self._mark,
                    self._outline,
                ):
                    if tool is not None:
                        tool.draw(self._height_field, view_axes)

    # ---------------------------------------------------------------- what the operator does

    def _dragged(self, name: str, point: np.ndarray, last: bool) -> None:
        """Defer a drag event from viser's event loop to the drag thread; only the latest pending event is handled."""
        eye = self._eye.pose.position
        self._drags.ask(lambda: self._move(name, eye, point - eye, last))

    def _move(self, name: str, origin: np.ndarray, direction: np.ndarray, last: bool) -> None:
        with self._lock:
            if self._height_field is None:
                return
            place = self._height_field.hit(origin, direction) or self._level_place(origin, direction)
            if name.startswith(f"{CLIP}/"):
                self._clip.drag(name, origin, direction, self._height_field.on_show)
            elif name.startswith("profile/"):
                self._lines.drag(name, place)
            elif name.startswith("cursor/"):
                self._lines.drag_cursor(name, place)
            else:
                (self._level if name.startswith("level/") else self._places).drag(name, place, self._height_field, last)
        self._redraw()

    def _level_place(self, origin: np.ndarray, direction: np.ndarray) -> Place:
        """Return the intersection of a ray with the lowest level, clamped to the surface."""
        if self._height_field is None or abs(direction[2]) < 1e-9:
            return 0.0, 0.0
        x, y, _ = origin - direction * (origin[2] / direction[2])
        return self._height_field.clamped((float(x) * 1e3, float(y) * 1e3))

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        origin, direction = np.asarray(event.ray_origin, float), np.asarray(event.ray_direction, float)
        self._clicks.ask(lambda: self._pick(origin, direction))

    def _pick(self, origin: np.ndarray, direction: np.ndarray) -> None:
        height_field = self._height_field
        place = height_field.hit(origin, direction) if height_field is not None else None
        if height_field is None or place is None:
            return
        place = refine_height_field(self._read, height_field, origin, direction).hit(origin, direction) or place
        with self._lock:
            if self._lines.put_cursor(place, _ON_LINE_PX * self._eye.um_per_pixel()):
                return
            self._places.put(place)
        self._redraw()
        if self._picked is not None:
            self._picked(*place)

    def _looked_at(self) -> Place:
        x, y, _ = self._eye.pose.look_at * 1e3
        return float(x), float(y)

    def _in_sight(self, height_field: HeightField) -> HeightField:
        """Return the surface around the point looked at, within half of the canvas's shorter side."""
        x, y = self._looked_at()
        reach_um = self._eye.um_per_pixel() * min(self._eye.canvas_px) / 2
        return height_field.within((x - reach_um, y - reach_um, x + reach_um, y + reach_um))
