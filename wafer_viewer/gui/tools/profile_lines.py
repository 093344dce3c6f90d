"""Profile lines in the scene: up to four, each with its colour and letter, and handles at its ends and corners."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import PROFILE_COLOURS, rgb
from wafer_viewer.gui.scene.billboards import Billboard
from wafer_viewer.gui.scene.drag_handles import CasedLine, Dragged, DragHandle
from wafer_viewer.gui.scene.heightfield import HeightField, Place
from wafer_viewer.gui.scene.viewport import ViewAxes
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.surface_landmarks import first_line
from wafer_viewer.gui.widgets.callbacks import EchoFilter
from wafer_viewer.model.measurement.sections import LETTERS
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace

_CURSOR = rgb("15202B")
_CURSOR_PX = 6.0
_SIGN_PX, _OFFSET_PX = 26, 15
CursorMoved = Callable[[int, float], None]
"""Called with a cursor's number and its new position, as a fraction of the active line's length."""
LinesChanged = Callable[[tuple[Region, ...], int], None]
"""Called with all lines and the number of the active one."""


class LineTool:
    """One path draped over the surface, with handles at its points and its letter next to the first."""

    def __init__(self, scene: viser.SceneApi, place: int, line: Region, dragged: Dragged) -> None:
        colour = rgb(PROFILE_COLOURS[place][1:])
        self.line = line
        self._line = CasedLine(scene, f"profile/{place}", colour, 3.4)
        points = range(len(line.points))
        self._knobs = [DragHandle(scene, f"profile/{place}/{point}", colour, 8.5, dragged) for point in points]
        self._sign = Billboard(scene, f"profile/{place}/sign", LETTERS[place], colour, _SIGN_PX)

    def drag(self, point: int, to: Place) -> None:
        """Move one point."""
        moved = Point(x_um=to[0], y_um=to[1])
        self.line = replace(self.line, points=(*self.line.points[:point], moved, *self.line.points[point + 1 :]))

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the line on the displayed surface."""
        mm_per_pixel = view_axes.mm_per_pixel
        points, measured, corners = draped(self.line, height_field, 1.5 * mm_per_pixel)
        self._line.lay(np.stack([points[:-1], points[1:]], axis=1), measured, 1.8 * mm_per_pixel)
        up = np.array([0, 0, 5 * mm_per_pixel], np.float32)
        for knob, corner in zip(self._knobs, corners, strict=True):
            knob.place(points[corner] + up, mm_per_pixel, view_axes.towards)
        outwards = -1 if float((points[-1] - points[0]) @ view_axes.axes[:, 0]) >= 0 else 1
        self._sign.place(np.asarray(points[0] + up, float), height_field, view_axes, outwards * _OFFSET_PX)

    def remove(self) -> None:
        """Remove the line from the scene."""
        for part in (self._line, *self._knobs, self._sign):
            part.remove()


def draped(
    line: Region, height_field: HeightField, lift_mm: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.intp]]:
    """Return a path draped on the surface, the mask of its measured pieces, and the indices of its own points.

    Points are spaced evenly, beside those of the path.
    """
    corners = np.array([(p.x_um, p.y_um) for p in line.points])
    passed = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    share = passed / max(passed[-1], 1e-9)
    evenly = np.unique(np.concatenate([np.linspace(0, 1, _DRAPED_POINTS), share]))
    x_um, y_um = (np.interp(evenly, share, places) for places in corners.T)
    ends_measured = height_field.measured(x_um, y_um)
    measured = ends_measured[:-1] & ends_measured[1:]
    return height_field.drape(x_um, y_um, lift_mm), measured, np.searchsorted(evenly, share)


_DRAPED_POINTS = 480


