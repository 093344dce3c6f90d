"""Profiles in the step Measure: lines, their width and cursors, a second curve, and the curves as a file."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.elements.elements import (
    Button,
    Buttons,
    Dropdown,
    Elements,
    Html,
    Number,
    NumberPair,
    Stack,
    Toggle,
)
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.measure.live_measurement import LiveProfiles
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View, with_cursor
from wafer_viewer.model.measurement import sections as section_lines
from wafer_viewer.model.measurement.sections import MOST_LINES, Along, OtherSurface
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.clipping import BeforeSlab
from wafer_viewer.model.surface.height_map import Mosaic

_SAME_PLACE_UM = 1.0


class LineCommands:
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

    def add_corner(self) -> None:
        """Add a corner in the middle of the longest leg of the active line."""
        self._replace(section_lines.with_corner)

    def remove_corner(self) -> None:
        """Remove the corner at which the active line is the least bent."""
        self._replace(section_lines.without_corner)

    def _replace(self, changed: Callable[[Region], Region]) -> None:
        view = self._page.view
        line = view.active_line if view.tool == "profile" else None
        if line is not None:
            lines, place = _with(view, changed(line))
            self._page.change(lines=lines, line=place, selected=None)

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


OTHERS = "other surfaces"
ALONE, CLEANED = "nothing", "measured and filtered heights"
BEFORE: tuple[tuple[BeforeSlab, str], ...] = (("show", "Show"), ("pale", "Pale"), ("hide", "Hide"))
"""Display of the points in front of the slab along the active line, in a point cloud."""
FAILED = "The line was not changed"
ALONG: tuple[Along, Along] = "row", "column"
WIDTH_HINT = "Averaging width across the line, µm; 0 is one pixel"
CURSORS_HINT = "Two places along the line, µm from its start"
COMPARE_HINT = "A second curve along the active line: its other heights, or those of another surface"
BEFORE_HINT = "Points of the cloud before the cut along the active line"
ROW_HINT, COLUMN_HINT = "Number of the row of pixels, 0 the top one", "Number of the column of pixels, 0 the left one"


def profile_inputs(here: Here[Any], curves: LiveProfiles) -> Stack:
    """Return the inputs of the profile tool."""
    page, view, lines = here.page, here.view, LineCommands(here.page)
    line, read, others = view.active_line, curves.gap, _others(here)
    plot = view.plot
    compared = plot.of.title if plot.of is not None else CLEANED if plot.cleaned else ALONE

    def cursors_put(at_um: tuple[float, float]) -> None:
        if (active := curves.active) is not None:
            plot, length_um = page.view.plot, float(active.curve.distance_um[-1])
            for number in (0, 1):
                plot = with_cursor(plot, number, at_um[number] / length_um)
            page.change(plot=plot)

    def compared_with(name: str) -> None:
        page.change(plot=replace(page.view.plot, cleaned=name == CLEANED, of=others.get(name)))

    def file(ending: str, label: str, icon: Any) -> Button:
        return Button(label, lambda: _send_curves(page, curves, ending), icon, disabled=not curves.sections)

    no_room, alone = line is None or len(view.lines) >= MOST_LINES, len(view.lines) < 2
    at_um = (round(read.at_um[0], 2), round(read.at_um[1], 2)) if read is not None else (0.0, 0.0)
    width_um, icon = line.width_um if line is not None else 0.0, viser.Icon
    added = Button("Add line", lines.add, icon.PLUS, disabled=no_room)
    removed = Button("Remove line", lines.remove, icon.TRASH, disabled=alone)
    along_x = Button("Horizontal cut", lambda: lines.cut("row"), icon.ARROWS_HORIZONTAL)
    along_y = Button("Vertical cut", lambda: lines.cut("column"), icon.ARROWS_VERTICAL)
    straight = line is None or line.kind == "line"
    bent = Button("Add corner", lines.add_corner, icon.VECTOR_SPLINE, disabled=line is None)
    unbent = Button("Remove corner", lines.remove_corner, icon.LINE, disabled=straight)
    inputs = [
        Buttons([added, removed], 30),
        Buttons([bent, unbent], 30),
        Buttons([along_x, along_y], 30),
        *_numbers(here, lines),
        Number("Width, µm", width_um, lines.widen, WIDTH_HINT, step=0.5, decimals=2, least=0),
        Toggle("Before it", view.before, lambda key: page.change(before=key), BEFORE_HINT, options=BEFORE)
        if view.look == "points"
        else None,
        NumberPair("Cursors, µm", at_um, cursors_put, CURSORS_HINT, disabled=read is None),
        Dropdown("Compare with", compared, compared_with, COMPARE_HINT, options=(ALONE, CLEANED, *others)),
        Buttons(
            [file(".csv", "Profiles as CSV", icon.TABLE_EXPORT), file(".png", "Profiles as PNG", icon.PHOTO_DOWN)], 30
        ),
    ]
    return Stack(inputs, failed=FAILED)


def _numbers(here: Here[Any], lines: LineCommands) -> Elements:
    """Return the row and the column nearest to the middle of the active line, and the numbers that there are."""
    view, line = here.view, here.view.active_line
    row, column, told = 0, 0, Markup()
    if line is not None and here.snapshot.surface is not None:
        surface = here.page.session.surface_source(view.show)
        row, column = (section_lines.nearest(surface, along, *section_lines.middle(line)) for along in ALONG)
        rows, cols = surface.shape
        where = f"field {view.show}" if view.show > 0 else "the stitched surface"
        text = f"Rows 0 to {rows - 1}, columns 0 to {cols - 1} of {where}."
        told = Markup('<div class="wv-lab">{}</div>').format(text)
    by_number = [
        Number("Row", row, lambda number: lines.cut_at("row", round(number)), ROW_HINT, least=0),
        Number("Column", column, lambda number: lines.cut_at("column", round(number)), COLUMN_HINT, least=0),
    ]
    return [Stack(by_number, side_by_side=True), Html(told)]


def _others(here: Here[Any]) -> dict[str, OtherSurface]:
    """Return the surfaces to compare with; they are read from disk when the list of datasets has changed."""
    snapshot, shown = here.snapshot, here.snapshot.dataset
    stamp = (snapshot.datasets, shown and (shown.path, shown.results), snapshot.surface and snapshot.surface.result)

    def read() -> dict[str, OtherSurface]:
        return {other.title: other for other in here.page.session.sections.others()}

    return here.ask(OTHERS, stamp, read, "Listing other surfaces failed").value or {}


def _send_curves(page: Page, curves: LiveProfiles, ending: str) -> None:
    """Send all curves to the browser as a file download."""
    sections, shown = curves.sections, page.session.snapshot.dataset
    if sections and shown is not None:
        content = page.session.sections.file(sections, ending)
        page.client.send_file_download(f"{shown.path.stem}-profiles{ending}", content, save_immediately=True)
