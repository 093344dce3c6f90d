"""Overlays of the scene: legends, scale bar, read-out, and sheets as wide as the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Generic, Literal

import numpy as np
from markupsafe import Markup, escape

from wafer_viewer.draw.charts.colour_bar import LINE_PX, colour_bar_html, origin_legend_html
from wafer_viewer.draw.number_format import length_text, number, round_length, with_unit
from wafer_viewer.draw.surface.display_style import QUANTITIES
from wafer_viewer.gui.elements.step import C, Here, Picks
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import bottom_panel_height_px
from wafer_viewer.gui.scene.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.scenes.pose_overlay import LEAST_STITCH_PX, STITCH, CachedPoses, Fields, PoseCache, inks
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import ColourBy, View
from wafer_viewer.gui.tools.region_tools import in_scene
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import FloatingPanel, HtmlBlock, set_prop
from wafer_viewer.model.measurement.tool_options import LevelBy
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.session.measurement.dataset_queries import ReadOut
from wafer_viewer.session.rendering.render_request import ColourScale
from wafer_viewer.session.state.snapshot import OpenDataset, ScanProgress, Snapshot

# ------------------------------------------------------------------------------------------------------------------ hud


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
        visible = um_per_pixel and not view.at_bench and view.sheet_over == "none"
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


Sheet = Callable[[Here[C], SheetRoom], tuple[Markup, int] | None]
"""Content and height in CSS pixels of what lies over the scene; None for nothing."""


class StepSheet(Generic[C]):
    """Sheet of a step over the scene; the page is redrawn when the size of the scene changes."""

    def __init__(self, page: Page, sheet: Sheet[C], own: C, picks: Picks[C] = MappingProxyType({})) -> None:
        self.here = Here(page, own)
        self._sheet = sheet
        self._panel = page.gui.add_panel(visible=False)
        with self._panel.add_tab("·"):
            self._cell = HtmlBlock(page.gui, padded=False)
        self._place = (0, 0)
        self._size = FIRST_PX
        page.viewport.on_change(lambda: self._follow(page.viewport.width_px, page.viewport.height_px))
        for name, act in picks.items():
            page.on_pick(name, partial(act, self.here))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the sheet as it is now."""
        self.here.snapshot, self.here.view = snapshot, view
        width, height = self._size
        room = SheetRoom(max(360, width - 2 * EDGE_PX), max(240, height - 2 * EDGE_PX))
        shown = self._sheet(self.here, room)
        if shown is not None and (room.width_px, shown[1]) != self._place:
            self._place = room.width_px, shown[1]
            self._panel.float(x=EDGE_PX, y=EDGE_PX, width=self._place[0], height=shown[1] + BORDER_PX)
        frame = Markup('<div class="wv-ov wv-over"><div class="wv-sheet-over">{}</div></div>')
        self._cell.show(frame.format(shown[0]) if shown is not None else "")
        set_prop(self._panel, "visible", shown is not None)

    def _follow(self, width_px: int, height_px: int) -> None:
        if (width_px, height_px) != self._size and width_px > 0 and height_px > 0:
            self._size = width_px, height_px
            self.here.page.redraw()


# -------------------------------------------------------------------------------------------------------------- legends


WIDTH_PX, HEAD_AND_FOOT_PX = 124, 78
MOST_BAR_PX, LEAST_BAR_PX = 320, 110
BELOW_PX = 96
"""Height reserved below the bar for the read-out."""
ORIGIN_ROW_PX, ORIGINS_EDGES_PX = 23, 18
ELSEWHERE_TEXTS: dict[str, str] = {"overlap": "one field only", "uncertainty": "not known"}
"""Reason why a pixel is grey, of quantities that not every height has."""
SIGNED = ("height", "deviation", "form", "difference")