class Cursors:
    """Cursors of the plot on the active line, dragged along it. A cursor at an end uses that end's handle."""

    def __init__(self, scene: viser.SceneApi, dragged: Dragged) -> None:
        self._scene, self._dragged = scene, dragged
        self._knobs: dict[int, DragHandle] = {}
        self.line, self.shares = 0, (0.0, 1.0)

    def draw(self, line: Region, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the cursors on the displayed surface."""
        points, _, _ = draped(line, height_field, 6.5 * view_axes.mm_per_pixel)
        for number, share in enumerate(self.shares):
            if not 0 < share < 1:
                self._take_away(number)
                continue
            if number not in self._knobs:
                self._knobs[number] = DragHandle(self._scene, f"cursor/{number}", _CURSOR, _CURSOR_PX, self._dragged)
            self._knobs[number].place(
                points[round(share * (len(points) - 1))], view_axes.mm_per_pixel, view_axes.towards
            )

    def remove(self) -> None:
        """Remove the cursors from the scene."""
        for number in list(self._knobs):
            self._take_away(number)

    def _take_away(self, number: int) -> None:
        if (knob := self._knobs.pop(number, None)) is not None:
            knob.remove()


class LineTools:
    """All profile lines. Lines of a view are applied unless they only echo changes made here."""

    def __init__(self, scene: viser.SceneApi, dragged: Dragged, changed: LinesChanged) -> None:
        self._scene, self._dragged, self._tell = scene, dragged, changed
        self._tools: list[LineTool] = []
        self._had_lines = False
        self._echoes = EchoFilter[tuple[Region, ...]]()
        self._cursors = Cursors(scene, dragged)
        self._cursor_moved: CursorMoved = lambda number, share: None

    def show(self, view: View, height_field: HeightField, near: Place) -> None:
        """Show the lines of a view; a view without lines gets an initial one near a position."""
        if view.lines:
            if not self._echoes.is_echo(view.lines):
                self._lay(view.lines)
        elif self._had_lines or not self._tools:
            first, last = first_line(height_field, near)
            self._lay((Region.line(*first, *last),))
            self._report(0)
        self._had_lines = bool(view.lines)
        self._cursors.line, self._cursors.shares = view.line, view.plot.cursors

    def drag(self, name: str, to: Place) -> None:
        """Move the point of the named handle, ``profile/LINE/POINT``."""
        _, place, point = name.split("/")[:3]
        if int(place) < len(self._tools):
            self._tools[int(place)].drag(int(point), to)
            self._report(int(place))

    def on_cursor(self, callback: CursorMoved) -> None:
        """Call back when a cursor was moved in the scene."""
        self._cursor_moved = callback

    def drag_cursor(self, name: str, to: Place) -> None:
        """Move the named cursor, ``cursor/NUMBER``, to the point of the active line nearest to a position."""
        line = self._active
        if line is not None:
            self._cursor_moved(int(name.split("/")[1]), nearest_share(line, to)[0])

    def put_cursor(self, place: Place, within_um: float) -> bool:
        """Move the nearer cursor to a position on the active line; return False if the position is off the line."""
        line = self._active
        if line is None:
            return False
        share, away_um = nearest_share(line, place)
        if away_um > within_um:
            return False
        first, second = (abs(share - stands) for stands in self._cursors.shares)
        self._cursor_moved(0 if first <= second else 1, share)
        return True

    @property
    def _active(self) -> Region | None:
        place = self._cursors.line
        return self._tools[place].line if place < len(self._tools) else None

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw all lines on the displayed surface."""
        for tool in self._tools:
            tool.draw(height_field, view_axes)
        if self._cursors.line < len(self._tools):
            self._cursors.draw(self._tools[self._cursors.line].line, height_field, view_axes)

    def remove(self) -> None:
        """Remove all lines from the scene."""
        self._cursors.remove()
        for tool in self._tools:
            tool.remove()
        self._tools, self._had_lines = [], False
        self._echoes.forget()

    def _lay(self, lines: tuple[Region, ...]) -> None:
        kept = itertools.takewhile(
            lambda pair: len(pair[0].line.points) == len(pair[1].points), zip(self._tools, lines, strict=False)
        )
        n_kept = sum(1 for _ in kept)
        for tool in self._tools[n_kept:]:
            tool.remove()
        del self._tools[n_kept:]
        for tool, line in zip(self._tools, lines, strict=False):
            tool.line = line
        for place in range(len(self._tools), len(lines)):
            self._tools.append(LineTool(self._scene, place, lines[place], self._dragged))

    def _report(self, active: int) -> None:
        self._tell(self._echoes.tell(tuple(tool.line for tool in self._tools)), active)


def nearest_share(line: Region, to: Place) -> tuple[float, float]:
    """Return the nearest point of a path, as a fraction 0 ... 1 of its length, and its distance in um."""
    passed, found = 0.0, list[tuple[float, float]]()
    for a, b in itertools.pairwise(line.points):
        dx, dy = b.x_um - a.x_um, b.y_um - a.y_um
        along = ((to[0] - a.x_um) * dx + (to[1] - a.y_um) * dy) / max(dx * dx + dy * dy, 1e-12)
        share = min(max(along, 0.0), 1.0)
        away = math.hypot(to[0] - a.x_um - share * dx, to[1] - a.y_um - share * dy)
        found.append((away, passed + share * math.hypot(dx, dy)))
        passed += math.hypot(dx, dy)
    away, at_um = min(found)
    return at_um / max(passed, 1e-9), away
