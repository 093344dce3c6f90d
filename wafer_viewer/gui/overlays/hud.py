"""Overlays of the scene: legends, scale bar, read-out, and sheets as wide as the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from markupsafe import Markup, escape

from wafer_viewer.draw.charts.colour_bar import LINE_PX, colour_bar_html, origin_legend_html
from wafer_viewer.draw.number_format import length_text, number, round_length, with_unit
from wafer_viewer.draw.surface.display_style import QUANTITIES
from wafer_viewer.gui.elements.step import C, Here, Overlay
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import bottom_panel_height_px
from wafer_viewer.gui.scene.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.scenes.pose_overlay import LEAST_STITCH_PX, STITCH, CachedPoses, Fields, PoseCache, inks
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import ColourBy, View
from wafer_viewer.gui.tools.region_tools import in_scene
from wafer_viewer.gui.widgets import html
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
Scale = Callable[[], float]
"""Returns the length of a pixel at the look-at point, um; 0 before it is known."""
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


def legend(here: Here[None]) -> Overlay | None:
    """Return the legend of the plan's lines, top right; in Acquire the position of the current frame."""
    snapshot, view, content, y_px = here.snapshot, here.view, Markup(), EDGE_PX
    if view.step == "plan" and not view.live and snapshot.draft.job is not None:
        content = _plan_legend(snapshot)
        if 0 < here.page.viewport.width_px < ONE_ROW_PX:
            y_px = SECOND_ROW_PX
    elif view.step == "acquire" and snapshot.scanning and snapshot.scan is not None:
        content = _frame_place(snapshot.scan, snapshot)
    content = content and Markup('<div class="wv-glass wv-legend-card">{}</div>').format(content)
    return Overlay.of(content, -EDGE_PX, y_px, 340, 44, at_right=True)


def scale_bar(here: Here[Scale]) -> Overlay | None:
    """Return the scale bar, bottom left: a round length at the look-at point, and the z exaggeration."""
    view, um_per_pixel = here.view, here.own()
    if not um_per_pixel or view.at_bench or view.sheet_over != "none":
        return None
    narrow = here.page.viewport.width_px < NARROW_SCENE_PX
    content = _scale_bar(um_per_pixel, _drawn(here.snapshot, in_scene(view), narrow))
    return Overlay.of(content, EDGE_PX, -(EDGE_PX + bottom_panel_height_px(view)), 500, 44)


@dataclass(frozen=True, slots=True)
class Clicked:
    """Clicked place of a surface, um."""

    place_um: tuple[float, float] | None = None
    surface: object = None


def click_surface(here: Here[Clicked], x_um: float, y_um: float) -> None:
    """Read the surface at a place."""
    here.hold(Clicked((x_um, y_um), _surface(here.page.session.snapshot, here.page.view)))


def read_out(here: Here[Clicked]) -> Overlay | None:
    """Return the read-out, bottom right: height and confidence at the clicked place, while the surface is the same."""
    own, view = here.own, here.view
    if own.place_um is None or not view.on_surface or own.surface != _surface(here.snapshot, view):
        return None
    read = here.ask("read-out", own, partial(_read, here.page, view, own.place_um), "The surface was not read")
    text = read.value if read.value is not None else escape(read.problem)
    link = html.link("Why this height?", "why", title="Key C")
    shown = text and Markup('<div class="wv-glass wv-read">{}{}</div>').format(text, "" if view.explains else link)
    y_px = -(EDGE_PX + bottom_panel_height_px(view))
    return Overlay.of(shown, -EDGE_PX, y_px, 420, READ_OUT_PX, at_right=True)


def _read(page: Page, view: View, place_um: tuple[float, float]) -> Markup:
    """Return what is known of the surface at a place."""
    x_um, y_um = place_um
    read = page.session.read_out(x_um, y_um, view.show)
    if read.z_um is not None and view.levelling.by != "stage":
        zero = page.session.datum(view.levelling, view.show).at(np.array([x_um]), np.array([y_um]))
        read = replace(read, z_um=read.z_um - float(zero[0]))
    place = Markup("x <b>{}</b>&ensp;y <b>{}</b>&ensp;").format(number(x_um, 1), number(y_um, 1))
    return Markup('{}{}<br><span class="dim">{}</span>&ensp;').format(place, _height(read, view), _trust(read))


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
    parts: list[Markup] = []
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


@dataclass(frozen=True, slots=True)
class SheetRoom:
    """Available size of a sheet in CSS pixels."""

    width_px: int
    height_px: int


Sheet = Callable[[Here[C], SheetRoom], tuple[Markup, int] | None]
"""Content and height in CSS pixels of what lies over the scene; None for nothing."""


def sheet_over(sheet: Sheet[C], here: Here[C]) -> Overlay | None:
    """Return a sheet of a step over the scene, as wide as that."""
    viewport = here.page.viewport
    width, height = viewport.width_px or FIRST_PX[0], viewport.height_px or FIRST_PX[1]
    room = SheetRoom(max(360, width - 2 * EDGE_PX), max(240, height - 2 * EDGE_PX))
    if (shown := sheet(here, room)) is None:
        return None
    content = Markup('<div class="wv-sheet-over">{}</div>').format(shown[0])
    return Overlay.of(content, EDGE_PX, EDGE_PX, room.width_px, shown[1], "wv-over")


