"""Whole scans over the simulated cable: through planner, wire, firmware, stage, camera and runner."""

from __future__ import annotations

import pytest

from wafer_viewer.acquire import motion
from wafer_viewer.acquire.planner import STRATEGIES, plan_scan
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.acquisition.plan import Field, FocusSweep, Shot
from wafer_viewer.model.errors import MissedPulse, RigError
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits
from wafer_viewer.rigs.virtual.serial_port import Interference

ONE_EXPOSURE = [name for name, strategy in STRATEGIES.items() if strategy.min_exposures == 1]


def all_shots(plan):
    return {shot for leg in plan.legs for shot in leg.shots}


def assert_each_frame_is_what_it_says(plan, frames, place):
    """The picture was taken, truly, where its frame says, to within the errors of the scales."""
    for frame in frames:
        (x_um, y_um, z_um), exposure_us = place(frame.image)
        assert z_um == pytest.approx(frame.z_um, abs=0.05)
        assert x_um == pytest.approx(frame.x_um, abs=0.6)
        assert y_um == pytest.approx(frame.y_um, abs=0.6)
        field = plan.field(frame.shot.field)
        assert frame.z_um == pytest.approx(plan.sweep.z_um(field, frame.shot.k), abs=0.1)
        assert frame.x_um == pytest.approx(field.x_um, abs=1.0)
        assert frame.y_um == pytest.approx(field.y_um, abs=1.0)
        assert exposure_us == frame.exposure_us == plan.exposures_us[frame.shot.exposure]


@pytest.mark.parametrize("strategy", ONE_EXPOSURE)
def test_a_whole_scan_fills_every_slot_once(strategy, virtual_rig, small_plan, recorder, control, place):
    rig = virtual_rig()
    plan = small_plan(rig, strategy, exposures_us=(100.0, 3_000.0))
    outcome = run_scan(plan, rig, recorder, control())
    assert len(recorder.frames) == plan.n_frames == outcome.kept
    assert {f.shot for f in recorder.frames} == all_shots(plan)
    assert outcome.missing == ()
    assert recorder.of_kind("missed") == []
    assert_each_frame_is_what_it_says(plan, recorder.frames, place)


@pytest.mark.parametrize("strategy", ONE_EXPOSURE)
def test_a_scan_takes_as_long_as_its_price(strategy, virtual_rig, small_plan, recorder, control):
    rig = virtual_rig()
    plan = small_plan(rig, strategy, rows=3, cols=3, n_frames=60)
    assert run_scan(plan, rig, recorder, control()).duration_s == pytest.approx(plan.predicted_s, rel=0.03)


@pytest.mark.parametrize("counter", [True, False])
@pytest.mark.parametrize("strategy", ONE_EXPOSURE)
def test_what_got_lost_is_taken_again(strategy, counter, virtual_rig, small_plan, recorder, control, place):
    faults = Faults(ignored_triggers=(1, 17, 50), lost_images=(30,), incomplete=(31,), trigger_counter=counter)
    rig = virtual_rig(faults=faults)
    plan = small_plan(rig, strategy)
    outcome = run_scan(plan, rig, recorder, control())
    assert outcome.repaired == 5
    assert outcome.missing == ()
    assert len(recorder.frames) == plan.n_frames
    assert {f.shot for f in recorder.frames} == all_shots(plan)
    assert_each_frame_is_what_it_says(plan, recorder.frames, place)
    missed = {event[1] for event in recorder.of_kind("missed")}
    assert missed == {event[1] for event in recorder.of_kind("repaired")}
    assert missed == {[s for leg in plan.legs for s in leg.shots][i - 1] for i in (1, 17, 50, 30, 31)}


@pytest.mark.parametrize("strategy", ["z_snake", "stop_and_shoot"])
def test_a_long_way_between_fields_is_no_missed_heartbeat(strategy, virtual_rig, recorder, control):
    rig = virtual_rig()
    places = enumerate([-140_000.0, 140_000.0], start=1)
    fields = tuple(Field(number=i, row=0, col=i, x_um=x, y_um=0.0, z_start_um=0.0) for i, x in places)
    plan = plan_scan(fields, FocusSweep(z_step_um=1.0, n_frames=5), (100.0,), rig.limits, strategy)
    assert run_scan(plan, rig, recorder, control()).kept == 10


