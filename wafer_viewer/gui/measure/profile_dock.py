"""The live curves below the scene, with zoom and cursors.

viser reports no clicks on its plots, so these elements cover the curves and report through the page's hidden field.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from wafer_viewer.draw.charts.profile_plot import Ends, ProfileFrame, frame_of, profile_plot_html
from wafer_viewer.gui.elements.elements import Elements, Html
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.measure.live_measurement import LiveProfiles
from wafer_viewer.gui.presenters import measurement as words
from wafer_viewer.gui.state.view_state import View, with_cursor
from wafer_viewer.model.measurement.sections import (
    Gap,
    Section,
    cursor_difference,
    next_measured,
)

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


@dataclass(slots=True)
class ProfilePlot:
    """Drawn curves and sliders.

    changed_s: when the curves last changed. slid: cursors that a slider put. slider: range of the sliders, and where
    they were sent to. focused: number of the cursor that keys move. rests: grips that went back to where they were.
    """

    curves: LiveProfiles
    frame: ProfileFrame = field(default_factory=lambda: frame_of([]))
    sections: Sequence[Section] = ()
    changed_s: float = 0.0
    slid: tuple[float, float] | None = None
    slider: tuple[Ends, Sequence[float]] = (0.0, 1.0), (0.0, 1.0)
    focused: int | None = None
    rests: int = 0

    def put_in_frame(self, sections: Sequence[Section], span_um: Ends | None) -> None:
        """Fit the plot's frame; its height axis is held while a handle moves."""
        now_s = time.monotonic()
        moving = now_s - self.changed_s < STILL_S
        if sections != self.sections:
            self.sections, self.changed_s = sections, now_s
        fitted = frame_of(sections, span_um)
        self.frame = fitted.holding(self.frame.z_um) if moving else fitted


def profile_dock(here: Here[ProfilePlot]) -> Elements:
    """Return a header with figures, the plot, and two cursors on the active line's curve."""
    plot, curves, view = here.own, here.own.curves, here.view
    sections, active, read = curves.sections, curves.active, curves.gap if curves.sections else None
    zoomed = view.plot.span_um is not None
    drawn = words.head(sections, curves.problems, len(view.lines), view.line, read, zoomed)
    if sections:
        plot.put_in_frame(sections, view.plot.span_um)
        drawn += profile_plot_html(sections, plot.frame, read.at_um if read is not None else (), view.brush)
    return [
        Html(Markup('<div class="wv-below">{}</div>').format(drawn)),
        # Always the same, and so never put in anew under the pointer that drags on it.
        Html(zoom_area() if sections else ""),
        Html(_sliders(plot, view, active, read) if active is not None and read is not None else ""),
    ]


def _sliders(plot: ProfilePlot, view: View, active: Section, read: Gap) -> Markup:
    """Return the sliders, anew only if something else moved a cursor; a slider in use would lose the drag."""
    if view.plot.cursors != plot.slid or plot.slider[0] != plot.frame.x_um:
        plot.slid, plot.slider = None, (plot.frame.x_um, read.at_um)
    ends_um, at_um = plot.slider
    sliders = cursor_sliders(at_um, ends_um, _step_um(active))
    focused = focus_slider_html(plot.focused) if plot.focused is not None else ""
    return Markup('<div class="wv-slides" data-rests="{}">{}{}</div>').format(plot.rests, sliders, focused)


# -------------------------------------------------------------------------------------------- what the operator does


def _pointed(here: Here[ProfilePlot], key: str) -> None:
    page, plot = here.page, here.page.view.plot
    if key == FULL_RANGE:
        page.change(plot=dataclasses.replace(plot, span_um=None))
        return
    low, high = here.own.frame.x_um
    first, last = (low + share * (high - low) for share in parse_drag(key))
    if abs(last - first) > LEAST_ZOOM_SHARE * (high - low):
        page.change(plot=dataclasses.replace(plot, span_um=(min(first, last), max(first, last))))
    elif (active := here.own.curves.active) is not None:
        share = last / float(active.curve.distance_um[-1])
        nearer = 0 if abs(plot.cursors[0] - share) <= abs(plot.cursors[1] - share) else 1
        _put_cursor(here, nearer, share, slid=False)


def _slide(here: Here[ProfilePlot], key: str) -> None:
    """Move a cursor by its slider.

    Released at an unmeasured point it snaps to the nearest measured one; keys jump over the gap.
    """
    plot, event = here.own, parse_cursor_event(key)
    active, before = plot.curves.active, plot.curves.gap
    if active is None or before is None:
        return
    length_um = float(active.curve.distance_um[-1])
    stands_um = cursor_difference(active.curve, (event.at_um / length_um, 0.0)).at_um[0]
    off_curve = abs(stands_um - event.at_um) > _step_um(active) / 2
    plot.focused = event.number if event.by_key else None
    if event.by_key and event.released and off_curve:
        forward = event.at_um > before.at_um[event.number]
        stands_um = next_measured(active.curve, before.at_um[event.number], forward)
    resting = off_curve and event.released
    plot.rests += resting  # a grip that goes back to where it was is sent all the same
    _put_cursor(here, event.number, (stands_um if resting else event.at_um) / length_um, slid=not resting)


def _put_cursor(here: Here[ProfilePlot], number: int, share: float, *, slid: bool) -> None:
    plot = with_cursor(here.page.view.plot, number, share)
    here.own.slid = plot.cursors if slid else None
    here.page.change(plot=plot)


PROFILE_PICKS: Picks[ProfilePlot] = {
    "line": lambda here, place: here.page.change(line=int(place), selected=None),
    ZOOM: _pointed,
    CURSOR: _slide,
}


def _step_um(section: Section) -> float:
    """Return the distance between adjacent points of a curve, um."""
    return float(section.curve.distance_um[-1]) / max(1, len(section.curve.z_um) - 1)
