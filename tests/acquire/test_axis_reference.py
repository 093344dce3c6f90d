"""References of the pulse box by index marks: motions, counts, refusals, and scans that begin with them."""

from __future__ import annotations

import pytest

from tests.acquire.conftest import COLS, ROWS
from wafer_viewer.acquire.pulse_reconciliation import marked_axes, reference_axes
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.rig import virtual_limits

MARKS_UM = {"x": 12_500.0, "y": -3_000.0, "z": -4_000.0}


@pytest.fixture
def marked_rig(virtual_rig):
    """A function that switches on a rig whose scales have index marks, known to its limits."""

    def switch_on(**settings):
        limits = virtual_limits(ROWS, COLS)
        axes = {axis: replace(limits.axis(axis), index_um=um) for axis, um in MARKS_UM.items()}
        rig = virtual_rig(limits=replace(limits, **axes), **settings)
        rig.stage.move_to(x_um=100.0, y_um=200.0, z_um=50.0)
        rig._firmware.reboot()
        rig.clock.sleep(2.0)
        with pytest.raises(RigError, match="restarted"):
            rig.box.count("z")
        return rig

    return switch_on


def test_an_axis_with_a_mark_is_referenced_by_it_and_the_others_by_the_stage(virtual_rig):
    limits = virtual_limits(ROWS, COLS)
    rig = virtual_rig(limits=replace(limits, y=replace(limits.y, index_um=500.0)))
    rig.stage.move_to(x_um=100.0, y_um=200.0, z_um=50.0)
    assert marked_axes(rig.limits) == ["y"]
    reference_axes(rig)
    assert rig.box.latched("y") is not None
    assert rig.box.latched("x") is rig.box.latched("z") is None
    at = rig.stage.position()
    assert (at.x_um, at.y_um, at.z_um) == (100.0, 700.0, rig.limits.z.low_um), "z went away from the objective"
    assert [rig.box.count(axis) for axis in "xyz"] == [2_000, 14_000, rig.limits.z.counts(at.z_um)]


def test_the_mark_is_passed_upward_and_z_goes_first(marked_rig, monkeypatch):
    rig = marked_rig()
    starts, start = [], rig.stage.start
    monkeypatch.setattr(rig.stage, "start", lambda axis, *to: (starts.append((axis, to)), start(axis, *to)))
    reference_axes(rig)
    assert starts == [("z", (-3_800.0, 1_000.0)), ("x", (12_700.0, 1_000.0)), ("y", (-2_800.0, 1_000.0))]
    assert [rig.box.count(axis) for axis in "xy"] == [254_000, -56_000]
    assert rig.box.count("z") == rig.limits.z.counts(rig.limits.z.low_um)


def test_a_mark_where_the_file_does_not_say_is_refused_with_both_positions(marked_rig):
    rig = marked_rig()
    rig.stage.axes["x"].index_um += 3.5
    with pytest.raises(
        RigError,
        match=r"counts the x axis at 12696\.50 um \(253930 counts\), and the stage says 12700\.00 um \(254000 counts\)",
    ):
        reference_axes(rig)


@pytest.mark.parametrize("off_um", [0.0, 0.1])
def test_a_mark_within_two_counts_is_accepted(off_um, marked_rig):
    rig = marked_rig()
    rig.stage.axes["x"].index_um += off_um
    reference_axes(rig)
    assert rig.box.latched("x") is not None


@pytest.mark.parametrize("off_um", [None, 300.0])
def test_a_mark_that_is_not_met_is_named_with_the_way_that_was_searched(off_um, marked_rig):
    rig = marked_rig()
    rig.stage.axes["y"].index_um = off_um and MARKS_UM["y"] + off_um
    with pytest.raises(RigError, match=r"no index mark of the y axis between -3200\.00 and -2800\.00 um.*index_um"):
        reference_axes(rig)


def test_a_slow_box_makes_the_axis_pass_its_mark_slowly(marked_rig, monkeypatch):
    monkeypatch.setattr("wafer_viewer.rigs.virtual.pulse_box_firmware.COUNT_RATE_HZ", 4_000)
    rig = marked_rig()
    starts, start = {}, rig.stage.start
    monkeypatch.setattr(rig.stage, "start", lambda axis, to, at: (starts.update({axis: at}), start(axis, to, at)))
    reference_axes(rig)
    assert starts == {"x": 50.0, "y": 50.0, "z": 10.0}, "1 000 counts/s"


def test_a_stop_on_the_way_to_a_mark_leaves_the_stage_at_rest(marked_rig):
    rig = marked_rig()
    began_s = rig.clock.now_s()
    with pytest.raises(MotionStopped):
        reference_axes(rig, lambda: rig.clock.now_s() - began_s > 1.0)
    assert not rig.stage.moving()


@pytest.mark.parametrize("strategy", ["z_snake", "x_lines"])
def test_a_scan_on_marks_takes_every_frame_where_it_should(strategy, marked_rig, small_plan, recorder, control):
    rig = marked_rig()
    plan = small_plan(rig, strategy)
    outcome = run_scan(plan, rig, recorder, control())
    assert (outcome.kept, outcome.missing, recorder.of_kind("fault")) == (plan.n_frames, (), [])


def test_after_a_restart_of_the_box_a_scan_passes_the_marks_again(marked_rig, small_plan, recorder, control):
    rig = marked_rig(faults=Faults(reboots=(9,)))
    plan = small_plan(rig, "z_snake")
    outcome = run_scan(plan, rig, recorder, control())
    assert (outcome.kept, outcome.missing) == (plan.n_frames, ())
    assert rig.box.latched("z") is not None


def test_a_scan_that_is_stopped_on_the_way_to_a_mark_ends_without_a_frame(marked_rig, small_plan, recorder, control):
    rig = marked_rig()
    one, began_s = control(), rig.clock.now_s()
    one.should_stop = lambda: rig.clock.now_s() - began_s > 0.5
    outcome = run_scan(small_plan(rig, "z_snake"), rig, recorder, one)
    assert (outcome.stopped, outcome.kept) == (True, 0)
    assert not rig.stage.moving()
