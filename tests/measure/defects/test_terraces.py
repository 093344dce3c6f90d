"""A surface with one die: compared with the fitted form, each level with its own height."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.support.virtual_part import virtual_part
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.defects.terraces import levels_of, over_levels
from wafer_viewer.rigs.virtual.scenes import wafer

GEL_UM = (
    wafer.PITCH_X_UM + wafer.TRENCH_UM / 2 + wafer.GEL_U_UM,
    wafer.PITCH_Y_UM + wafer.TRENCH_UM / 2 + wafer.GEL_V_UM,
)


def heights(*levels_um: float, n: int = 20_000) -> np.ndarray:
    dice = np.random.default_rng(1)
    return np.concatenate([dice.normal(level, 0.4, n) for level in levels_um])


def test_levels_are_the_heights_at_which_most_of_a_surface_lies():
    assert levels_of(heights(0.0, 30.0)) == pytest.approx((0.0, 30.0), abs=0.05)
    assert levels_of(heights(-8.0, 0.0, 12.0)) == pytest.approx((-8.0, 0.0, 12.0), abs=0.05)


@pytest.mark.parametrize("rest", [np.zeros(0), np.random.default_rng(2).uniform(0, 16, 1500)], ids=["noise", "a drop"])
def test_one_level_stays_one(rest):
    assert len(levels_of(np.concatenate([heights(0.0), rest]))) == 1


def test_a_slope_has_no_levels():
    assert len(levels_of(np.random.default_rng(3).uniform(0, 50, 50_000))) == 1


def test_a_pit_as_deep_as_the_next_level_is_a_defect_and_no_part_of_it():
    z_um = np.zeros((200, 300), np.float32)
    z_um[:, 150:] = 30.0
    z_um[90:110, 220:240] = 0.0
    over, walls = over_levels(z_um, (0.0, 30.0))
    assert over[100, 230] == -30.0
    assert walls is not None
    assert walls[100, 150]
    assert not walls[100, 100]


@pytest.mark.slow
def test_the_gel_drop_of_a_single_die_is_listed_and_unmeasured_ground_is_not():
    surface = virtual_part("wafer")
    found = inspect(surface)
    assert found.reference == "form"
    first = found.defects[0]
    assert first.kind == "residue"
    assert math.hypot(first.center.x_um - GEL_UM[0], first.center.y_um - GEL_UM[1]) < 5.0
    assert first.height.value_um == pytest.approx(wafer.GEL_HEIGHT_UM, abs=0.8)
    across_um = [n * surface.pixel_um for n in surface.shape]
    assert max(defect.major.value_um for defect in found.defects) <= max(across_um)
    assert "unmeasured" not in {defect.kind for defect in found.defects}
    assert found.unmeasured_mm2 > 0