@pytest.mark.slow
def test_in_real_time_rendering_is_reported_apart(recorder, control):
    rig = VirtualRig("plane", limits=virtual_limits(48, 64), real_time=True)
    fields = (Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0),)
    plan = plan_scan(fields, FocusSweep(z_step_um=1.0, n_frames=12), (100.0,), rig.limits)
    outcome = run_scan(plan, rig, recorder, control())
    rig.close()
    assert outcome.kept == 12
    assert outcome.prepared_s > outcome.duration_s > 0.5 * plan.predicted_s


def test_a_bad_wire_costs_no_frame(virtual_rig, small_plan, recorder, control, place):
    wire = Interference(lost_fraction=0.02, damaged_fraction=0.02, seed=5)
    rig = virtual_rig(faults=Faults(wire=wire, trigger_counter=False))
    plan = small_plan(rig, n_frames=60)
    outcome = run_scan(plan, rig, recorder, control())
    assert len(recorder.frames) == plan.n_frames
    assert outcome.repaired == 0
    assert_each_frame_is_what_it_says(plan, recorder.frames, place)
    assert rig.box.retries > 0


def test_a_slot_that_stays_empty_is_reported_after_two_repairs(virtual_rig, small_plan, recorder, control):
    # Trigger 0 is the test pulse, 1 to 20 the pass, 21 and 22 the two repairs of one slot.
    rig = virtual_rig(faults=Faults(ignored_triggers=(10, 21, 22)))
    plan = small_plan(rig, rows=1, cols=1)
    outcome = run_scan(plan, rig, recorder, control())
    assert outcome.missing == (Shot(1, 9),)
    (fault,) = recorder.of_kind("fault")
    assert "field 1 frame 9 (no image came for its pulse)" in fault[1]
    assert "2 repairs" in fault[1]
    assert outcome.kept == plan.n_frames - 1


def test_frames_reach_the_sink_while_the_pass_is_running(virtual_rig, small_plan, control):
    rig = virtual_rig()
    plan = small_plan(rig, n_frames=60)
    moving = []

    class Watcher:
        def frame(self, frame):
            moving.append(rig.stage.moving())

        def __getattr__(self, name):
            return lambda *_: None

    run_scan(plan, rig, Watcher(), control())
    assert sum(moving) >= len(moving) - 2 * len(plan.legs)


def test_a_stopped_scan_continues_where_it_was(virtual_rig, small_plan, recorder, control, place):
    rig = virtual_rig()
    plan = small_plan(rig)
    first = run_scan(plan, rig, recorder, control(stop_after=33))
    assert first.stopped
    assert first.missing == ()
    assert 33 <= first.kept < plan.n_frames
    assert not rig.stage.moving()
    stored = {f.shot for f in recorder.frames}
    second = run_scan(plan, rig, recorder, control(), skip=stored)
    assert not second.stopped
    assert first.kept + second.kept == plan.n_frames == len(recorder.frames)
    assert {f.shot for f in recorder.frames} == all_shots(plan)
    assert_each_frame_is_what_it_says(plan, recorder.frames, place)
    assert second.duration_s < 0.7 * plan.predicted_s


def test_a_stop_breaks_off_the_way_to_a_pass(virtual_rig, small_plan, recorder, control):
    rig = virtual_rig()
    plan = small_plan(rig)
    rig.stage.move_to(x_um=60_000.0)
    hand = control()
    hand.should_stop = lambda: rig.stage.position().x_um < 50_000.0
    stopped = run_scan(plan, rig, recorder, hand)
    assert (stopped.stopped, stopped.kept, stopped.missing) == (True, 0, ())
    assert not rig.stage.moving()
    assert 40_000.0 < rig.stage.position().x_um < 50_000.0
    assert [event[0] for event in recorder.events] == ["begun", "ended"]
    assert run_scan(plan, rig, recorder, control()).kept == plan.n_frames


def test_a_finished_scan_moves_nothing_when_continued(virtual_rig, small_plan, recorder, control):
    rig = virtual_rig()
    plan = small_plan(rig)
    outcome = run_scan(plan, rig, recorder, control(), skip=all_shots(plan))
    assert outcome.kept == 0
    assert recorder.events == []
    assert rig.stage.position().z_um == 0.0


