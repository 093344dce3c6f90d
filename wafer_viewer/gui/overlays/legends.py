"""Legends over the scene: colours with histogram, and the field overlay."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from markupsafe import Markup

from wafer_viewer.draw.charts.colour_bar import LINE_PX, colour_bar_html, origin_legend_html
from wafer_viewer.draw.number_format import number
from wafer_viewer.draw.surface.display_style import QUANTITIES
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.scenes.pose_overlay import LEAST_STITCH_PX, STITCH, CachedPoses, Fields, PoseCache, inks
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import ColourBy, View
from wafer_viewer.gui.widgets.controls import FloatingPanel
from wafer_viewer.session.rendering.render_request import ColourScale
from wafer_viewer.session.state.snapshot import OpenDataset, Snapshot

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
        scale = self._page.scale if view.on_surface and view.step != "gauge" else None
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
