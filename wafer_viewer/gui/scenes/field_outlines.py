"""Outlines of fields in the scene: frames to scale, numbers, overlaps and the stage path."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.number_format import with_unit
from wafer_viewer.gui.scene.primitives import (
    Box,
    Group,
    add_image_plane,
    cased,
    dashed,
    lines,
    polyline_segments,
    rectangle,
    word,
)
from wafer_viewer.gui.scene.reconciler import Handle, SceneItem
from wafer_viewer.gui.scene.scene_theme import colours
from wafer_viewer.model.acquisition.plan import Field, ScanPlan

_WHITE = (255, 255, 255)
_DARK_PLATE = (21, 32, 43)
_MOST_NUMBERS = 150
"""Beyond this count field numbers are shown only on the map in the panel."""
_OVERLAP_PX = 1000
_AT_ZERO = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)


def field_box(field: Field, width_um: float, height_um: float) -> Box:
    """Return the frame of a field in mm."""
    x, y, w, h = field.x_um * 1e-3, field.y_um * 1e-3, width_um / 2e3, height_um / 2e3
    return x - w, y - h, x + w, y + h


def fields_box(fields: Sequence[Field], width_um: float, height_um: float) -> Box:
    """Return the bounding box of all frames."""
    boxes = np.array([field_box(f, width_um, height_um) for f in fields])
    low, high = boxes.min(axis=0), boxes.max(axis=0)
    return float(low[0]), float(low[1]), float(high[2]), float(high[3])


def planned_items(
    fields: tuple[Field, ...], width_um: float, height_um: float, plan: ScanPlan | None, dark: bool
) -> list[SceneItem]:
    """Return the items of the planned grid."""
    key, frames = (fields, width_um, height_um, dark), partial(field_box, width_um=width_um, height_um=height_um)
    boxes = [frames(f) for f in fields]
    items = [
        SceneItem("grid/overlap", key, partial(_overlap, boxes=boxes, dark=dark)),
        SceneItem("grid/lines", key, partial(_frames, boxes=boxes, dark=dark)),
        SceneItem("grid/size", key, partial(_size, box=fields_box(fields, width_um, height_um))),
    ]
    if len(fields) <= _MOST_NUMBERS:
        items.append(SceneItem("grid/numbers", key, partial(_numbers, fields=fields, boxes=boxes, dark=dark)))
    points = stage_path(plan) if plan is not None else []
    if len(points) > 1:
        items.append(SceneItem("grid/way", (tuple(points), dark), partial(_path, points=points, unit=_unit(boxes))))
    return items


def _unit(boxes: list[Box]) -> float:
    """Return the reference length of the drawings: the shorter side of a field."""
    return min(boxes[0][2] - boxes[0][0], boxes[0][3] - boxes[0][1])


def _frames(scene: viser.SceneApi, name: str, _: bytes, *, boxes: list[Box], dark: bool) -> Group:
    segments = np.concatenate([rectangle(box, 0.006 * _unit(boxes)) for box in boxes])
    casing = _WHITE if not dark else (13, 18, 23)
    return cased(scene, name, segments, colours(dark).accent, 2.4, 0.004 * _unit(boxes), casing)


def _numbers(
    scene: viser.SceneApi, name: str, _: bytes, *, fields: tuple[Field, ...], boxes: list[Box], dark: bool
) -> Group:
    accent, ink, unit = colours(dark).accent, _WHITE if not dark else (11, 15, 19), _unit(boxes)
    inset = 0.13 * unit
    return Group(
        *(
            word(
                scene, f"{name}/{field.number}", str(field.number),
                (box[0] + inset, box[3] - inset, 0.02 * unit), 0.24 * unit, ink, accent, (0.0, 1.0),
            )
            for field, box in zip(fields, boxes, strict=True)
        )
    )  # fmt: skip


def _overlap(scene: viser.SceneApi, name: str, _: bytes, *, boxes: list[Box], dark: bool) -> Handle:
    """Draw one image over all fields: lightly tinted where covered once, darker where fields overlap."""
    x0, y0 = min(b[0] for b in boxes), min(b[1] for b in boxes)
    x1, y1 = max(b[2] for b in boxes), max(b[3] for b in boxes)
    scale = _OVERLAP_PX / max(x1 - x0, y1 - y0)
    count = np.zeros((max(2, round((y1 - y0) * scale)), max(2, round((x1 - x0) * scale))), np.uint8)
    for box in boxes:
        rows = slice(round((y1 - box[3]) * scale), round((y1 - box[1]) * scale))
        cols = slice(round((box[0] - x0) * scale), round((box[2] - x0) * scale))
        count[rows, cols] = np.minimum(count[rows, cols] + 1, 2)
    alpha = np.array([0, 34, 118], np.uint8)[count]
    picture = np.dstack([np.full((*count.shape, 3), colours(dark).accent, np.uint8), alpha])
    return add_image_plane(scene, name, picture, (x0, y0, x1, y1), 0.003 * _unit(boxes))


def _size(scene: viser.SceneApi, name: str, _: bytes, *, box: Box) -> Group:
    """Draw the grid's width below it and its height to the left."""
    side = max(box[2] - box[0], box[3] - box[1])
    high, gap, z = 0.042 * side, 0.02 * side, 0.004 * side
    width_um, height_um = (box[2] - box[0]) * 1e3, (box[3] - box[1]) * 1e3
    at_foot, at_left = ((box[0] + box[2]) / 2, box[1] - gap, z), (box[0] - gap, (box[1] + box[3]) / 2, z)
    return Group(
        word(scene, f"{name}/w", with_unit(width_um, 0), at_foot, high, _WHITE, _DARK_PLATE, (0.5, 1.0)),
        word(scene, f"{name}/h", with_unit(height_um, 0), at_left, high, _WHITE, _DARK_PLATE, (1.0, 0.5)),
    )