def test_a_pause_takes_hold_between_passes(virtual_rig, small_plan, recorder, control):
    rig = virtual_rig()
    plan, watcher = small_plan(rig), control(pause_after=5)
    outcome = run_scan(plan, rig, recorder, watcher)
    assert watcher.pauses == 1
    assert outcome.kept == plan.n_frames


@pytest.mark.parametrize("strategy", ["z_snake", "stop_and_shoot"])
def test_a_box_that_lost_its_power_is_referenced_and_its_pass_taken_again(
    strategy, virtual_rig, small_plan, recorder, control, place
):
    rig = virtual_rig(faults=Faults(reboots=(25,)))
    plan = small_plan(rig, strategy)
    outcome = run_scan(plan, rig, recorder, control())
    assert outcome.kept == plan.n_frames
    again = {event[1] for event in recorder.of_kind("missed")}
    assert again == set(plan.legs[1].shots)
    assert_each_frame_is_what_it_says(plan, recorder.frames, place)
    assert not rig.stage.moving()


def test_a_full_disk_leaves_the_rig_at_rest(virtual_rig, small_plan, control):
    rig = virtual_rig()

    class FullDisk:
        def frame(self, frame):
            raise OSError(28, "No space left on device")

        def __getattr__(self, name):
            return lambda *_: None

    with pytest.raises(OSError, match="No space"):
        run_scan(small_plan(rig), rig, FullDisk(), control())
    rig.clock.sleep(0.1)
    rig.box.pulses()
    rig.clock.sleep(5.0)
    assert not rig.stage.moving()
    assert rig.box.pulses() == []
    assert rig.camera.next_image(1.0) is None


@pytest.mark.parametrize(
    ("strategy", "call", "late_s"), [("z_snake", "start", 2.5), ("stop_and_shoot", "move_to", 2.05)]
)
def test_slow_stage_is_named_when_the_box_gets_no_heartbeat(
    strategy, call, late_s, virtual_rig, small_plan, recorder, control, monkeypatch
):
    rig = virtual_rig()
    plan, quick = small_plan(rig, strategy), getattr(rig.stage, call)

    def slow(*args, **kwargs):
        rig.clock.sleep(late_s)
        return quick(*args, **kwargs)

    monkeypatch.setattr(rig.stage, call, slow)
    with pytest.raises(RigError, match=r"The stage was waited for during 2\.\d s, and without a heartbeat .* its port"):
        run_scan(plan, rig, recorder, control())


def test_stop_and_shoot_sends_the_heartbeat_during_a_long_move(virtual_rig, small_plan, recorder, control, monkeypatch):
    rig = virtual_rig()
    plan, quick = small_plan(rig, "stop_and_shoot"), rig.stage.move_to

    def slow(*, should_stop, **goal):
        for _ in range(10):
            rig.clock.sleep(0.3)
            should_stop()
        return quick(should_stop=should_stop, **goal)

    monkeypatch.setattr(rig.stage, "move_to", slow)
    monkeypatch.setattr(motion, "SPARE_S", 10.0)
    assert run_scan(plan, rig, recorder, control()).kept == plan.n_frames


def test_a_dead_trigger_cable_is_found_before_anything_moves(virtual_rig, small_plan, recorder, control):
    rig = virtual_rig(faults=Faults(ignored_triggers=(0, 1, 2)))
    with pytest.raises(RigError, match=r"3 test pulses.*trigger cable"):
        run_scan(small_plan(rig), rig, recorder, control())
    assert rig.stage.position().x_um == 0.0
    assert recorder.frames == []


def test_a_camera_that_goes_silent_ends_the_scan(virtual_rig, small_plan, recorder, control):
    rig = virtual_rig(faults=Faults(lost_images=tuple(range(21, 60))))
    with pytest.raises(RigError, match="0 images for 20 pulses"):
        run_scan(small_plan(rig), rig, recorder, control())
    assert len(recorder.frames) == 20


def test_a_scale_that_never_counts_is_a_missed_pulse(virtual_rig, small_plan, recorder, control, monkeypatch):
    rig = virtual_rig()
    plan = small_plan(rig)
    monkeypatch.setattr("wafer_viewer.rigs.virtual.stage.MotionProfile.crossing_s", lambda *_: None)
    with pytest.raises(MissedPulse, match="0 of 20 pulses"):
        run_scan(plan, rig, recorder, control())
