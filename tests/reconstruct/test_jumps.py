"""Beside a jump of the surface that no silhouette explains, heights are left out and say why."""

from __future__ import annotations

import numpy as np
import pytest

from tests.truth.layouts import Layout, Taken, take
from tests.truth.views import Optics
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.surface import Origin
from wafer_viewer.reconstruct.field import reconstruct
from wafer_viewer.reconstruct.jumps import apart_um
from wafer_viewer.reconstruct.why import focus_curve

Z_UM = np.linspace(120.0, 280.0, 41)
STAIR = Layout("two treads", Optics(0.28, views=80), 3, scene="stair", settings={"treads": 2})


@pytest.fixture(scope="module")
def stair() -> Taken:
    """Two treads 40 um apart, equally bright."""
    return take(STAIR, (96, 160), Z_UM)


def test_heights_apart_are_seen_from_half_a_window_away() -> None:
    z_um = np.zeros((30, 40), np.float32)
    z_um[:, 20:] = 40.0
    z_um[5, :] = np.nan
    away = np.abs(np.arange(40) - 19.5)
    found = apart_um(z_um, 9)
    assert (found[:, away < 4] == 40).all()
    assert (found[:, away > 6] == 0).all()
    assert (apart_um(np.full((6, 7), np.nan, np.float32), 9) < 0).all()


def test_what_stays_beside_a_step_is_of_its_own_side(stair: Taken) -> None:
    guarded, open_ = (reconstruct(stair.stack, Recipe(window=9, edges=edges)) for edges in ("rims", "none"))
    wrong = [int((np.abs(h.z_raw_um - stair.scene.truth_um) > 4).sum()) for h in (guarded, open_)]
    assert wrong[1] > 20
    assert wrong[0] < 0.1 * wrong[1]
    left_out = guarded.origin == Origin.STEP_EDGE
    assert left_out.any()
    assert not left_out[stair.scene.edge_distance_px > 10].any()


def test_the_pixel_says_so(stair: Taken) -> None:
    height = reconstruct(stair.stack, Recipe(window=9))
    row, col = np.argwhere(height.origin == Origin.STEP_EDGE)[40]
    found = focus_curve(stair.stack, float(height.x_um[col]), float(height.y_um[row]), height.provenance.recipe)
    assert found.origin == "at the edge of a step"
    assert found.verdicts[-1].question == "Are the heights around it of one surface?"
    assert not found.verdicts[-1].passed