def stage_path(plan: ScanPlan) -> list[tuple[float, float]]:
    """Return the stage path, x and y in um: the fields of each leg's first and last shot, each segment once."""
    places = {f.number: (f.x_um, f.y_um) for f in plan.fields}
    points: list[tuple[float, float]] = []
    gone: set[frozenset[tuple[float, float]]] = set()
    for leg in plan.legs:
        for place in (places[leg.shots[0].field], places[leg.shots[-1].field]):
            stretch = frozenset((points[-1], place)) if points else frozenset((place,))
            if len(stretch) == 1 and points:
                continue
            if stretch in gone:
                return points
            gone.add(stretch)
            points.append(place)
    return points


def _path(scene: viser.SceneApi, name: str, _: bytes, *, points: list[tuple[float, float]], unit: float) -> Group:
    vertices = np.array([(x * 1e-3, y * 1e-3, 0.016 * unit) for x, y in points], np.float32)
    dashes = dashed(polyline_segments(vertices), 0.13 * unit, 0.5)
    start = scene.add_icosphere(
        f"{name}/start",
        0.055 * unit,
        (213, 94, 0),
        position=tuple(vertices[0]),
        cast_shadow=False,
        receive_shadow=False,
    )
    return Group(cased(scene, f"{name}/line", dashes, (200, 80, 0), 2.2, 0.004 * unit, _WHITE), start)


# ---------------------------------------------------------------- while scanning


def flat_items(
    fields: list[Field], taken: set[int], width_um: float, height_um: float, z: float, dark: bool
) -> list[SceneItem]:
    """Return fields without a surface, flat with their numbers; dashed until their frames are taken.

    Very many are two items of lines: fields that are taken, and the others.
    """
    if len(fields) > _MOST_NUMBERS:
        parts = {"taken": [f for f in fields if f.number in taken]}
        parts["rest"] = [f for f in fields if f.number not in taken]
        return [
            SceneItem(
                f"flat/{name}", (tuple(f.number for f in part), width_um, height_um, z, dark),
                partial(_flat_many, fields=part, size_um=(width_um, height_um), taken=name == "taken", z=z, dark=dark),
            )
            for name, part in parts.items() if part
        ]  # fmt: skip
    return [
        SceneItem(
            f"flat/{f.number}", (f, f.number in taken, width_um, height_um, z, dark),
            partial(_flat, field=f, box=field_box(f, width_um, height_um), taken=f.number in taken, z=z, dark=dark),
        )
        for f in fields
    ]  # fmt: skip


def _flat(
    scene: viser.SceneApi, name: str, _: bytes, *, field: Field, box: Box, taken: bool, z: float, dark: bool
) -> Group:
    unit, ink = _unit([box]), colours(dark).accent if taken else colours(dark).ink
    inset = 0.02 * unit
    inner = (box[0] + inset, box[1] + inset, box[2] - inset, box[3] - inset)
    centre = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2, z + 0.012 * unit)
    edge = rectangle(inner, z + 0.01 * unit)
    return Group(
        lines(scene, f"{name}/frame", edge if taken else dashed(edge, 0.08 * unit), ink, 1.8),
        word(scene, f"{name}/number", str(field.number), centre, 0.3 * unit, ink),
    )


def _flat_many(
    scene: viser.SceneApi,
    name: str,
    _: bytes,
    *,
    fields: list[Field],
    size_um: tuple[float, float],
    taken: bool,
    z: float,
    dark: bool,
) -> Handle:
    middles = np.array([(f.x_um, f.y_um) for f in fields]) * 1e-3
    unit = min(size_um) * 1e-3
    one = rectangle(field_box(_AT_ZERO, *size_um), z + 0.01 * unit)
    edges = one[None] + np.pad(middles, ((0, 0), (0, 1)))[:, None, None].astype(np.float32)
    ink = colours(dark).accent if taken else colours(dark).ink
    return lines(scene, name, edges.reshape(-1, 2, 3), ink, 1.8)


def box_edges(box: Box, low: float, high: float) -> NDArray[np.float32]:
    """Return the twelve edges of an upright box, [12, 2, 3]."""
    x0, y0, x1, y1 = box
    posts = np.array([[(x, y, low), (x, y, high)] for x in (x0, x1) for y in (y0, y1)], np.float32)
    return np.concatenate([rectangle(box, low), rectangle(box, high), posts])