# -------------------------------------------------------------------------------------------------------------- legends


WIDTH_PX, HEAD_AND_FOOT_PX = 124, 78
MOST_BAR_PX, LEAST_BAR_PX = 320, 110
BELOW_PX = 96
"""Height reserved below the bar for the read-out."""
ORIGIN_ROW_PX, ORIGINS_EDGES_PX = 23, 18
ELSEWHERE_TEXTS: dict[str, str] = {"overlap": "one field only", "uncertainty": "not known"}
"""Reason why a pixel is grey, of quantities that not every height has."""
SIGNED = ("height", "deviation", "form", "difference")


def colour_legend(here: Here[None]) -> Overlay | None:
    """Return the colour bar over the scene, as high as the scene allows."""
    scale, view, page = _scale_shown(here), here.view, here.page
    if scale is None or scale.quantity == "origin":
        return None
    room = page.viewport.height_px - EDGE_PX - HEAD_AND_FOOT_PX - BELOW_PX
    bar_px = min(MOST_BAR_PX, max(LEAST_BAR_PX, room // 10 * 10))
    content, height_px = _card(_bar(scale, view, page.coloured_by(view), bar_px)), bar_px + HEAD_AND_FOOT_PX + 2
    return Overlay.of(content, -EDGE_PX, EDGE_PX, WIDTH_PX, height_px + _foot_px(scale))


def origin_legend(here: Here[None]) -> Overlay | None:
    """Return the legend of the reasons why pixels are unmeasured."""
    scale = _scale_shown(here)
    rows = sum(share > 0 for share in scale.origins.values()) if scale is not None else 0
    if scale is None or scale.quantity != "origin" or not rows:
        return None
    height_px = ORIGIN_ROW_PX * rows + ORIGINS_EDGES_PX
    return Overlay.of(_card(origin_legend_html(scale.origins)), -EDGE_PX, EDGE_PX, 236, height_px, at_right=True)


def _scale_shown(here: Here[None]) -> ColourScale | None:
    view = here.view
    return here.page.scale if view.on_surface and view.step != "gauge" and view.sheet_over == "none" else None


def _foot_px(scale: ColourScale) -> int:
    """Return the height of the line that explains grey; 0 if it is not shown."""
    return LINE_PX if scale.quantity in ELSEWHERE_TEXTS else 0


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


def _card(content: Markup) -> Markup:
    return Markup('<div class="wv-glass">{}</div>').format(content)


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


@dataclass(frozen=True, slots=True)
class PoseLegend:
    """Legend of the solved places of fields, and what it was made from."""

    poses: PoseCache
    um_per_pixel: Scale
    cached: CachedPoses | None = None
    fields: Fields | None = None
    rows: tuple[tuple[str, str], ...] = ()


def pose_legend(here: Here[PoseLegend]) -> Overlay | None:
    """Return the legend that is visible while the fields are shown; stitches are drawn only at close range."""
    source, data, view = source_of(here.snapshot, 0), here.snapshot.dataset, here.view
    cached = here.own.poses.at(source) if view.shows_fields and source is not None else None
    if cached is None or cached.poses is None or data is None:
        return None
    if cached is not here.own.cached:
        fields = fields_of(cached, data)
        here.own = replace(here.own, cached=cached, fields=fields, rows=_rows(fields) if fields is not None else ())
    if (fields := here.own.fields) is None:
        return None
    near = STITCH * fields.unit_um >= LEAST_STITCH_PX * here.own.um_per_pixel()
    rows = [(kind, words) for kind, words in here.own.rows if near or kind != "stitch"]
    n_lines = max(1, -(-len(rows) // 2))
    lines = Markup("").join(
        Markup("<div>{}<span>{}</span></div>").format(_sign(kind, view.dark), words) for kind, words in rows
    )
    down = f"grid-template-rows:repeat({n_lines},18px)"
    content = Markup('<div class="wv-glass wv-lines" style="{}">{}</div>').format(down, lines) if rows else Markup()
    y_px = -EDGE_PX - ABOVE_SCALE_PX
    return Overlay.of(content, EDGE_PX, y_px, POSE_LEGEND_PX, ROW_PX * n_lines + EDGES_PX)


def fields_of(cached: CachedPoses, data: OpenDataset) -> Fields | None:
    """Return the fields as placed by the pose solution; None if only the stage positions are known."""
    if cached.poses is None:
        return None
    return Fields(cached.poses, data.plan.cols * data.plan.pixel_um, data.plan.rows * data.plan.pixel_um)


def _rows(fields: Fields) -> tuple[tuple[str, str], ...]:
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
    return tuple((kind, words) for kind, words in rows if present.get(kind, 1))


def _sign(kind: str, dark: bool) -> Markup:
    tones = {name: f"rgb{getattr(inks(dark), name)}" for name in ("field", "arrow", "doubt", "blank")}
    return Markup('<svg width="28" height="14" fill="none" aria-hidden="true">{}</svg>').format(
        _SIGNS[kind].format(**tones)
    )
