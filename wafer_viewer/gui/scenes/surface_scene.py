"""Scene of the surface or one of its fields as a block, with an optional image at one z."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.number_format import number, ticks
from wafer_viewer.draw.surface import mesh, texture_baking
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.presenters.review import chosen_defect
from wafer_viewer.gui.scene.camera_presets import Clear
from wafer_viewer.gui.scene.display_range import DisplayRangeHysteresis, as_planned
from wafer_viewer.gui.scene.primitives import Box, add_glb, image_plane, lines
from wafer_viewer.gui.scene.quadtree import Span
from wafer_viewer.gui.scene.reconciler import Handle, SceneItem
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface, SceneContents, colours, corners_of
from wafer_viewer.gui.scene.surface_tiles import (
    Shown,
    SurfaceInfoCache,
    TiledSurface,
    bounds_mm,
    display_style_of,
    heights_of,
)
from wafer_viewer.gui.scenes.pose_overlay import PoseCache, pose_items
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.model.surface.comparison import ComparisonFace, comparison_of
from wafer_viewer.session.core.dataset_library import stamp_of
from wafer_viewer.session.rendering.render_request import (
    CoarseHeightField,
    RenderRequest,
    SurfaceKey,
    SurfaceStatistics,
)
from wafer_viewer.session.state.snapshot import OpenDataset, Snapshot


def source_of(snapshot: Snapshot, show: int) -> SurfaceKey | None:
    """Return the surface that a view shows; None if there is none yet."""
    data = snapshot.dataset
    if data is None:
        return None
    if (requested := comparison_of(show)) is not None:
        comparison = next((c for c in snapshot.comparisons if c.number == requested[0]), None)
        return None if comparison is None else SurfaceKey(data.path, comparison.name, -requested[1], comparison.stamp)
    if show:
        stamp = data.stamps.get(show)
        return None if stamp is None else SurfaceKey(data.path, result_of(snapshot), show, stamp)
    info = snapshot.surface
    return None if info is None else SurfaceKey(data.path, info.result, 0, info.stamp)


def marked(snapshot: Snapshot, view: View) -> tuple[AnyResult, ...]:
    """Return the results with outlines on the surface; in a defect review only the selected defect."""
    defect = chosen_defect(snapshot, view.review) if view.step == "review" else None
    return snapshot.findings if defect is None else (defect,)


def only_grew(begun: tuple[Snapshot, View], now: tuple[Snapshot, View]) -> bool:
    """Return whether two views show the same surface and differ only by its stamp."""
    sources = [source_of(snapshot, view.show) for snapshot, view in (begun, now)]
    if begun[1] != now[1] or None in sources or not begun[1].on_surface or begun[0].scanning != now[0].scanning:
        return False
    places = [(s.dataset, s.result, s.show) for s in sources if s is not None]
    return places[0] == places[1]


def result_of(snapshot: Snapshot) -> str:
    """Return the name of the displayed reconstruction."""
    if snapshot.surface is not None:
        return snapshot.surface.result
    data = snapshot.dataset
    return data.results[0] if data is not None and data.results else "default"


def surface_contents(
    cache: SurfaceInfoCache,
    steady: DisplayRangeHysteresis,
    poses: PoseCache,
    snapshot: Snapshot,
    view: View,
    source: SurfaceKey,
) -> SceneContents:
    """Return the block with its surface and the field layer. Raises NotReady while information is pending."""
    basis = _basis(source)
    datum = cache.datum(basis, view.levelling)
    base_facts = cache.facts(basis, datum)
    view = _with_available_quantity(view, base_facts)
    shown = _shown(snapshot, source, steady.facts(basis, view, base_facts), datum)
    facts, scale = shown.facts, steady.scale(basis, view, cache.scale(basis, view, datum))
    z0 = facts.lowest_um - 0.02 * (facts.high_um - facts.low_um)
    on_show = DisplayedSurface(source, facts, scale, z0, view.exaggeration, datum)
    box, solid = bounds_mm(facts), view.look == "surface"
    relief = cache.available_relief(source, datum)
    heights = heights_of(on_show, relief)
    tiled = TiledSurface(shown, display_style_of(view, scale), view, z0, heights if view.look != "plan" else _level)
    ground = block_items(box, view.dark, plinth=solid, under_points=relief if view.look == "points" else None)
    return SceneContents(
        items=(*ground, *_picture_at_z(snapshot, view, on_show), *_fields(poses, snapshot, view, on_show)),
        visible=tiled.items,
        rough=(*tiled.first_items(), *ground),
        corners_mm=corners_of(_with_figures(box), -plinth_mm(box), 0.0 if view.look == "plan" else _top(on_show)),
        place=("surface", source.dataset, _framed_surface(snapshot, view.show), view.look == "plan"),
        preset="top" if view.look == "plan" else "iso",
        stretch=view.exaggeration,
        on_show=on_show,
        clear=Clear(),
    )


def _level(rows: Span, cols: Span) -> tuple[float, float]:
    """Return the heights of a flat drawing."""
    return 0.0, 0.0


def _shown(snapshot: Snapshot, source: SurfaceKey, facts: SurfaceStatistics, datum: Datum | None) -> Shown:
    """Return the surface to draw; during a scan its window covers all planned fields and stays in place."""
    data, info = snapshot.dataset, snapshot.surface
    if source.show or data is None or info is None:
        return Shown(source, facts, facts, datum=datum)
    stamps = partial(stamp_of, info) if info.changed else None
    return Shown(source, as_planned(facts, data.plan) if snapshot.scanning else facts, facts, stamps, datum)


def _with_available_quantity(view: View, facts: SurfaceStatistics) -> View:
    """Return the view with a quantity that this surface has.

    One that is missing is replaced by height, and the height of a difference is coloured as a difference.
    """
    if view.shows_difference and view.colour_by == "height":
        return replace(view, colour_by="difference")
    return replace(view, colour_by="height", range_um=None) if view.colour_by in facts.unavailable else view


def _basis(source: SurfaceKey) -> SurfaceKey:
    """Return the surface that determines colours and lighting: for the second of a comparison the first one."""
    return replace(source, show=-ComparisonFace.FIRST) if source.show == -ComparisonFace.SECOND else source


def _framed_surface(snapshot: Snapshot, show: int) -> int:
    """Return the surface that the camera frames: that of a comparison's first surface, except side by side."""
    requested = comparison_of(show)
    comparison = next((c for c in snapshot.comparisons if requested is not None and c.number == requested[0]), None)
    return (
        show
        if requested is None or comparison is None or requested[1] is ComparisonFace.BESIDE
        else comparison.comparison.first.field
    )


