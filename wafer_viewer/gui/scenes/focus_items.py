"""Predicted focus in the scene of the plan: the surface, pale where it is uncertain, and the windows of a row."""

from __future__ import annotations

from functools import partial

import numpy as np
import viser

from wafer_viewer.draw.colormaps import rgb
from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.presenters.focus import WINDOW_COLOUR, FollowedPlan
from wafer_viewer.gui.scene.primitives import lines, word
from wafer_viewer.gui.scene.reconciler import Handle, SceneItem
from wafer_viewer.gui.scene.scene_theme import colours
from wafer_viewer.gui.scenes.field_outlines import box_edges, field_box, fields_box

_HEIGHT_SHARE = 0.3
"""Height of the highest drawn focus over the sample, as a share of the longer side of the fields."""
_CELL_PX = 4
_INK, _NO_FOCUS_PLATE = (154, 74, 0), (255, 243, 214)


def focus_items(shown: FollowedPlan, dark: bool) -> list[SceneItem]:
    """Return the predicted surface, the windows of the row, and signs over the places without a focus."""
    key = (shown, dark)
    return [
        SceneItem("focus/surface", key, partial(_surface, shown=shown, dark=dark)),
        SceneItem("focus/windows", key, partial(_windows, shown=shown)),
        *(
            SceneItem(f"focus/blank/{number}", key, partial(_no_focus, shown=shown, number=number))
            for number in sorted(shown.blank)
        ),
    ]


def highest_mm(shown: FollowedPlan) -> float:
    """Return the height of the highest drawn window over the sample."""
    box = fields_box(shown.plan.fields, *shown.frame_um())
    return _HEIGHT_SHARE * max(box[2] - box[0], box[3] - box[1])


def _heights(shown: FollowedPlan) -> tuple[float, float]:
    """Return the z that lies on the sample, um, and the mm of the scene for each um."""
    ends_um = [shown.window_um(field) for field in shown.plan.fields]
    low_um, high_um = min(low for low, _ in ends_um), max(high for _, high in ends_um)
    return low_um, highest_mm(shown) / max(high_um - low_um, 1e-6)


def _surface(scene: viser.SceneApi, name: str, _: bytes, *, shown: FollowedPlan, dark: bool) -> Handle:
    """Draw a plate over each field at the middle of its focus; colours of uncertain ones tend to that of the ground."""
    low_um, mm_per_um = _heights(shown)
    boxes = np.array([field_box(field, *shown.frame_um()) for field in shown.plan.fields])
    z_mm = np.array([(one.middle_um - low_um) * mm_per_um for one in shown.focus])
    ground, opacity = np.array(colours(dark).ground, float), np.array(shown.opacities())[:, None]
    tones = np.array(shown.colours(), float) * opacity + ground * (1 - opacity)
    n = len(boxes)
    picture = np.repeat(np.repeat(np.rint(tones).astype(np.uint8)[None], _CELL_PX, axis=0), _CELL_PX, axis=1)
    u = (np.arange(n) + 0.5) / n
    uv = np.stack([u, np.full(n, 0.5), u, np.full(n, 0.5)], axis=1).astype(np.float32)
    data = painted(mesh.plates(boxes, z_mm, uv), picture)
    return scene.add_glb(name, data, cast_shadow=False, receive_shadow=False)


def _windows(scene: viser.SceneApi, name: str, _: bytes, *, shown: FollowedPlan) -> Handle:
    low_um, mm_per_um = _heights(shown)
    edges = []
    for field, _focus in shown.in_row:
        low, high = ((z_um - low_um) * mm_per_um for z_um in shown.window_um(field))
        edges.append(box_edges(field_box(field, *shown.frame_um()), low, high))
    return lines(scene, name, np.concatenate(edges), rgb(WINDOW_COLOUR), 2.0)


def _no_focus(scene: viser.SceneApi, name: str, _: bytes, *, shown: FollowedPlan, number: int) -> Handle:
    box = field_box(shown.plan.field(number), *shown.frame_um())
    high = 0.5 * (box[3] - box[1])
    at = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2, 1.02 * highest_mm(shown))
    return word(scene, name, "!", at, high, _INK, _NO_FOCUS_PLATE, (0.5, 0.5))
