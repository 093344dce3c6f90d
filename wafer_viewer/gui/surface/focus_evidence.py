"""Panel "Why this height?", and the focus curve of the pixel in the bottom panel."""

from __future__ import annotations

from collections.abc import Hashable
from concurrent.futures import Future
from dataclasses import dataclass, replace

from markupsafe import Markup

from wafer_viewer.draw.charts.profile_plot import focus_plot_html
from wafer_viewer.draw.number_format import with_unit
from wafer_viewer.draw.surface.pictures import Greys, greys, patch, patch_url
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import BottomPanel
from wafer_viewer.gui.presenters import surface as words
from wafer_viewer.gui.scene.heightfield import Place
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded, tell_failure
from wafer_viewer.gui.widgets.controls import HtmlBlock, add_html, set_prop
from wafer_viewer.gui.widgets.style import PROFILE_PX
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.session.state.snapshot import Snapshot

TITLE = "Why this height?"
FAILED = "The frames were not read"


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Focus curve of the selected pixel (of the previous pixel while `reading`), or the problem."""

    curve: FocusCurve | None = None
    problem: str = ""
    reading: bool = False


class WhyPanel:
    """Answer, gate verdicts and competing peaks of one pixel; a click selects another pixel."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.evidence = Evidence()
        self._clicked: tuple[Place, Hashable] | None = None
        self._requested: Hashable = None
        self._surface: Hashable = None
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._title = HtmlBlock(page.gui)
            self._notes = HtmlBlock(page.gui)
            self._body = HtmlBlock(page.gui)
        page.on_pick("why", lambda _: self.toggle())
        page.on_pick("why-close", lambda _: self.close())

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date; request the evidence of another pixel, close it for another surface."""
        set_prop(self._folder, "visible", view.explains)
        if not view.explains:
            self._requested, self.evidence = None, Evidence()
            return
        if self._requested is not None and self._surface != surface_of(snapshot, view):
            self.close()
            return
        self._ask_if_new(snapshot, view)
        curve = self.evidence.curve
        self._title.show(
            html.title(
                TITLE,
                words.pixel_position_text(curve) if curve else words.format_position(view.why),
                words.close_action(),
            )
        )
        self._notes.show(self._page.notes(snapshot))
        self._body.show(self._content())

    def clicked(self, x_um: float, y_um: float) -> None:
        """Remember a click on the surface; explain that place at once if the panel is open."""
        page = self._page
        self._clicked = (x_um, y_um), surface_of(page.session.snapshot, page.view)
        if page.view.explains:
            page.change(why=(x_um, y_um))

    def toggle(self) -> None:
        """Explain the place that was clicked last, or close the panel."""
        page = self._page
        if page.view.explains:
            self.close()
        elif self._clicked is not None and self._clicked[1] == surface_of(page.session.snapshot, page.view):
            page.change(why=self._clicked[0])
        elif page.view.on_surface:
            page.say(TITLE, "Click a place on the surface first.")

    def close(self) -> None:
        """Close the panel."""
        self._page.change(why=None)

    def _content(self) -> Markup:
        curve = self.evidence.curve
        if curve is None:
            return Markup()
        parts = Markup("").join(part(curve) for part in (words.answer, words.verdicts, words.rivals))
        return Markup('<div class="wv-pale">{}</div>').format(parts) if self.evidence.reading else parts

    def _ask_if_new(self, snapshot: Snapshot, view: View) -> None:
        request = (view.why, view.show, _stamp(snapshot, view))
        if request == self._requested or view.why is None:
            return
        self._requested, self._surface = request, surface_of(snapshot, view)
        self.evidence = replace(self.evidence, reading=True, problem="")
        answer = self._page.session.focus_curve(*view.why, max(0, view.show))
        answer.add_done_callback(lambda done: self._answered(request, done))

    def _answered(self, request: Hashable, done: Future[FocusCurve]) -> None:
        if request != self._requested or done.cancelled():
            return
        fault = done.exception()
        if fault is None:
            self.evidence = Evidence(done.result())
        elif isinstance(fault, WaferViewerError):
            self.evidence = Evidence(problem=str(fault))
        else:
            tell_failure(self._page, FAILED, fault)
            self.evidence = Evidence(problem=f"{FAILED}.")
        self._page.redraw()


def surface_of(snapshot: Snapshot, view: View) -> Hashable:
    """Return the key of the displayed surface: dataset path and field."""
    return (snapshot.dataset.path if snapshot.dataset else None, view.show)


def _stamp(snapshot: Snapshot, view: View) -> int | None:
    if view.show:
        return snapshot.dataset.stamps.get(view.show) if snapshot.dataset else None
    return snapshot.surface.stamp if snapshot.surface else None


READING = "Reading the frames …"
PATCH_PX = 96
"""Side of the displayed part of a frame, in frame pixels."""
PICTURE_PX = 176
HEAD_PX = 50


class WhyDock:
    """Header, focus curve with a draggable line that selects a frame, and the picture of that frame."""

    def __init__(self, page: Page, why: WhyPanel) -> None:
        self._page, self._why = page, why
        self._worker = LatestOnlyWorker("frame")
        self._curve: FocusCurve | None = None
        self._greys: Greys = 0.0, 1.0
        self._picture = Markup()
        self._panel = BottomPanel(page, "why")
        with self._panel.tab:
            self._head = HtmlBlock(page.gui)
            add_html(page.gui, Markup('<div class="wv-why"></div>'))
            self._plot = HtmlBlock(page.gui)
            self._frame = HtmlBlock(page.gui)
        page.on_pick("why-frame", lambda z_um: self._look_at(float(z_um)))
        page.on_close(self._worker.close)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring curve and picture up to date."""
        if not self._panel.show(view):
            self._curve = None
            return
        evidence = self._why.evidence
        curve = evidence.curve
        self._head.show(_head(curve, evidence.reading))
        if curve is None:
            problem = html.note("attention", FAILED, evidence.problem) if evidence.problem else html.empty(READING)
            self._plot.show(problem)
            self._frame.show("")
            return
        if curve is not self._curve:
            self._begin(curve)
        pale = " wv-pale" if evidence.reading else ""
        self._plot.show(
            Markup('<div class="{}">{}</div>').format(
                pale, focus_plot_html(curve, PROFILE_PX - HEAD_PX, _slider(curve))
            )
        )
        self._frame.show(self._picture)

    def _begin(self, curve: FocusCurve) -> None:
        """Start with another pixel at the frame of its peak, whose grey range is used for all of its frames."""
        self._curve, self._picture = curve, Markup()
        self._look_at(curve.z_um[_sharpest(curve)])

    def _look_at(self, z_um: float) -> None:
        curve = self._curve
        if curve is not None:
            read = guarded(self._page, "The frame was not read")(self._read)
            self._worker.ask(lambda: read(curve, z_um))

    def _read(self, curve: FocusCurve, z_um: float) -> None:
        k = min(range(len(curve.z_um)), key=lambda k: abs(curve.z_um[k] - z_um))
        if not self._picture:
            sharpest = self._page.session.frame_near(curve.field, curve.z_um[_sharpest(curve)])
            self._greys = greys(patch(sharpest, curve.row, curve.col, PATCH_PX))
        frame = self._page.session.frame_near(curve.field, curve.z_um[k])
        url = patch_url(frame, curve.row, curve.col, PATCH_PX, self._greys)
        if curve is self._curve:
            self._picture = _picture(curve, k, url)
            self._page.redraw()


