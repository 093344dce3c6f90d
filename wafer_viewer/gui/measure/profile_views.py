"""Profiles: their section in the panel, and the live curves below the scene, with zoom and cursors.

viser reports no clicks on its plots, so these elements cover the curves and report through the page's hidden field.
"""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.profile_plot import Ends, ProfileFrame, frame_of, profile_plot_html
from wafer_viewer.gui.measure.live_measurement import LiveProfiles
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import BottomPanel
from wafer_viewer.gui.presenters import measurement as words
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
from wafer_viewer.model.measurement.sections import (
    MOST_LINES,
    Along,
    Gap,
    OtherSurface,
    Section,
    cursor_difference,
    next_measured,
)
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.clipping import BeforeSlab
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.state.snapshot import Snapshot

# ------------------------------------------------------------------------------------------------------ profile section


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


# --------------------------------------------------------------------------------------------------------- profile dock


ZOOM, CURSOR = "plot", "cursor"
"""Events: start and end of a drag as shares of the plot's width; a cursor and its distance."""
FULL_RANGE = "whole"


def zoom_area() -> Markup:
    """Return the element over the curves as HTML: a drag zooms, a click moves the nearer cursor."""
    return Markup('<div class="wv-zoom" data-drag="{}"><div></div></div>').format(ZOOM)


def cursor_sliders(at_um: Sequence[float], ends_um: tuple[float, float], step_um: float) -> Markup:
    """Return a slider over the plot for each cursor within its ends, as HTML; only the thumbs take the pointer."""
    return Markup("").join(
        Markup(
            '<input type="range" class="wv-slide" name="{k}" aria-label="Cursor {aria_label}, µm" '
            'min="{min!r}" max="{max!r}" step="{step!r}" value="{x!r}" data-slide="{slide}">'
        ).format(
            k=k,
            aria_label=k + 1,
            min=ends_um[0],
            max=ends_um[1],
            step=step_um * (1 - 1e-9),
            x=x,
            slide=CURSOR,
        )
        for k, x in enumerate(at_um)
        if ends_um[0] <= x <= ends_um[1]
    )


def parse_drag(key: str) -> tuple[float, float]:
    """Return the two shares that `zoom_area` reported, clamped to the plot."""
    first, last = (min(max(float(share), 0.0), 1.0) for share in key.split(":"))
    return first, last


@dataclass(frozen=True, slots=True)
class CursorMove:
    """Slider event: number of the cursor, its distance along the line in um, moved by key, released."""

    number: int
    at_um: float
    by_key: bool
    released: bool


def parse_cursor_event(key: str) -> CursorMove:
    """Parse the event of a cursor slider."""
    number, at_um, by, end = key.split(":")
    return CursorMove(int(number), float(at_um), by == "key", end == "end")


def focus_slider_html(number: int) -> Markup:
    """Return HTML that focuses the slider of a cursor again, after it was recreated during keyboard use."""
    return Markup('<i hidden data-arrived="cursor" data-k="{}"></i>').format(number)


STILL_S = 0.6
"""Shorter intervals between curves mean that a handle is moving; the height axis is held meanwhile."""
LEAST_ZOOM_SHARE = 0.01
"""Share of the plot's width below which a drag is a click."""


