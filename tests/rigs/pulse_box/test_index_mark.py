"""The index mark of a scale, on every box: it sets the count where it is awaited, once, and tells what it replaced."""

from __future__ import annotations

import pytest

from tests.rigs.pulse_box.worlds import VirtualWorld, mostly_of_the_core, of_the_board
from wafer_viewer.model.acquisition.plan import PulseTrain
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.pulse_box.client import _identity
from wafer_viewer.rigs.pulse_box.wpc_protocol import Line


@pytest.fixture
def box(world):
    """A box whose scale stands 5 000 counts before its index mark, and which counts otherwise."""
    world.put_mark(5_000)
    box = world.box()
    box.reference("z", 300)
    return box


@pytest.mark.slow
@of_the_board
def test_an_awaited_mark_sets_the_count_at_its_position(world, box):
    box.reference_by_index("z", 70_000)
    world.move(6_000, 40_000)
    assert box.latched("z") == pytest.approx(5_300, abs=1), "the count that it replaced"
    assert box.count("z") == pytest.approx(71_000, abs=1)


@mostly_of_the_core
def test_until_the_mark_comes_nothing_changes_but_arming_is_refused(world, box):
    train = PulseTrain(axis="z", first_count=71_100, counts_per_frame=100, n_frames=3, direction=1)
    box.reference_by_index("z", 70_000)
    world.move(4_000)
    assert (box.count("z"), box.latched("z")) == (4_300, None)
    with pytest.raises(RigError, match="z axis not referenced"):
        box.arm(train)
    world.move(2_000)
    box.arm(train)
    with pytest.raises(RigError, match="refused REF: armed"):
        box.reference_by_index("z", 0)
    world.move(500)
    assert box.disarm().emitted == 3
    assert [p.count for p in box.pulses()] == [71_100, 71_200, 71_300]


@pytest.mark.slow
@mostly_of_the_core
def test_a_mark_that_is_not_awaited_changes_nothing(world, box):
    world.move(6_000)
    world.move(-3_000)
    assert (box.count("z"), box.latched("z")) == (3_300, None)
    box.reference_by_index("z", 0)
    box.reference("z", 3_300)
    world.move(3_000)
    assert (box.count("z"), box.latched("z")) == (6_300, None), "set otherwise meanwhile"


@pytest.mark.slow
@mostly_of_the_core
def test_only_the_first_mark_counts_and_each_axis_has_its_own(world, box):
    world.put_mark(200, axis="x")
    box.reference_by_index("x", 1_000)
    box.reference_by_index("z", 70_000)
    world.move(300, axis="x")
    assert (box.count("x"), box.latched("z")) == (1_100, None)
    world.move(6_000)
    world.move(-2_000)
    world.move(2_000)
    assert box.count("z") == pytest.approx(71_000, abs=1)
    assert box.latched("x") == 200
    box.reference("x", 0)
    assert box.latched("x") is None


@pytest.mark.slow
@mostly_of_the_core
def test_a_mark_met_downward_sets_the_same_count(world, box):
    world.move(6_000)
    box.reference_by_index("z", 70_000)
    world.move(-2_000)
    assert box.count("z") == pytest.approx(69_000, abs=1)


@mostly_of_the_core
def test_an_unknown_mode_is_refused(box):
    with pytest.raises(RigError, match=r"refused REF: no.*mode"):
        box._ask("REF", AX="Z", COUNT=0, MODE="SOON")
    assert box.count("z") == 300


def test_a_box_without_index_inputs_is_refused_before_it_would_set_its_count():
    hello = {"NAME": "old_box", "RING": "512", "RATE": "40000", "WIDTH_MIN": "20", "WIDTH_MAX": "10000", "BOOT": "1"}
    box = VirtualWorld().box()
    box.identity = _identity(Line("A", 1, "OK", hello))
    with pytest.raises(RigError, match=r"\(old box\) has no inputs for index marks: update its firmware.*index_um"):
        box.reference_by_index("z", 0)