def _fields(poses: PoseCache, snapshot: Snapshot, view: View, on_show: DisplayedSurface) -> list[SceneItem]:
    """Return the layer of solved field positions."""
    data = snapshot.dataset
    cached = poses.at(on_show.source) if view.shows_fields and data is not None else None
    if cached is None or data is None:
        return []
    size_um = (data.plan.cols * data.plan.pixel_um, data.plan.rows * data.plan.pixel_um)
    return pose_items(cached, on_show, size_um, view.dark, flat=view.look == "plan")


def _top(on_show: DisplayedSurface) -> float:
    return on_show.scene_z(on_show.facts.high_um)


def _with_figures(box: Box) -> Box:
    """Return the box extended by the scale labels at its lower and left edge."""
    return box[0] - 1.6 * figure_height_mm(box), box[1] - 1.6 * figure_height_mm(box), box[2], box[3]


# ---------------------------------------------------------------- the picture of one z


def _picture_at_z(snapshot: Snapshot, view: View, on_show: DisplayedSurface) -> tuple[SceneItem, ...]:
    """Return a frame of the field, or the stitched image at one z, drawn at that z."""
    data, source = snapshot.dataset, on_show.source
    if data is None:
        return ()
    if view.show and view.frame_k is not None:
        z_um = frame_z_um(data, view.show, view.frame_k)
        return (_lying_at(RenderRequest(source, "frame", k=view.frame_k), z_um, view, on_show),)
    if not view.show and view.slice_z_um is not None:
        request = RenderRequest(source, "slice", z_um=view.slice_z_um)
        return (_lying_at(request, view.slice_z_um, view, on_show),)
    return ()