class ProfileDock:
    """Header with figures, the plot, and two cursors on the active line's curve."""

    def __init__(self, page: Page, curves: LiveProfiles) -> None:
        self._page, self._curves = page, curves
        self._lock = threading.Lock()
        self._frame = frame_of([])
        self._sections: Sequence[Section] = ()
        self._changed_s = 0.0
        self._slid: tuple[float, float] | None = None
        self._slider = (self._frame.x_um, (0.0, 1.0))
        self._focused: int | None = None
        self._rests = 0
        self._panel = BottomPanel(page, "profile")
        with self._panel.tab:
            self._plot = HtmlBlock(page.gui)
            self._over = HtmlBlock(page.gui)
            self._sliders = HtmlBlock(page.gui)
        page.on_pick("line", lambda place: page.change(line=int(place), selected=None))
        page.on_pick(ZOOM, self._pointed)
        page.on_pick(CURSOR, self._slide)
        curves.on_news(lambda: self._draw(page.view))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the curves up to date."""
        if self._panel.show(view):
            self._draw(view)

    def _draw(self, view: View) -> None:
        """Draw the panel, on the page's thread or on the measuring thread."""
        with self._lock:
            sections, active = self._curves.sections, self._curves.active
            if not sections:
                self._show_below(self._head(view, None))
                self._over.show("")
                self._sliders.show("")
                return
            self._frame = self._framed(sections, view.plot.span_um)
            read = self._curves.gap
            at_um = read.at_um if read is not None else ()
            plot = profile_plot_html(sections, self._frame, at_um, view.brush)
            self._show_below(self._head(view, read) + plot)
            # Always the same, and so never put in anew under the pointer that drags on it.
            self._over.show(zoom_area())
            self._show_sliders(view, active, read)

    def _show_below(self, content: str) -> None:
        self._plot.show(Markup('<div class="wv-below">{}</div>').format(content))

    def _framed(self, sections: Sequence[Section], span_um: Ends | None) -> ProfileFrame:
        """Return the plot's frame; its height axis is held while a handle moves and fitted afterwards."""
        now_s = time.monotonic()
        moving = now_s - self._changed_s < STILL_S
        if sections != self._sections:
            self._sections, self._changed_s = sections, now_s
        fitted = frame_of(sections, span_um)
        return fitted.holding(self._frame.z_um) if moving else fitted

    def _head(self, view: View, read: Gap | None) -> Markup:
        zoomed = view.plot.span_um is not None
        return words.head(self._curves.sections, self._curves.problems, len(view.lines), view.line, read, zoomed)

    def _show_sliders(self, view: View, active: Section | None, read: Gap | None) -> None:
        """Send the sliders again only if something else moved a cursor; a slider in use would lose the drag."""
        if active is None or read is None:
            self._sliders.show("")
            return
        if view.plot.cursors != self._slid or self._slider[0] != self._frame.x_um:
            self._slid, self._slider = None, (self._frame.x_um, read.at_um)
        ends_um, at_um = self._slider
        sliders = cursor_sliders(at_um, ends_um, _step_um(active))
        focused = focus_slider_html(self._focused) if self._focused is not None else ""
        self._sliders.show(
            Markup('<div class="wv-slides" data-rests="{}">{}{}</div>').format(self._rests, sliders, focused)
        )

    # ---------------------------------------------------------------- what the operator does

    def _pointed(self, key: str) -> None:
        plot = self._page.view.plot
        if key == FULL_RANGE:
            self._page.change(plot=dataclasses.replace(plot, span_um=None))
            return
        low, high = self._frame.x_um
        first, last = (low + share * (high - low) for share in parse_drag(key))
        if abs(last - first) > LEAST_ZOOM_SHARE * (high - low):
            self._page.change(plot=dataclasses.replace(plot, span_um=(min(first, last), max(first, last))))
        else:
            self._put_nearer(last)

    def _put_nearer(self, at_um: float) -> None:
        """Move the nearer cursor to a distance along the line."""
        active = self._curves.active
        if active is not None:
            share = at_um / float(active.curve.distance_um[-1])
            first, second = self._page.view.plot.cursors
            self._put_cursor(0 if abs(first - share) <= abs(second - share) else 1, share, slid=False)

    def _slide(self, key: str) -> None:
        """Move a cursor by its slider.

        Released at an unmeasured point it snaps to the nearest measured one; keys jump over the gap.
        """
        event, active, before = parse_cursor_event(key), self._curves.active, self._curves.gap
        if active is None or before is None:
            return
        length_um = float(active.curve.distance_um[-1])
        stands_um = cursor_difference(active.curve, (event.at_um / length_um, 0.0)).at_um[0]
        off_curve = abs(stands_um - event.at_um) > _step_um(active) / 2
        self._focused = event.number if event.by_key else None
        if event.by_key and event.released and off_curve:
            forward = event.at_um > before.at_um[event.number]
            stands_um = next_measured(active.curve, before.at_um[event.number], forward)
        resting = off_curve and event.released
        self._rests += resting  # a grip that goes back to where it was is sent all the same
        self._put_cursor(event.number, (stands_um if resting else event.at_um) / length_um, slid=not resting)

    def _put_cursor(self, number: int, share: float, *, slid: bool) -> None:
        plot = with_cursor(self._page.view.plot, number, share)
        self._slid = plot.cursors if slid else None
        self._page.change(plot=plot)


def _step_um(section: Section) -> float:
    """Return the distance between adjacent points of a curve, um."""
    return float(section.curve.distance_um[-1]) / max(1, len(section.curve.z_um) - 1)
