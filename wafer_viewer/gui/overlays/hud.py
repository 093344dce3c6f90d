"""Overlays of the scene: legends, scale bar, read-out, and sheets as wide as the scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from wafer_viewer.draw.number_format import length_text, number, round_length, with_unit
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import bottom_panel_height_px
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.region_tools import in_scene
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import FloatingPanel, HtmlBlock, set_prop
from wafer_viewer.model.measurement.levelling import LevelBy
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.session.measurement.dataset_queries import ReadOut
from wafer_viewer.session.state.snapshot import ScanProgress, Snapshot

EDGE_PX = 14
SHORT_NAME = 24
BAR_PX = 150
"""Largest length of the scale bar."""
READ_OUT_PX = 60
OVER: dict[LevelBy, str] = {
    "stage": "",
    "three points": "over three points",
    "plane": "over its plane",
    "region": "over the region",
    "form": "over its form",
}
"""Height reference by levelling method; empty for the stage's zero."""
NARROW_SCENE_PX = 740
"""Scene width from which the full scale bar and the read-out fit in one row."""
ONE_ROW_PX = 780
"""Scene width from which the legend of the plan fits beside the toolbar; in a narrower one it lies under it."""
SECOND_ROW_PX = EDGE_PX + 52


class Legend:
    """Legend of the plan's lines, top right; in Acquire position of the current frame."""

    def __init__(self, page: Page) -> None:
        self._panel = FloatingPanel(page.gui, -EDGE_PX, EDGE_PX, 340, 44, align="right")
        self._viewport = page.viewport

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the legend."""
        content, y_px = "", EDGE_PX
        if view.step == "plan" and not view.live and snapshot.draft.job is not None:
            content = _plan_legend(snapshot)
            if 0 < self._viewport.width_px < ONE_ROW_PX:
                y_px = SECOND_ROW_PX
        elif view.step == "acquire" and snapshot.scanning and snapshot.scan is not None:
            content = _frame_place(snapshot.scan, snapshot)
        self._panel.show(content and Markup('<div class="wv-glass wv-legend-card">{}</div>').format(content), y_px)


class ScaleBar:
    """Scale bar, bottom left: a round length at the look-at point, and the z exaggeration."""

    def __init__(self, page: Page, scene: Any) -> None:
        self._scene, self._viewport = scene, page.viewport
        self._panel = FloatingPanel(page.gui, EDGE_PX, -EDGE_PX, 500, 44)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the scale bar."""
        um_per_pixel = self._scene.um_per_pixel()
        y_px = -(EDGE_PX + bottom_panel_height_px(view))
        narrow = self._viewport.width_px < NARROW_SCENE_PX
        drawn = _drawn(snapshot, in_scene(view), narrow)
        visible = um_per_pixel and not view.at_bench
        self._panel.show(_scale_bar(um_per_pixel, drawn) if visible else "", y_px=y_px)


class ReadOutBox:
    """Read-out, bottom right: height and confidence at the clicked position, and a link to the focus evidence."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._panel = FloatingPanel(page.gui, -EDGE_PX, -EDGE_PX, 420, READ_OUT_PX, align="right")
        self._text = Markup()
        self._shown_for: object = None

    def at(self, x_um: float, y_um: float) -> None:
        """Read the surface at a position. Blocks: call on a worker thread."""
        view, session = self._page.view, self._page.session
        read = session.read_out(x_um, y_um, view.show)
        if read.z_um is not None and view.levelling.by != "stage":
            zero = session.datum(view.levelling, view.show).at(np.array([x_um]), np.array([y_um]))
            read = replace(read, z_um=read.z_um - float(zero[0]))
        place = Markup("x <b>{}</b>&ensp;y <b>{}</b>&ensp;").format(number(x_um, 1), number(y_um, 1))
        self._text = Markup('{}{}<br><span class="dim">{}</span>&ensp;').format(
            place, _height(read, view), _trust(read)
        )
        self._shown_for = _surface(session.snapshot, view)
        self._page.redraw()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the last read-out as long as the surface is the same."""
        on_surface = view.on_surface and self._shown_for == _surface(snapshot, view)
        y_px = -(EDGE_PX + bottom_panel_height_px(view))
        ask = Markup('<span class="wv-link" title="Key C" {}>Why this height?</span>').format(html.pick("why"))
        shown = self._text + ("" if view.explains else ask) if on_surface else Markup()
        self._panel.show(shown and Markup('<div class="wv-glass wv-read">{}</div>').format(shown), y_px=y_px)


def _surface(snapshot: Snapshot, view: View) -> tuple[object, ...]:
    stamp = snapshot.surface.stamp if snapshot.surface else None
    return (snapshot.dataset.path if snapshot.dataset else None, view.show, view.levelling, stamp)