def frame_z_um(data: OpenDataset, number: int, k: int) -> float:
    """Return the z of a frame of a field."""
    return data.plan.sweep.z_um(data.plan.field(number), k)


def _lying_at(request: RenderRequest, z_um: float, view: View, on_show: DisplayedSurface) -> SceneItem:
    z_mm = 0.02 * plinth_mm(bounds_mm(on_show.facts)) if view.look == "plan" else on_show.scene_z(z_um)
    return SceneItem("picture", (request, z_mm), partial(_at_height, z_mm=z_mm), request)


def _at_height(scene: viser.SceneApi, name: str, data: bytes, *, z_mm: float) -> Handle:
    handle = add_glb(scene, name, data)
    handle.position = (0.0, 0.0, z_mm)
    return handle


_PLINTH_SHARE = 0.062
"""Height of the plinth, as a fraction of the longer side."""
_HATCH_SHARE = 1.5e-3
"""Offset of the hatch below the lowest height and inside of its edges, as a fraction of the longer side."""
_HATCH_PX_PER_SIDE = 1100


def plinth_mm(box: Box) -> float:
    """Return the depth of the plinth below the lowest height."""
    return _PLINTH_SHARE * max(box[2] - box[0], box[3] - box[1])


def _hatch_mm(box: Box) -> float:
    return _HATCH_SHARE * max(box[2] - box[0], box[3] - box[1])


def block_items(
    box: Box, dark: bool, *, plinth: bool, under_points: CoarseHeightField | None = None
) -> list[SceneItem]:
    """Return the base items of a surface that covers a box and has its lowest height at z = 0.

    under_points: the heights, if they are drawn as points: between those no hatch may be seen.
    """
    depth = plinth_mm(box) if plinth else 2 * _hatch_mm(box)  # level with what lies flat at 0 it would flicker over it
    items = [
        SceneItem("ground/shadow", (box, dark, depth), add_glb, bake=partial(_shadow, box, dark, -depth)),
        SceneItem("ground/hatch", (box, dark, under_points), add_glb, bake=partial(_hatch, box, dark, under_points)),
        SceneItem("ground/scale", (box, dark, depth), partial(_scale_lines, box=box, dark=dark, z=-depth)),
    ]
    return items + (
        [SceneItem("ground/plinth", (box, dark), add_glb, bake=partial(_plinth, box, dark))] if plinth else []
    )


def _plinth(box: Box, dark: bool) -> bytes:
    x0, y0, x1, y1 = box
    sides = [((x0, y0), (x1, y0)), ((x0, y1), (x1, y1)), ((x0, y0), (x0, y1)), ((x1, y0), (x1, y1))]
    edges = {
        k: (np.array([a[0], b[0]], np.float32), np.array([a[1], b[1]], np.float32), np.zeros(2, np.float32))
        for k, (a, b) in enumerate(sides)
    }
    return painted(mesh.walls(edges, -plinth_mm(box)), texture_baking.sides(*texture_baking.PLINTH_TONES[dark]))


def _hatch(box: Box, dark: bool, under_points: CoarseHeightField | None = None) -> bytes:
    """Return the hatch slightly below the lowest height: all of it, or where points leave holes."""
    width, height = box[2] - box[0], box[3] - box[1]
    scale = _HATCH_PX_PER_SIDE / max(width, height)
    picture = texture_baking.hatch(
        max(2, round(height * scale)), max(2, round(width * scale)), dark=dark, pitch_px=16, line_px=4
    )
    if under_points is not None:
        picture = np.dstack([picture, np.where(_holes(under_points, box, picture.shape[:2]), 255, 0).astype(np.uint8)])
    inset = _hatch_mm(box)
    inner = (box[0] + inset, box[1] + inset, box[2] - inset, box[3] - inset)
    return painted(mesh.flat(*inner, -inset), picture)


