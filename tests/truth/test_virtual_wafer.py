"""What is said to be on the virtual wafer is there, by the scene itself."""

from __future__ import annotations

import numpy as np

from tests.truth.virtual_wafer import _chipped_um, ground, known, own_to_the_die
from wafer_viewer.rigs.virtual.scenes import die, wafer

LEFT_UM, LOW_UM = wafer.PITCH_X_UM + wafer.TRENCH_UM / 2, wafer.PITCH_Y_UM + wafer.TRENCH_UM / 2
"""Of the die in column 1, row 1, which carries the gel."""


def cover(x_um, y_um):
    return wafer.wafer(x_um, y_um, 0.2)[4]


def test_where_a_chip_is_specified_the_die_is_missing():
    along = [(LEFT_UM + u, LOW_UM + 0.3) for u in np.arange(20.0, die.WIDTH_UM - 20, 0.5)]
    chipped = [place for place in along if _chipped_um(*place) > 2.0]
    full = [place for place in along if own_to_the_die(*place) == ""]
    assert np.mean([cover(*place) for place in chipped]) < 0.1
    assert np.mean([cover(*place) for place in full]) > 0.5


def test_dies_differ_by_their_numbers_and_where_probes_touched_them():
    u, v = die.CORE_LEFT_UM + 1.5 * die.BLOCK_WIDTH_UM, die.CORE_BOTTOM_UM + 1.5 * die.BLOCK_HEIGHT_UM
    assert own_to_the_die(LEFT_UM + u, LOW_UM + v) == "number"
    assert own_to_the_die(LEFT_UM + 60.0, LOW_UM + die.PAD_ROW_UM + 10.0) == "probe mark"
    assert own_to_the_die(LEFT_UM + u + die.BLOCK_WIDTH_UM, LOW_UM + v) == ""
    assert own_to_the_die(wafer.RADIUS_UM, 0.0) == ""


def test_the_gel_and_the_dust_are_where_the_scene_has_them():
    present = known(LEFT_UM, LOW_UM, LEFT_UM + die.WIDTH_UM, LOW_UM + die.HEIGHT_UM)
    (gel,) = (one for one in present if one.kind == "gel")
    assert (gel.x_um, gel.y_um) == (LEFT_UM + wafer.GEL_U_UM, LOW_UM + wafer.GEL_V_UM)
    for speck in (one for one in present if one.kind == "particle"):
        assert wafer.particle(speck.x_um, speck.y_um, 0.2)[0] > 0.9
        assert speck.on == ground(speck.x_um, speck.y_um)
