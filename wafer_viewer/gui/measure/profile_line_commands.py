"""Commands on profile lines: cut along a row or a column, add, remove, select, widen."""

from __future__ import annotations

import math

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.measurement import section_lines
from wafer_viewer.model.measurement.section_lines import MOST_LINES, Along
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic

_SAME_PLACE_UM = 1.0


class LineVerbs:
    """Commands that change the lines of the view without waiting for curves.

    Raise MeasureError if the surface does not contain the place.
    """

    def __init__(self, page: Page) -> None:
        self._page = page

    def cut(self, along: Along) -> None:
        """Set the active line to the row or column through the point that the camera looks at."""
        if self._page.session.snapshot.surface is None:
            return
        surface = self._surface()
        x_um, y_um = self._looked_at(surface)
        self.cut_at(along, section_lines.nearest(surface, along, x_um, y_um))

    def cut_at(self, along: Along, number: int) -> None:
        """Set the active line to the row or column of a number."""
        line = self._page.view.active_line
        cut = section_lines.numbered(self._surface(), along, number, line.width_um if line is not None else 0.0)
        lines, place = _with(self._page.view, cut)
        self._page.change(step="measure", tool="profile", why=None, lines=lines, line=place, selected=None)

    def add(self) -> None:
        """Add a line that crosses the active one at its middle, or parallel to it if one crosses it there already."""
        view = self._page.view
        line = view.active_line if view.tool == "profile" else None
        if line is not None and len(view.lines) < MOST_LINES:
            middle = section_lines.middle(line)
            crossed = sum(math.dist(section_lines.middle(other), middle) < _SAME_PLACE_UM for other in view.lines) > 1
            lines = (
                *view.lines,
                (section_lines.parallel_line if crossed else section_lines.perpendicular_line)(line, self._surface()),
            )
            self._page.change(lines=lines, line=len(lines) - 1, selected=None)

    def remove(self) -> None:
        """Remove the active line, unless it is the last one."""
        view = self._page.view
        if len(view.lines) > 1:
            lines = tuple(line for place, line in enumerate(view.lines) if place != view.line)
            self._page.change(lines=lines, line=min(view.line, len(lines) - 1), selected=None)

    def next(self) -> None:
        """Select the next line; the first follows the last."""
        view = self._page.view
        if view.lines:
            self._page.change(line=(view.line + 1) % len(view.lines), selected=None)

    def widen(self, width_um: float) -> None:
        """Set the width of the strip that is averaged across the active line."""
        line = self._page.view.active_line
        if line is not None:
            self._page.change(lines=_with(self._page.view, replace(line, width_um=width_um))[0], selected=None)

    def _surface(self) -> Mosaic:
        return self._page.session.surface_source(self._page.view.show)

    def _looked_at(self, surface: Mosaic) -> tuple[float, float]:
        """Return the point that the camera looks at; if it is off the surface, the middle of the active line."""
        x_mm, y_mm, _ = self._page.client.camera.look_at
        x_um, y_um = float(x_mm) * 1e3, float(y_mm) * 1e3
        rows, cols = surface.shape
        right, down = (x_um - surface.x0_um) / surface.pixel_um, (surface.y0_um - y_um) / surface.pixel_um
        line = self._page.view.active_line
        return (x_um, y_um) if line is None or (0 <= right < cols and 0 <= down < rows) else section_lines.middle(line)


def _with(view: View, line: Region) -> tuple[tuple[Region, ...], int]:
    """Return the lines of a view with the active one replaced, and its index."""
    place = min(view.line, max(len(view.lines) - 1, 0))
    return (*view.lines[:place], line, *view.lines[place + 1 :]), place
