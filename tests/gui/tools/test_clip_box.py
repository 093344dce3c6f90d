"""Clip box: how its balls are dragged, and where they stand."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.surface.points import counted, refused_legend
from wafer_viewer.gui.tools.clip_box import ClipBoxFaces, along_axis, ball_mm, corners_mm, pulled
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.session.rendering.render_request import (
    ColourScale,
    RefusedCounts,
    Statistics,
    SurfaceKey,
    SurfaceStatistics,
)

FACTS = SurfaceStatistics(101, 201, 1.0, 0.0, 100.0, 0, 101, 0, 201, -5.0, 20.0, -4.0, 18.0, 1.0, (0.0, 0.0, 0.0))
ON_SHOW = DisplayedSurface(
    SurfaceKey(Path("x"), "default", 0, 1), FACTS, ColourScale("height", *(0.0,) * 6, ()), -5.0, 2.0
)
WHOLE = ClipBoxFaces((0.0, 0.0, 200.0, 100.0), (-5.0, 20.0))
EYE = np.array([0.3, -0.4, 0.5])


def ray_to(place: tuple[float, float, float]) -> np.ndarray:
    return np.array(place) - EYE


def test_the_balls_stand_in_the_middle_of_the_faces():
    assert ON_SHOW.box_um == (0.0, 0.0, 200.0, 100.0)
    corners = corners_mm(WHOLE, ON_SHOW)
    assert ball_mm(corners, "x0") == pytest.approx([0.0, 0.05, 0.025])
    assert ball_mm(corners, "y1") == pytest.approx([0.1, 0.1, 0.025])
    assert ball_mm(corners, "z1") == pytest.approx([0.1, 0.05, 0.05])
    assert ON_SHOW.height_um(ON_SHOW.scene_z(7.5)) == pytest.approx(7.5)


def test_a_ball_goes_to_where_the_pointer_passes_its_axis():
    at = pulled(WHOLE, "x0", EYE, ray_to((0.08, 0.05, 0.025)), ON_SHOW)
    assert at == ClipBoxFaces((80.0, 0.0, 200.0, 100.0), (-5.0, 20.0))
    at = pulled(WHOLE, "z1", EYE, ray_to((0.1, 0.05, 0.03)), ON_SHOW)
    assert at is not None
    assert at.box_um == WHOLE.box_um
    assert at.heights_um == (-5.0, 10.0)


def test_a_face_stays_on_the_surface_and_on_its_side():
    beyond = pulled(WHOLE, "x1", EYE, ray_to((0.9, 0.05, 0.025)), ON_SHOW)
    assert beyond == WHOLE
    across = pulled(WHOLE, "y1", EYE, ray_to((0.1, -0.2, 0.025)), ON_SHOW)
    assert across is not None
    assert across.box_um == (0.0, 0.0, 200.0, 1.0)
    above = pulled(WHOLE, "z1", EYE, ray_to((0.1, 0.05, 0.25)), ON_SHOW)
    assert above is not None
    assert above.heights_um[1] > 20.0


def test_a_ray_along_the_axis_tells_nothing():
    assert along_axis(np.zeros(3), 2, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])) is None
    assert pulled(WHOLE, "z1", np.array([0.1, 0.05, 1.0]), np.array([0.0, 0.0, -1.0]), ON_SHOW) is None


def test_refused_points_are_counted_among_all_and_named_by_reason():
    left_out = {"box": 0, "height": 30_000, "confidence": 0, "slab": 0}
    refused = RefusedCounts(80_000, 50_000, left_out, {Origin.NO_TEXTURE: 20_000, Origin.OUTLIER: 30_000}, 4, 1)
    text = Statistics(
        1000, 1000, 1.0, 900_000, 850_000, 0.9, 0.0, (), 0.0, 1.0, 0.5, 0.1, {**left_out, "height": 50_000}
    )
    words = counted(msgspec.structs.replace(text, refused=refused), 900_000, View())
    assert words.startswith("<b>900 k of 980 k points</b>")
    assert "80 k of them refused · 80 k clipped" in words
    legend = refused_legend(refused)
    assert legend.index(ORIGIN_TITLES[Origin.OUTLIER]) < legend.index(ORIGIN_TITLES[Origin.NO_TEXTURE])
    assert "30\u202f000" in legend