def _height(read: ReadOut, view: View) -> Markup:
    """Return the height with its reference; empty if there is none, as the line below gives the reason."""
    if read.z_um is None:
        return Markup()
    over = (
        Markup(' <span class="dim">{}</span>').format(OVER[view.levelling.by])
        if view.levelling.by != "stage"
        else Markup()
    )
    if read.u_um is None:
        return Markup("z <b>{}</b>{}&ensp;").format(with_unit(read.z_um, 2, signed=True), over)
    height = f"{number(read.z_um, 2, signed=True)} ± {with_unit(2 * read.u_um, 2)}"
    return Markup("z <b>{}</b>{}&ensp;").format(height, over)


def _trust(read: ReadOut) -> str:
    if read.origin != Origin.MEASURED:
        return escape(ORIGIN_TITLES[read.origin])
    confidence = f"confidence {number(read.confidence, 2)}"
    return confidence if read.u_um is None else f"k = 2, without the z scale; {confidence}"


def _plan_legend(snapshot: Snapshot) -> Markup:
    job = snapshot.draft.job
    parts: list[str] = []
    if job is not None and job.grid is not None and job.grid.rows * job.grid.cols > 1:
        shade = html.swatch("color-mix(in srgb,var(--accent) 45%,transparent)", "var(--accent)")
        parts.append(Markup("<span>{} overlap {} %</span>").format(shade, number(100 * job.grid.overlap_x_fraction, 0)))
    if snapshot.draft.plan is not None:
        parts.append(Markup('<span><i class="wv-way"></i> path of the stage</span>'))
    return Markup("").join(parts)


def _frame_place(scan: ScanProgress, snapshot: Snapshot) -> Markup:
    data = snapshot.dataset
    total = f" of {data.plan.sweep.frames_of(scan.field)}" if data else ""
    return Markup(
        '<span>Field {number}</span><span>z <b>{with_unit}</b></span><span class="dim">frame {k}{total}</span>'
    ).format(number=scan.field.number, with_unit=with_unit(scan.z_um, 1, signed=True), k=scan.k + 1, total=total)


def _drawn(snapshot: Snapshot, view: View, narrow: bool) -> str:
    """Return the text next to the scale bar; shorter in a narrow scene, to leave room for the read-out."""
    if view.step == "plan":
        sample = snapshot.draft.job.sample if snapshot.draft.job else None
        if sample is None or (size_um := sample.size_um) is None:
            return "stage"
        name = f"{sample.name} · " if 0 < len(sample.name) <= SHORT_NAME else ""
        return f"{name}{number(size_um[0] / 1000, 3)} × {with_unit(size_um[1] / 1000, 3, 'mm')}"
    if view.look == "plan" and view.step != "acquire":
        return "seen from above"
    shape = " (true shape)" if view.exaggeration == 1 else ""
    points = view.look == "points"
    words, strength = ("depth shade", view.depth_shade) if points else ("light from the north-west", view.hillshade)
    light = f" · {words}" if view.step == "surface" and strength and not narrow else ""
    return f"z drawn × {view.exaggeration:g}{shape}{light}"


def _scale_bar(um_per_pixel: float, label: str) -> Markup:
    length_um = round_length(BAR_PX * um_per_pixel)
    ruler = Markup('<div style="width:{:.0f}px"><b>{}</b><i></i></div>').format(
        length_um / um_per_pixel, length_text(length_um)
    )
    return Markup('<div class="wv-glass wv-scale">{}<span>{}</span></div>').format(ruler, label)


FIRST_PX = 892, 640
"""Initial size, until the browser reports the size of its scene."""
BORDER_PX = 18
"""Extra height of the panel, without which viser clips its content at the bottom."""


@dataclass(frozen=True, slots=True)
class SheetRoom:
    """Available size of a sheet in CSS pixels."""

    width_px: int
    height_px: int


class OverScene:
    """Sheet over the scene; the page is redrawn when the size of the scene changes."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._panel = page.gui.add_panel(visible=False)
        with self._panel.add_tab("·"):
            self._cell = HtmlBlock(page.gui, padded=False)
        self._place = (0, 0)
        self._size = FIRST_PX
        page.viewport.on_change(lambda: self._follow(page.viewport.width_px, page.viewport.height_px))

    @property
    def room(self) -> SheetRoom:
        """Available size at present."""
        width, height = self._size
        return SheetRoom(max(360, width - 2 * EDGE_PX), max(240, height - 2 * EDGE_PX))

    def show(self, content: str, height_px: int = 0) -> None:
        """Show `content`, or nothing when it is empty."""
        if content and (self.room.width_px, height_px) != self._place:
            self._place = self.room.width_px, height_px
            self._panel.float(x=EDGE_PX, y=EDGE_PX, width=self._place[0], height=height_px + BORDER_PX)
        self._cell.show(
            content and Markup('<div class="wv-ov wv-over"><div class="wv-sheet-over">{}</div></div>').format(content)
        )
        set_prop(self._panel, "visible", bool(content))

    def _follow(self, width_px: int, height_px: int) -> None:
        if (width_px, height_px) != self._size and width_px > 0 and height_px > 0:
            self._size = width_px, height_px
            self._page.redraw()