def _sharpest(curve: FocusCurve) -> int:
    return max(range(len(curve.focus)), key=lambda k: curve.focus[k])


def _head(curve: FocusCurve | None, reading: bool) -> Markup:
    about = (
        READING if reading and curve is not None else words.focus_measurement_text(curve) if curve is not None else ""
    )
    hint = "Drag through the curve to see its frames" if curve is not None else ""
    return Markup(
        '<div class="wv-dock"><b>Focus curve</b><span class="dim">{}</span>'
        '<span class="wv-end"><span class="wv-hint">{}</span></span>{}</div>'
    ).format(about, hint, words.close_action(""))


def _slider(curve: FocusCurve) -> Markup:
    """Return the frame selector as HTML: a slider over z that covers the plot, so that it can be dragged anywhere."""
    low, high = curve.z_um[0], curve.z_um[-1]
    step = (high - low) / (len(curve.z_um) - 1) * (1 - 1e-9)  # or the last frame would lie beyond the last step
    return Markup(
        '<input type="range" class="wv-scrub" aria-label="Frame at z, µm" min="{low!r}" max="{high!r}" '
        'step="{step!r}" value="{value!r}" data-slide="why-frame">'
    ).format(low=low, high=high, step=step, value=curve.z_um[_sharpest(curve)])


def _cross_hair(window_px: int) -> Markup:
    """Return a cross hair around the pixel and the outline of its focus window, as SVG."""
    half, low, high = PATCH_PX / 2, PATCH_PX / 2 + 0.5 - window_px / 2, PATCH_PX / 2 + 0.5 + window_px / 2
    middle, gap, end = half + 0.5, 12, PATCH_PX
    lines = f"M0 {middle}H{low - gap}M{high + gap} {middle}H{end}M{middle} 0V{low - gap}M{middle} {high + gap}V{end}"
    d = f"{lines}M{low} {low}H{high}V{high}H{low}Z"
    strokes = (("rgba(0,0,0,.65)", 3.4), ("#fff", 1.5))
    paths = Markup("").join(
        Markup('<path d="{}" stroke="{}" stroke-width="{}"/>').format(d, colour, width) for colour, width in strokes
    )
    return Markup('<svg viewBox="0 0 {} {}">{}</svg>').format(PATCH_PX, PATCH_PX, paths)


def _picture(curve: FocusCurve, k: int, url: str) -> Markup:
    """Return the picture of the pixel's surroundings in a frame, with the frame's number and z, as HTML."""
    z = with_unit(curve.z_um[k], 2, signed=True)
    return Markup(
        '<figure class="wv-patch" style="width:{picture_px}px">'
        '<div style="height:{picture_px}px"><img src="{url}" alt="Frame {alt} round the pixel">'
        "{cross_hair}</div>"
        "<figcaption><b>z {z}</b><span>frame {alt} of {z_um}</span></figcaption></figure>"
    ).format(picture_px=PICTURE_PX, url=url, alt=k + 1, cross_hair=_cross_hair(curve.window), z=z, z_um=len(curve.z_um))
