"""Scene of a running scan: finished fields as surfaces, the current frame in its box, pending fields dashed."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import viser

from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.display_style import DisplayStyle, eight_bit
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.scene.camera_presets import Clear
from wafer_viewer.gui.scene.primitives import Box, Group, lines, rectangle, word
from wafer_viewer.gui.scene.reconciler import SceneItem
from wafer_viewer.gui.scene.scene_contents import SceneContents, corners_of
from wafer_viewer.gui.scene.scene_theme import colours
from wafer_viewer.gui.scene.surface_cache import SurfaceInfoCache
from wafer_viewer.gui.scene.surface_tiles import Shown, surface_items
from wafer_viewer.gui.scenes.field_outlines import box_edges, field_box, fields_box, flat_items
from wafer_viewer.gui.scenes.plan_scene import plan_contents, sample_items
from wafer_viewer.gui.scenes.surface_scene import result_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.session.rendering.render_request import SurfaceKey, SurfaceStatistics
from wafer_viewer.session.state.snapshot import FieldState, LatestFrame, OpenDataset, Snapshot

_TEXTURE_PIXELS = 1_600_000
"""Budget of texture pixels for all finished fields."""
_FIELD_PIXELS = 200_000
_FRAME_SIDE_PX = 480
_NOT_TAKEN = (FieldState.TO_COME, FieldState.TO_REPEAT, FieldState.TAKING, FieldState.FAILED)


def acquire_contents(
    cache: SurfaceInfoCache, snapshot: Snapshot, view: View, latest: LatestFrame | None
) -> SceneContents:
    """Return the fields of the open dataset at their current state; the plan if no dataset is open."""
    data = snapshot.dataset
    if data is None:
        return plan_contents(snapshot, view)
    if not data.fields:  # a surface file: it is drawn as soon as it is read, and the sample on the stage is another
        return SceneContents(
            items=(), corners_mm=corners_of((-1.0, -1.0, 1.0, 1.0), 0.0, 0.0), place=("file", data.path)
        )
    size = data.plan.cols * data.plan.pixel_um, data.plan.rows * data.plan.pixel_um
    facts = cache.available_facts({n: _source(data, snapshot, n) for n in sorted(data.stamps)})
    z0 = min((f.lowest_um for f in facts.values()), default=min(f.z_start_um for f in data.fields))
    box = fields_box(data.fields, *size)
    floor = -0.006 * max(box[2] - box[0], box[3] - box[1])
    items = _live(snapshot, view, latest, data, size, z0, floor)
    if snapshot.dataset_overview is not None:
        items += sample_items(snapshot, view.dark, floor, dimmed=True)
    taken = {number for number, state in data.states.items() if state not in _NOT_TAKEN}
    items += flat_items([f for f in data.fields if f.number not in facts], taken, *size, floor, view.dark)
    items += _finished(data, snapshot, view, facts, z0)
    return SceneContents(
        items=tuple(items),
        corners_mm=corners_of(box, floor, 0.12 * (box[3] - box[1])),
        place=("acquire", data.path),
        awaits_more=len(facts) < len(data.stamps),
        stretch=view.exaggeration,
        clear=Clear(left=60, right=60, top=110, bottom=90),
    )


def _source(data: OpenDataset, snapshot: Snapshot, number: int) -> SurfaceKey:
    return SurfaceKey(data.path, result_of(snapshot), number, data.stamps[number])


# ---------------------------------------------------------------- finished fields


def _finished(
    data: OpenDataset, snapshot: Snapshot, view: View, facts: dict[int, SurfaceStatistics], z0_um: float
) -> list[SceneItem]:
    if not facts:
        return []
    low, high = _common_range(list(facts.values()))
    look = DisplayStyle("height", view.colours, low, high, view.hillshade, view.all_in_focus)
    pixels = min(_FIELD_PIXELS, _TEXTURE_PIXELS // len(facts))
    items: list[SceneItem] = []
    for number, fact in facts.items():
        source = _source(data, snapshot, number)
        items += surface_items(Shown(source, fact, fact), look, _solid(view), z0_um, pixels, f"field/{number}")
    return items


def _solid(view: View) -> View:
    """Return the view with fields drawn as surfaces, independent of the look of the stitched surface."""
    return view if view.look == "surface" else View(step="acquire", dark=view.dark)


def _common_range(facts: list[SurfaceStatistics]) -> tuple[float, float]:
    """Return one height range for all fields, rounded so that it seldom changes when a field is added."""
    low, high = min(f.low_um for f in facts), max(f.high_um for f in facts)
    step = max(high - low, 0.5) / 8
    step = 2.0 ** round(math.log2(step))
    return math.floor(low / step) * step, math.ceil(high / step) * step


# ---------------------------------------------------------------- the field being taken


def _live(
    snapshot: Snapshot,
    view: View,
    latest: LatestFrame | None,
    data: OpenDataset,
    size: tuple[float, float],
    z0_um: float,
    floor_mm: float,
) -> list[SceneItem]:
    """Return the box of the current field's z range, and its latest frame at its z."""
    scan = snapshot.scan
    if scan is None or scan.finished or not snapshot.scanning:
        return []
    box, stretch = field_box(scan.field, *size), view.exaggeration * 1e-3
    low = (scan.field.z_start_um - z0_um) * stretch
    high = low + data.plan.sweep.range_um * stretch
    items = [
        SceneItem(
            "live/box", (box, floor_mm, high, view.dark),
            partial(_box, field=scan.field, box=box, low=max(low, floor_mm), high=high, dark=view.dark),
        )
    ]  # fmt: skip
    if latest is not None and latest.field.number == scan.field.number:
        z = (latest.z_um - z0_um) * stretch
        drawn = partial(_frame, image=latest.image, box=box, z=z, dark=view.dark)
        items.insert(0, SceneItem("live/frame", (latest, z, view.dark), drawn))
    return items


def _box(
    scene: viser.SceneApi, name: str, _: bytes, *, field: Field, box: Box, low: float, high: float, dark: bool
) -> Group:
    accent, unit = colours(dark).accent, min(box[2] - box[0], box[3] - box[1])
    corner = (box[0] + 0.06 * unit, box[1] + 0.06 * unit, high + 0.01 * unit)
    ink = (255, 255, 255) if not dark else (11, 15, 19)
    return Group(
        lines(scene, f"{name}/edges", box_edges(box, low, high), accent, 1.6),
        word(scene, f"{name}/number", str(field.number), corner, 0.24 * unit, ink, accent, (0.0, 0.0)),
    )


def _frame(
    scene: viser.SceneApi, name: str, _: bytes,
    *, image: Image, box: Box, z: float, dark: bool,
) -> Group:  # fmt: skip
    step = -(-max(image.shape) // _FRAME_SIDE_PX)
    grey = eight_bit(image[::step, ::step])
    data = painted(mesh.flat(*box, z), np.repeat(grey[..., None], 3, axis=2))
    return Group(
        scene.add_glb(f"{name}/picture", data, cast_shadow=False, receive_shadow=False),
        lines(scene, f"{name}/edge", rectangle(box, z), colours(dark).accent, 4.0),
    )