def _holes(heights: CoarseHeightField, box: Box, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return where nothing was measured, on a grid of a shape over a box."""
    measured = np.frombuffer(heights.measured, np.bool_).reshape(heights.rows, heights.cols)
    x_um = 1e3 * np.linspace(box[0], box[2], shape[1])
    y_um = 1e3 * np.linspace(box[3], box[1], shape[0])
    cols = np.clip(np.rint((x_um - heights.x0_um) / heights.pixel_um), 0, heights.cols - 1).astype(int)
    rows = np.clip(np.rint((heights.y0_um - y_um) / heights.pixel_um), 0, heights.rows - 1).astype(int)
    return ~measured[np.ix_(rows, cols)]


# ---------------------------------------------------------------- shadow and figures


def _pad_mm(box: Box) -> float:
    return 0.17 * max(box[2] - box[0], box[3] - box[1])


def figure_height_mm(box: Box) -> float:
    """Return the height of the scale labels next to a box."""
    return 0.043 * max(box[2] - box[0], box[3] - box[1])


def _shadow(box: Box, dark: bool, z: float) -> bytes:
    palette, pad = colours(dark), _pad_mm(box)
    width, height = box[2] - box[0] + 2 * pad, box[3] - box[1] + 2 * pad
    corners = [(pad, pad), (width - pad, pad), (width - pad, height - pad), (pad, height - pad)]
    picture = texture_baking.shadow(
        corners, width, height, pad / 3,
        darkness=palette.shadow_strength, shade=palette.shadow, ink=palette.ink, figures=_figures(box, pad),
    )  # fmt: skip
    return image_plane(picture, (box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad), z)


def _tick_places(box: Box) -> tuple[list[float], list[float]]:
    """Return tick distances in um from the lower left corner, along x and along y."""
    most = 5
    step_from = max(box[2] - box[0], box[3] - box[1]) * 1e3
    along_x = [v for v in ticks(0, step_from, most) if v <= (box[2] - box[0]) * 1e3]
    along_y = [v for v in ticks(0, step_from, most) if v <= (box[3] - box[1]) * 1e3]
    return along_x, along_y


def _figures(box: Box, pad: float) -> tuple[texture_baking.GroundLabel, ...]:
    high, gap = figure_height_mm(box), 0.027 * max(box[2] - box[0], box[3] - box[1])
    foot = pad + box[3] - box[1]
    along_x, along_y = _tick_places(box)
    unit = {along_x[-1]: "\u202fµm"} if along_x else {}
    below = [
        texture_baking.GroundLabel(number(v, 0) + unit.get(v, ""), pad + v * 1e-3, foot + gap + high / 2, high, "m")
        for v in along_x
    ]
    side_labels = [texture_baking.GroundLabel(number(v, 0), pad - gap, foot - v * 1e-3, high, "r") for v in along_y]
    return (*below, *side_labels)


def _scale_lines(scene: viser.SceneApi, name: str, _: bytes, *, box: Box, dark: bool, z: float) -> Handle:
    """Draw the two labelled edges and their ticks."""
    long = 0.014 * max(box[2] - box[0], box[3] - box[1])
    x0, y0, x1, y1 = box
    along_x, along_y = _tick_places(box)
    pieces = [[(x0, y0, z), (x1, y0, z)], [(x0, y0, z), (x0, y1, z)]]
    pieces += [[(x0 + v * 1e-3, y0, z), (x0 + v * 1e-3, y0 - long, z)] for v in along_x]
    pieces += [[(x0, y0 + v * 1e-3, z), (x0 - long, y0 + v * 1e-3, z)] for v in along_y]
    return lines(scene, name, np.array(pieces, np.float32), colours(dark).ink, 1.3)
