"""Profile section of the measuring panel: lines, row and column numbers, cursors, and the commands on lines."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.measure.live_measurement import LiveProfiles
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import PlotView, View, with_cursor
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    HtmlBlock,
    ToggleGroup,
    button,
    duo,
    in_a_row,
    set_prop,
    with_decimals,
)
from wafer_viewer.model.measurement import sections as section_lines
from wafer_viewer.model.measurement.sections import MOST_LINES, Along, OtherSurface
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.clipping import BeforeSlab
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.state.snapshot import Snapshot

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


ALONE, CLEANED = "nothing", "measured and filtered heights"
HINT = "A second curve along the active line: its other heights, or those of another surface"
BEFORE: tuple[tuple[BeforeSlab, str], ...] = (("show", "Show"), ("pale", "Pale"), ("hide", "Hide"))
"""Display of the points in front of the slab along the active line, in a point cloud."""
FAILED = "The line was not changed"
ICON = viser.Icon


class ProfileSection:
    """Section shown while the profile tool is active."""

    def __init__(self, page: Page, curves: LiveProfiles) -> None:
        self._page, self._curves, self._verbs = page, curves, LineVerbs(page)
        self._worker = LatestOnlyWorker("other surfaces")
        self._others: dict[str, OtherSurface] = {}
        self._listed: object = None
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()
        page.on_close(self._worker.close)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the section up to date."""
        visible = view.step == "measure" and view.tool == "profile" and not view.explains
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        self._list_others(snapshot)
        line = view.active_line
        set_prop(self._add, "disabled", line is None or len(view.lines) >= MOST_LINES)
        set_prop(self._remove, "disabled", len(view.lines) < 2)
        self._width.show(line.width_um if line is not None else 0.0)
        self._show_numbers(snapshot, view)
        self._show_cursors()
        set_prop(self._cut_folder, "visible", view.look == "points")
        self._before.show(view.before)
        self._compare.show(_compared(view.plot))
        for handle in self._files:
            set_prop(handle, "disabled", not self._curves.sections)

    def _build(self) -> None:
        gui, verbs = self._page.gui, self._verbs
        self._add = self._button("Add line", ICON.PLUS, verbs.add)
        self._remove = self._button("Remove line", ICON.TRASH, verbs.remove)
        in_a_row(gui, [self._add, self._remove], 30)
        along_x = self._button("Horizontal cut", ICON.ARROWS_HORIZONTAL, lambda: verbs.cut("row"))
        along_y = self._button("Vertical cut", ICON.ARROWS_VERTICAL, lambda: verbs.cut("column"))
        in_a_row(gui, [along_x, along_y], 30)
        duo(gui)
        self._row = self._number("Row", lambda number: verbs.cut_at("row", round(number)), step=1)
        self._column = self._number("Column", lambda number: verbs.cut_at("column", round(number)), step=1)
        self._numbers = HtmlBlock(gui)
        self._width = self._number("Width, µm", verbs.widen, step=0.5)
        self._cut_folder = gui.add_folder(None, visible=False)
        with self._cut_folder:
            self._before = ToggleGroup(gui, "Before it", BEFORE, lambda key: self._page.change(before=key))
        cursors = gui.add_vector2("Cursors, µm", (0.0, 0.0), step=0.1)
        self._cursors: BoundInput[tuple[float, float]] = BoundInput(
            cursors, lambda event: self._put_cursors(event.target.value), self._page, FAILED
        )
        compare = gui.add_dropdown("Compare with", (ALONE, CLEANED), hint=HINT)
        self._compare: BoundInput[str] = BoundInput(
            compare, lambda event: self._choose_other(event.target.value), self._page, FAILED
        )
        self._files = [
            self._button("Profiles as CSV", ICON.TABLE_EXPORT, lambda: self._download(".csv")),
            self._button("Profiles as PNG", ICON.PHOTO_DOWN, lambda: self._download(".png")),
        ]
        in_a_row(gui, self._files, 30)

    def _button(self, label: str, icon: Any, act: Callable[[], None]) -> Any:
        return button(self._page.gui, label, icon, guarded(self._page, FAILED)(lambda _: act()))

    def _number(self, label: str, act: Callable[[float], None], step: float) -> BoundInput[float]:
        handle = self._page.gui.add_number(label, 0 if step == 1 else 0.0, min=0, step=step)
        with_decimals(handle, 0 if step == 1 else 2)
        return BoundInput(handle, lambda event: act(float(event.target.value)), self._page, FAILED)

    # ---------------------------------------------------------------- bring up to date

    def _show_numbers(self, snapshot: Snapshot, view: View) -> None:
        """Show the row and the column nearest to the middle of the active line."""
        line = view.active_line
        if line is None or snapshot.surface is None:
            return
        surface = self._page.session.surface_source(view.show)
        place = section_lines.middle(line)
        self._row.show(section_lines.nearest(surface, "row", *place))
        self._column.show(section_lines.nearest(surface, "column", *place))
        rows, cols = surface.shape
        where = f"field {view.show}" if view.show > 0 else "the stitched surface"
        text = f"Rows 0 to {rows - 1}, columns 0 to {cols - 1} of {where}."
        self._numbers.show(Markup('<div class="wv-lab">{}</div>').format(text))

    def _show_cursors(self) -> None:
        """Show the positions of the cursors, the same as on plot and read-out."""
        read = self._curves.gap
        self._cursors.enable(read is not None)
        first, second = read.at_um if read is not None else (0.0, 0.0)
        self._cursors.show((round(first, 2), round(second, 2)))

    def _list_others(self, snapshot: Snapshot) -> None:
        """List the surfaces to compare with; they are read from disk when the list of datasets has changed."""
        shown = snapshot.dataset
        listed = snapshot.datasets, shown and (shown.path, shown.results), snapshot.surface and snapshot.surface.result
        if listed != self._listed:
            self._listed = listed
            self._worker.ask(guarded(self._page, "The other surfaces were not listed")(self._read_others))

    def _read_others(self) -> None:
        self._others = {other.title: other for other in self._page.session.sections.others()}
        set_prop(self._compare.handle, "options", (ALONE, CLEANED, *self._others))
        self._page.redraw()

    # ---------------------------------------------------------------- what the operator does

    def _put_cursors(self, at_um: tuple[float, float]) -> None:
        active = self._curves.active
        if active is not None:
            plot = self._page.view.plot
            for number in (0, 1):
                plot = with_cursor(plot, number, at_um[number] / float(active.curve.distance_um[-1]))
            self._page.change(plot=plot)

    def _choose_other(self, name: str) -> None:
        plot = replace(self._page.view.plot, cleaned=name == CLEANED, of=self._others.get(name))
        self._page.change(plot=plot)

    def _download(self, ending: str) -> None:
        """Send all curves to the browser as a file download."""
        sections, shown = self._curves.sections, self._page.session.snapshot.dataset
        if sections and shown is not None:
            content = self._page.session.sections.file(sections, ending)
            self._page.client.send_file_download(f"{shown.path.stem}-profiles{ending}", content, save_immediately=True)


def _compared(plot: PlotView) -> str:
    return plot.of.title if plot.of is not None else CLEANED if plot.cleaned else ALONE
