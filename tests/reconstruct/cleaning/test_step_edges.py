"""Beside a jump of the surface that no silhouette explains, heights are improbable and say why."""

from __future__ import annotations

import numpy as np
import pytest

from tests.truth.layouts import Layout, Taken, take
from tests.truth.views import Optics
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.focus_evidence import focus_curve

Z_UM = np.linspace(120.0, 280.0, 41)
STAIR = Layout("two treads", Optics(0.28, views=80), 3, scene="stair", settings={"treads": 2})


@pytest.fixture(scope="module")
def stair() -> Taken:
    """Two treads 40 um apart, equally bright."""
    return take(STAIR, (96, 160), Z_UM)


@pytest.mark.slow
def test_heights_next_to_a_step_belong_to_their_side(stair: Taken) -> None:
    gates = Recipe(window=9, edges="none", least_probability=0.0)
    weighed, gated = (reconstruct(stair.stack, recipe) for recipe in (Recipe(window=9), gates))
    wrong = [int((np.abs(h.z_raw_um - stair.scene.truth_um) > 4).sum()) for h in (weighed, gated)]
    assert wrong[1] > 20
    assert wrong[0] < 0.1 * wrong[1]
    far = stair.scene.edge_distance_px > 20
    assert weighed.measured[far].mean() > 0.9


def test_the_pixel_gives_the_reason(stair: Taken) -> None:
    height = reconstruct(stair.stack, Recipe(window=9))
    beside = (stair.scene.edge_distance_px < 8) & (height.confidence > 0) & (height.origin >= Origin.CLIPPED)
    row, col = np.argwhere(beside)[40]
    found = focus_curve(stair.stack, float(height.x_um[col]), float(height.y_um[row]), height.provenance.recipe)
    assert found.origin == ORIGIN_TITLES[Origin(int(height.origin[row, col]))]
    assert found.confidence == pytest.approx(float(height.confidence[row, col]), abs=0.05)
    last = found.verdicts[-1]
    assert (last.gate, last.limit, last.passed) == ("evidence", height.provenance.recipe.least_probability, False)
    assert last.score == found.confidence