class ColourLegend:
    """Colour bar over the scene, as high as the scene allows."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._panel = FloatingPanel(page.gui, -EDGE_PX, EDGE_PX, WIDTH_PX, MOST_BAR_PX + HEAD_AND_FOOT_PX)
        self._of_origins = FloatingPanel(page.gui, -EDGE_PX, EDGE_PX, 236, _origins_px(1), align="right")

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the legend."""
        shown = view.on_surface and view.step != "gauge" and view.sheet_over == "none"
        scale = self._page.scale if shown else None
        of_origins = scale is not None and scale.quantity == "origin"
        bar_px = self._bar_px()
        bar = _bar(scale, view, self._page.coloured_by(view), bar_px) if scale is not None and not of_origins else ""
        self._panel.show(_card(bar), height_px=bar_px + HEAD_AND_FOOT_PX + 2 + _foot_px(scale))
        origins = scale.origins if scale is not None and of_origins else {}
        rows = sum(share > 0 for share in origins.values())
        self._of_origins.show(_card(origin_legend_html(origins) if rows else ""), height_px=_origins_px(rows))

    def _bar_px(self) -> int:
        room = self._page.viewport.height_px - EDGE_PX - HEAD_AND_FOOT_PX - BELOW_PX
        return min(MOST_BAR_PX, max(LEAST_BAR_PX, room // 10 * 10))


def _foot_px(scale: ColourScale | None) -> int:
    """Return the height of the line that explains grey; 0 if it is not shown."""
    return LINE_PX if scale is not None and scale.quantity in ELSEWHERE_TEXTS else 0


def _origins_px(rows: int) -> int:
    """Return the height of a legend with `rows` origins."""
    return ORIGIN_ROW_PX * rows + ORIGINS_EDGES_PX


def _bar(scale: ColourScale, view: View, quantity: ColourBy, bar_px: int) -> Markup:
    title, unit = QUANTITIES[quantity]
    colours = OWN_COLOURS.get(quantity, view.colours)
    return colour_bar_html(
        title,
        unit,
        scale.low,
        scale.high,
        colours,
        scale.counts,
        height_px=bar_px,
        signed=quantity in SIGNED,
        elsewhere=ELSEWHERE_TEXTS.get(quantity, ""),
    )


def _card(content: Markup | Literal[""]) -> Markup:
    return Markup('<div class="wv-glass">{}</div>').format(content) if content else Markup()


POSE_LEGEND_PX, ROW_PX, EDGES_PX = 580, 21, 15
ABOVE_SCALE_PX = 62
_SIGNS = {
    "field": Markup('<rect x="3" y="2" width="22" height="10" stroke="{field}" stroke-width="1.8"/>'),
    "arrow": Markup('<path d="M3 7H24M19 3.5L24.5 7L19 10.5" stroke="{arrow}" stroke-width="2"/>'),
    "circle": Markup('<circle cx="14" cy="7" r="5" stroke="{arrow}" stroke-width="1.6"/>'),
    "stitch": Markup('<path d="M7 7H21" stroke="{field}" stroke-width="2.8"/>'),
    "doubt": Markup(
        '<rect x="3" y="2.5" width="22" height="9" stroke="{doubt}" stroke-width="2.4" stroke-dasharray="4 3"/>'
    ),
    "blank": Markup(
        '<rect x="3" y="2.5" width="22" height="9" stroke="{blank}" stroke-width="1.8" stroke-dasharray="4 3"/>'
    ),
    "out": Markup(
        '<g stroke="{doubt}" stroke-width="1.8"><path d="M3 2L25 12M3 12L25 2"/>'
        '<path d="M3 2H25V12H3Z" stroke-dasharray="4 3"/></g>'
    ),
}


class PoseLegend:
    """Legend that is visible while the fields are shown."""

    def __init__(self, page: Page, poses: PoseCache, um_per_pixel: Callable[[], float]) -> None:
        self._poses, self._um_per_pixel = poses, um_per_pixel
        self._panel = FloatingPanel(page.gui, EDGE_PX, -EDGE_PX - ABOVE_SCALE_PX, POSE_LEGEND_PX, ROW_PX)
        self._cached: CachedPoses | None = None
        self._fields: Fields | None = None
        self._rows: list[tuple[str, str]] = []

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the legend."""
        fields = self._on_show(snapshot, view)
        rows = self._visible_rows(fields) if fields is not None else []
        lines = Markup("").join(
            Markup("<div>{}<span>{}</span></div>").format(_sign(kind, view.dark), words) for kind, words in rows
        )
        down = f"grid-template-rows:repeat({-(-len(rows) // 2)},18px)"
        content = Markup('<div class="wv-glass wv-lines" style="{}">{}</div>').format(down, lines) if rows else Markup()
        self._panel.show(content, height_px=ROW_PX * max(1, -(-len(rows) // 2)) + EDGES_PX)

    def _visible_rows(self, fields: Fields) -> list[tuple[str, str]]:
        """Return the visible rows: stitches are drawn only at close range."""
        near = STITCH * fields.unit_um >= LEAST_STITCH_PX * self._um_per_pixel()
        return [(kind, words) for kind, words in self._rows if near or kind != "stitch"]

    def _on_show(self, snapshot: Snapshot, view: View) -> Fields | None:
        source, data = source_of(snapshot, 0), snapshot.dataset
        cached = self._poses.at(source) if view.shows_fields and source is not None else None
        if cached is None or cached.poses is None or data is None:
            return None
        if cached is not self._cached:
            self._cached, self._fields = cached, fields_of(cached, data)
            self._rows = _rows(self._fields) if self._fields is not None else []
        return self._fields


def fields_of(cached: CachedPoses, data: OpenDataset) -> Fields | None:
    """Return the fields as placed by the pose solution; None if only the stage positions are known."""
    if cached.poses is None:
        return None
    return Fields(cached.poses, data.plan.cols * data.plan.pixel_um, data.plan.rows * data.plan.pixel_um)


def _rows(fields: Fields) -> list[tuple[str, str]]:
    """Return symbol and text of what is drawn, least conspicuous first."""
    many = f" (every {number(fields.every, 0)}th)" if fields.every > 1 else ""
    rows = [
        ("field", f"field, position found{many}"),
        ("arrow", f"offset from the stage, drawn × {number(fields.times, 0)}"),
        ("circle", f"U of its position (k = 2), drawn × {number(fields.times, 0)}"),
        ("stitch", "overlap accepted"),
        ("blank", "nothing to compare"),
        ("doubt", "overlap rejected"),
        ("out", "field left out"),
    ]
    present = {
        "arrow": len(fields.arrows()),
        "circle": len(fields.circles()),
        "stitch": len(fields.stitches()),
        "blank": len(fields.doubted(blank=True)),
        "doubt": len(fields.doubted(blank=False)),
        "out": len(fields.left_out()),
    }
    return [(kind, words) for kind, words in rows if present.get(kind, 1)]


def _sign(kind: str, dark: bool) -> Markup:
    tones = {name: f"rgb{getattr(inks(dark), name)}" for name in ("field", "arrow", "doubt", "blank")}
    return Markup('<svg width="28" height="14" fill="none" aria-hidden="true">{}</svg>').format(
        _SIGNS[kind].format(**tones)
    )
