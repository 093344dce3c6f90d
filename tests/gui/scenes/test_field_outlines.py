"""Fields without a surface in the scene: one by one, and very many in two items."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wafer_viewer.gui.scenes.plan_scene import fields_box, flat_items
from wafer_viewer.model.acquisition.plan import FieldGrid

SIZE_UM = 600.0, 450.0


class Scene:
    """Takes the lines that are drawn."""

    def __init__(self) -> None:
        self.segments: dict[str, np.ndarray] = {}

    def add_line_segments(self, name: str, points: np.ndarray, colours: Any, **_: Any) -> None:
        self.segments[name] = points


@pytest.mark.parametrize(("rows", "n_items"), [(10, 100), (20, 2)])
def test_very_many_fields_are_two_items(rows, n_items):
    fields = list(FieldGrid(rows=rows, cols=10, field_width_um=SIZE_UM[0], field_height_um=SIZE_UM[1]).fields())
    items = flat_items(fields, {1, 2, 3}, *SIZE_UM, 0.0, False)
    assert len(items) == n_items
    again = flat_items(fields, {1, 2, 3, 4}, *SIZE_UM, 0.0, False)
    assert [(a.name, a.content) for a in items] != [(b.name, b.content) for b in again]


def test_lines_of_very_many_fields_are_their_frames():
    fields = list(FieldGrid(rows=20, cols=10, field_width_um=SIZE_UM[0], field_height_um=SIZE_UM[1]).fields())
    scene: Any = Scene()
    for item in flat_items(fields, {1, 2, 3}, *SIZE_UM, 0.0, False):
        item.make(scene, item.name, b"")
    assert {name: points.shape for name, points in scene.segments.items()} == {
        "flat/taken": (3 * 4, 2, 3),
        "flat/rest": (197 * 4, 2, 3),
    }
    corners = np.concatenate(list(scene.segments.values())).reshape(-1, 3)
    x0, y0, x1, y1 = fields_box(fields, *SIZE_UM)
    np.testing.assert_allclose(corners.min(axis=0)[:2], (x0, y0), rtol=1e-5)
    np.testing.assert_allclose(corners.max(axis=0)[:2], (x1, y1), rtol=1e-5)
