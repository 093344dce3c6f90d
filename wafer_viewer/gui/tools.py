"""The tools on the surface: picking a point, the lines of profiles, the two regions of a step."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

import numpy as np
import viser

from wafer_viewer.gui.book import Book
from wafer_viewer.gui.camera import Eye
from wafer_viewer.gui.contents import OnShow
from wafer_viewer.gui.handles import PlaceMark, RegionTool
from wafer_viewer.gui.latest import Latest
from wafer_viewer.gui.lie_of_land import Land, Place
from wafer_viewer.gui.line_tools import LineTools
from wafer_viewer.gui.scene_colours import colours
from wafer_viewer.gui.view import View
from wafer_viewer.model.region import Region


class Tools:
    """Handles are moved on a thread of their own, so that a drag is followed while tiles are still coming."""

    def __init__(self, client: viser.ClientHandle, eye: Eye) -> None:
        self._client, self._eye = client, eye
        self._land: Land | None = None
        self._lines = LineTools(client.scene, self._dragged, lambda lines, line: self._lined(lines, line))
        self._regions: dict[str, RegionTool] = {}
        self._mark: PlaceMark | None = None
        self._lock = threading.RLock()
        self._drags, self._clicks = Latest("drag"), Latest("pick")
        self._told: deque[Region] = deque(maxlen=64)
        # Whether the view named them when it was last seen: one that names none any more asks for new ones.
        self._had_regions = False
        self._picked: Callable[[float, float], None] | None = None
        self._lined: Callable[[tuple[Region, ...], int], None] = lambda lines, line: None
        self._stepped: Callable[[Region, Region], None] = lambda upper, lower: None

    def on_pick(self, callback: Callable[[float, float], None]) -> None:
        """Call back with where the surface was clicked."""
        if self._picked is None:
            self._client.scene.on_click()(self._clicked)
        self._picked = callback

    def on_lines(self, callback: Callable[[tuple[Region, ...], int], None]) -> None:
        """Call back with the profiles' lines and the number of the one that was moved."""
        self._lined = callback

    def on_regions(self, callback: Callable[[Region, Region], None]) -> None:
        """Call back with upper and lower region."""
        self._stepped = callback

    def close(self) -> None:
        """Let the threads go."""
        self._drags.close()
        self._clicks.close()

    def show(self, view: View, on_show: OnShow | None, book: Book) -> None:
        """Have the tool of the view on the surface on show, and no other."""
        land = Land(book.relief(on_show), on_show, view.colour_by != "origin") if on_show is not None else None
        with self._lock:
            self._land = land
            tool = view.tool if view.step == "measure" and land is not None else "none"
            if tool != "profile":
                self._lines.remove()
            if tool != "step":
                self._take_regions_away()
            if land is not None and tool == "profile":
                self._lines.show(view, land, self._looked_at())
                self._redraw()
            elif land is not None and tool == "step":
                self._show_regions(view, land)
            self._show_mark(view, land)

    def resize(self) -> None:
        """The camera has moved: handles keep their size on the screen."""
        self._drags.ask(self._redraw)

    # ---------------------------------------------------------------- profile and regions

    def _show_regions(self, view: View, land: Land) -> None:
        new = not self._regions
        if new:
            ink = colours(view.dark).region
            self._regions = {
                name: RegionTool(self._client.scene, name, name.capitalize(), ink, self._dragged)
                for name in ("upper", "lower")
            }
        if view.upper is None or view.lower is None:
            if new or self._had_regions:
                self._lay_regions(land)
        elif self._is_theirs(view.upper, new) or self._is_theirs(view.lower, new):
            for name, region in (("upper", view.upper), ("lower", view.lower)):
                x0, y0, x1, y1 = region.bounds_um
                self._regions[name].low, self._regions[name].high = (x0, y0), (x1, y1)
        self._had_regions = view.upper is not None and view.lower is not None
        self._redraw()

    def _show_mark(self, view: View, land: Land | None) -> None:
        place = view.why if view.explains and land is not None else None
        if place is None:
            if self._mark is not None:
                self._mark.remove()
                self._mark = None
            return
        self._mark = self._mark or PlaceMark(self._client.scene, colours(view.dark).mark)
        self._mark.place = place
        self._redraw()

    def _is_theirs(self, region: Region, new: bool) -> bool:
        """Whether a view's region was chosen elsewhere; one that was told from here is only an echo of a drag."""
        return new or region.points not in [told.points for told in self._told]

    def _lay_regions(self, land: Land) -> None:
        upper, lower, side = land.first_plateaus(self._looked_at())
        for name, (x, y) in (("upper", upper), ("lower", lower)):
            self._regions[name].low = land.clamped((x - side / 2, y - side / 2))
            self._regions[name].high = land.clamped((x + side / 2, y + side / 2))
        self._tell_regions()

    def _take_regions_away(self) -> None:
        for region in self._regions.values():
            region.remove()
        self._regions = {}

    def _redraw(self) -> None:
        with self._lock:
            drawn = [t for t in (self._lines, *self._regions.values(), self._mark) if t is not None]
            if self._land is None or not drawn:
                return
            pixel_mm, towards = self._eye.um_per_pixel() * 1e-3, self._eye.pose.direction
            with self._client.atomic():
                for tool in drawn:
                    tool.draw(self._land, pixel_mm, towards)

    # ---------------------------------------------------------------- what the operator does

    def _dragged(self, name: str, point: np.ndarray) -> None:
        """On viser's loop: leave the work to the thread; of events that wait only the newest counts."""
        eye = self._eye.pose.position
        self._drags.ask(lambda: self._move(name, eye, point - eye))

    def _move(self, name: str, origin: np.ndarray, direction: np.ndarray) -> None:
        with self._lock:
            if self._land is None:
                return
            place = self._land.hit(origin, direction) or self._level_place(origin, direction)
            if name.startswith("profile"):
                self._lines.drag(name, place)
            elif (tool := self._regions.get(name.split("/")[0])) is not None:
                tool.drag(name, place, self._land)
                self._tell_regions()
        self._redraw()

    def _level_place(self, origin: np.ndarray, direction: np.ndarray) -> Place:
        """Beside the surface: where the ray meets its lowest level, drawn to the edge."""
        if self._land is None or abs(direction[2]) < 1e-9:
            return 0.0, 0.0
        x, y, _ = origin - direction * (origin[2] / direction[2])
        return self._land.clamped((float(x) * 1e3, float(y) * 1e3))

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        origin, direction = np.asarray(event.ray_origin, float), np.asarray(event.ray_direction, float)
        self._clicks.ask(lambda: self._pick(origin, direction))

    def _pick(self, origin: np.ndarray, direction: np.ndarray) -> None:
        land = self._land
        place = land.hit(origin, direction) if land is not None else None
        if place is not None and self._picked is not None:
            self._picked(*place)

    def _looked_at(self) -> Place:
        x, y, _ = self._eye.pose.look_at * 1e3
        return float(x), float(y)

    def _tell_regions(self) -> None:
        upper, lower = (Region.rectangle(*self._regions[n].low, *self._regions[n].high) for n in ("upper", "lower"))
        self._told.extend((upper, lower))
        self._stepped(upper, lower)
