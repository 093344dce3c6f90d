"""Bottom panel with the focus curve of a pixel, and its surroundings in the selected frame."""

from __future__ import annotations

from wafer_viewer.draw.charts.focus_curve_plot import focus_plot_html
from wafer_viewer.draw.number_format import with_unit
from wafer_viewer.draw.surface.pixel_patch import Greys, greys, patch, patch_url
from wafer_viewer.gui.page.bottom_panel import BottomPanel
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import focus_evidence as words
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.surface.focus_evidence_panel import FAILED, WhyPanel
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.gui.widgets.style import PROFILE_PX
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.session.state.snapshot import Snapshot

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
        self._picture = ""
        self._panel = BottomPanel(page, "why")
        with self._panel.tab:
            self._head = HtmlBlock(page.gui)
            page.gui.add_html('<div class="wv-why"></div>')
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
            problem = evidence.problem and html.note("attention", FAILED, evidence.problem)
            self._plot.show(problem or html.empty(READING))
            self._frame.show("")
            return
        if curve is not self._curve:
            self._begin(curve)
        pale = " wv-pale" if evidence.reading else ""
        self._plot.show(f'<div class="{pale}">{focus_plot_html(curve, PROFILE_PX - HEAD_PX, _slider(curve))}</div>')
        self._frame.show(self._picture)

    def _begin(self, curve: FocusCurve) -> None:
        """Start with another pixel at the frame of its peak, whose grey range is used for all of its frames."""
        self._curve, self._picture = curve, ""
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


def _head(curve: FocusCurve | None, reading: bool) -> str:
    about = (
        READING if reading and curve is not None else words.focus_measurement_text(curve) if curve is not None else ""
    )
    hint = "Drag through the curve to see its frames" if curve is not None else ""
    return (
        f'<div class="wv-dock"><b>Focus curve</b><span class="dim">{html.safe(about)}</span>'
        f'<span class="wv-end"><span class="wv-hint">{hint}</span></span>{words.close_action("")}</div>'
    )


def _slider(curve: FocusCurve) -> str:
    """Return the frame selector as HTML: a slider over z that covers the plot, so that it can be dragged anywhere."""
    low, high = curve.z_um[0], curve.z_um[-1]
    step = (high - low) / (len(curve.z_um) - 1) * (1 - 1e-9)  # or the last frame would lie beyond the last step
    tell = html.safe(f"this.dataset.k=this.value;{html.pick_script('why-frame', latest_only=True)}")
    hold = "if(event.key.startsWith('Arrow'))event.stopPropagation()"  # or the camera would move too
    return (
        f'<input type="range" class="wv-scrub" aria-label="Frame at z, µm" min="{low!r}" max="{high!r}" '
        f'step="{step!r}" value="{curve.z_um[_sharpest(curve)]!r}" oninput="{tell}" onkeydown="{hold}">'
    )


def _cross_hair(window_px: int) -> str:
    """Return a cross hair around the pixel and the outline of its focus window, as SVG."""
    half, low, high = PATCH_PX / 2, PATCH_PX / 2 + 0.5 - window_px / 2, PATCH_PX / 2 + 0.5 + window_px / 2
    middle, gap, end = half + 0.5, 12, PATCH_PX
    lines = f"M0 {middle}H{low - gap}M{high + gap} {middle}H{end}M{middle} 0V{low - gap}M{middle} {high + gap}V{end}"
    d = f"{lines}M{low} {low}H{high}V{high}H{low}Z"
    strokes = (("rgba(0,0,0,.65)", 3.4), ("#fff", 1.5))
    paths = "".join(f'<path d="{d}" stroke="{colour}" stroke-width="{width}"/>' for colour, width in strokes)
    return f'<svg viewBox="0 0 {PATCH_PX} {PATCH_PX}">{paths}</svg>'


def _picture(curve: FocusCurve, k: int, url: str) -> str:
    """Return the picture of the pixel's surroundings in a frame, with the frame's number and z, as HTML."""
    z = with_unit(curve.z_um[k], 2, signed=True)
    return (
        f'<figure class="wv-patch" style="width:{PICTURE_PX}px">'
        f'<div style="height:{PICTURE_PX}px"><img src="{url}" alt="Frame {k + 1} round the pixel">'
        f"{_cross_hair(curve.window)}</div>"
        f"<figcaption><b>z {z}</b><span>frame {k + 1} of {len(curve.z_um)}</span></figcaption></figure>"
    )
