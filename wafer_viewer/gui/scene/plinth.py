"""Base of the surface: plinth, shadow, scale labels in um, and the hatch visible through holes."""

from __future__ import annotations

from functools import partial

import numpy as np
import viser

from wafer_viewer.draw.number_format import number, ticks
from wafer_viewer.draw.surface import ground_plane, mesh
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.scene.primitives import Box, add_glb, image_plane, lines
from wafer_viewer.gui.scene.reconciler import Handle, SceneItem
from wafer_viewer.gui.scene.scene_theme import colours

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


def block_items(box: Box, dark: bool, *, plinth: bool) -> list[SceneItem]:
    """Return the base items of a surface that covers a box and has its lowest height at z = 0."""
    depth = plinth_mm(box) if plinth else 2 * _hatch_mm(box)  # level with what lies flat at 0 it would flicker over it
    items = [
        SceneItem("ground/shadow", (box, dark, depth), add_glb, bake=partial(_shadow, box, dark, -depth)),
        SceneItem("ground/hatch", (box, dark), add_glb, bake=partial(_hatch, box, dark)),
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
    return painted(mesh.walls(edges, -plinth_mm(box)), ground_plane.sides(*ground_plane.PLINTH_TONES[dark]))


def _hatch(box: Box, dark: bool) -> bytes:
    """Return the hatch slightly below the lowest height, visible through holes in the surface."""
    width, height = box[2] - box[0], box[3] - box[1]
    scale = _HATCH_PX_PER_SIDE / max(width, height)
    picture = ground_plane.hatch(
        max(2, round(height * scale)), max(2, round(width * scale)), dark=dark, pitch_px=16, line_px=4
    )
    inset = _hatch_mm(box)
    inner = (box[0] + inset, box[1] + inset, box[2] - inset, box[3] - inset)
    return painted(mesh.flat(*inner, -inset), picture)


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
    picture = ground_plane.shadow(
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


def _figures(box: Box, pad: float) -> tuple[ground_plane.GroundLabel, ...]:
    high, gap = figure_height_mm(box), 0.027 * max(box[2] - box[0], box[3] - box[1])
    foot = pad + box[3] - box[1]
    along_x, along_y = _tick_places(box)
    unit = {along_x[-1]: "\u202fµm"} if along_x else {}
    below = [
        ground_plane.GroundLabel(number(v, 0) + unit.get(v, ""), pad + v * 1e-3, foot + gap + high / 2, high, "m")
        for v in along_x
    ]
    side_labels = [ground_plane.GroundLabel(number(v, 0), pad - gap, foot - v * 1e-3, high, "r") for v in along_y]
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
