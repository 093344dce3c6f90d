"""The live curves below the scene, with zoom and cursors.

viser reports no clicks on its plots, so these elements cover the curves and report through the page's hidden field.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from wafer_viewer.draw.charts.profile_plot import Ends, ProfileFrame, frame_of, profile_plot_html
from wafer_viewer.gui.measure.live_measurement import LiveProfiles
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import BottomPanel
from wafer_viewer.gui.presenters import measurement as words
from wafer_viewer.gui.state.view_state import View, with_cursor
from wafer_viewer.gui.widgets.controls import (
    HtmlBlock,
)
from wafer_viewer.model.measurement.sections import (
    Gap,
    Section,
    cursor_difference,
    next_measured,
)
from wafer_viewer.session.state.snapshot import Snapshot

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
