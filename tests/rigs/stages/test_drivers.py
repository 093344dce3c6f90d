"""References, faults and damaged lines: every driver on its simulated controller."""

from __future__ import annotations

from itertools import pairwise

import pytest

from tests.rigs.stages.conftest import DRIVERS, axis_config, small_limits, switch_on
from wafer_viewer.model.errors import MotionStopped, RigError, RigTimeout
from wafer_viewer.rigs.stages.controllers import CONTROLLERS
from wafer_viewer.rigs.stages.motion_controller import REPLY_S, TRIES

ONE_DRIVER = pytest.mark.parametrize("driver", CONTROLLERS)


def true_um(bench):
    at = bench.true_stage.position()
    return at.x_um, at.y_um, at.z_um


def test_a_status_with_too_few_axes_is_damaged_and_asked_for_again():
    bench = switch_on(DRIVERS["grbl"])
    bench.cables["grbl"].ahead = [b"<Idle|MPos:1.000,2.000|FS:0,0>\n"]
    assert bench.stage.position().z_um == pytest.approx(0.0, abs=0.1)


def test_a_stage_that_was_switched_on_is_not_homed_and_its_first_move_homes_it(cold):
    assert not cold.stage.homed()
    cold.stage.move_to(x_um=100.0, y_um=-50.0, z_um=20.0)
    assert cold.stage.homed()
    assert true_um(cold) == pytest.approx((100.0, -50.0, 20.0), abs=0.1)


def test_z_finds_its_reference_before_x_and_y_move(cold):
    begun = true_um(cold)
    with pytest.raises(MotionStopped):
        cold.stage.move_to(x_um=0.0, should_stop=lambda: cold.true_stage.position().z_um != begun[2])
    if "grbl" not in cold.cables:
        assert true_um(cold)[:2] == begun[:2]
    assert not cold.stage.homed()


def test_a_search_that_is_stopped_has_found_nothing_and_the_next_one_does(cold):
    begun_s = cold.clock.now_s()
    with pytest.raises(MotionStopped):
        cold.stage.move_to(z_um=0.0, should_stop=lambda: cold.clock.now_s() > begun_s + 0.1)
    assert not cold.stage.moving()
    assert not cold.stage.homed()
    stood = true_um(cold)
    cold.clock.sleep(0.5)
    assert true_um(cold) == stood
    cold.stage.move_to(x_um=0.0, y_um=0.0, z_um=0.0)
    assert true_um(cold) == pytest.approx((0.0, 0.0, 0.0), abs=0.1)


def test_a_motion_at_a_speed_needs_a_reference(cold):
    with pytest.raises(RigError, match=r"z axis is not homed.*home the stage"):
        cold.stage.start("z", 10.0, 100.0)
    assert not cold.true_stage.moving()


def test_a_stop_comes_within_one_look_of_the_stage(bench):
    looks = []

    def should_stop():
        looks.append(bench.clock.now_s())
        return len(looks) == 20

    with pytest.raises(MotionStopped):
        bench.stage.move_to(z_um=9_000.0, should_stop=should_stop)
    assert max(after - before for before, after in pairwise(looks)) < 0.02
    ramp_s = bench.limits.z.speed_um_s / bench.limits.z.acceleration_um_s2
    assert bench.clock.now_s() - looks[-1] < ramp_s + bench.limits.z.settle_s + bench.limits.x.settle_s + 0.03


def test_the_speed_of_a_motion_is_that_of_its_command(bench):
    bench.stage.start("z", 1_000.0, 250.0)
    bench.clock.sleep(1.0)
    before_s, before_um = bench.clock.now_s(), bench.true_stage.position().z_um
    bench.clock.sleep(2.0)
    speed = (bench.true_stage.position().z_um - before_um) / (bench.clock.now_s() - before_s)
    assert speed == pytest.approx(250.0, rel=1e-3)
    bench.stage.stop()


def test_an_axis_that_stalls_is_named_and_stops_the_others(bench):
    def should_stop():
        if bench.true_stage.position().x_um > 5_000.0 and not stalls:
            stalls.append(True)
            bench.controllers[bench.axes["x"].controller].axes["x"].stall()
        return False

    stalls = []

    with pytest.raises(RigError, match=r"(x axis.*FS|ALARM:1|error 1024).*home it") as told:
        bench.stage.move_to(x_um=3e4, y_um=3e4, should_stop=should_stop)
    assert not isinstance(told.value, MotionStopped)
    bench.clock.sleep(0.2)
    assert not bench.true_stage.moving()
    assert bench.true_stage.position().y_um < 1.5e4
    bench.stage.move_to(x_um=10.0)
    assert bench.true_stage.position().x_um == pytest.approx(10.0, abs=0.1)


def test_a_controller_that_refuses_a_goal_says_so_in_words():
    for driver in CONTROLLERS:
        bench = switch_on(DRIVERS[driver], high_um=50_000.0)
        with pytest.raises(RigError, match=r"(rejected 'move abs|refused '\$J|error 7 after 'MOV).*range"):
            bench.stage.move_to(z_um=45_000.0)
        assert true_um(bench) == pytest.approx((0.0, 0.0, 0.0), abs=0.1)


def test_a_silent_controller_is_given_up_in_time(bench):
    for cable in bench.cables.values():
        cable.deaf = True
    begun_s = bench.clock.now_s()
    with pytest.raises(RigTimeout, match=r"did not answer.*power.*cable"):
        bench.stage.move_to(z_um=10.0)
    assert bench.clock.now_s() - begun_s < 3 * TRIES * (REPLY_S + 0.1)


def test_an_unplugged_cable_is_a_fault_of_the_rig(bench):
    for cable in bench.cables.values():
        cable.unplugged = True
    for use in (bench.stage.position, bench.stage.stop, bench.stage.moving, bench.stage.homed, bench.stage.wait):
        with pytest.raises(RigError, match=r"was lost \(Input/output error\).*cable"):
            use()


@pytest.mark.parametrize(
    "ahead",
    [
        b"\xff\x00\x7f garbage \xfe",
        b"garbage of another speed\r\n",
        b"@01 0 99 OK IDLE -- 0\r\n@02 2 07 OK BUSY -- 5\r\n",
        b"[MSG:Caution]\r\nok\r\n",
        b"1=1 \n2=1 \n3=1\n",
        b"<Idle|MPos:1.0,\r\n",
    ],
)
def test_garbage_and_answers_to_others_are_not_taken_for_an_answer(bench, ahead):
    bench.stage.move_to(x_um=100.0, y_um=100.0, z_um=100.0)
    for cable in bench.cables.values():
        cable.ahead = [ahead]
    assert bench.stage.homed()
    for cable in bench.cables.values():
        cable.ahead = [ahead]
    at = bench.stage.position()
    assert (at.x_um, at.y_um, at.z_um) == pytest.approx((100.0, 100.0, 100.0), abs=0.1)
    for cable in bench.cables.values():
        cable.ahead = [ahead, ahead]
    bench.stage.move_to(z_um=200.0)
    assert bench.true_stage.position().z_um == pytest.approx(200.0, abs=0.1)


def test_a_motion_that_never_ends_is_given_up_and_a_stop_ends_it(bench):
    def should_stop():
        bench.controllers[bench.axes["z"].controller].axes["z"].endless |= bench.clock.now_s() < begun_s + 1.0
        return False

    begun_s = bench.clock.now_s()
    with pytest.raises(RigTimeout, match="still reports motion"):
        bench.stage.move_to(z_um=50.0, should_stop=should_stop)
    assert 2.0 < bench.clock.now_s() - begun_s < 3.0
    assert not bench.stage.moving()
    bench.stage.move_to(z_um=60.0)
    assert bench.true_stage.position().z_um == pytest.approx(60.0, abs=0.1)


@ONE_DRIVER
def test_a_controller_says_what_it_is(driver):
    bench = switch_on(DRIVERS[driver])
    assert {"zaber": "firmware 7.35", "grbl": "1.1h", "pi_gcs2": "Physik Instrumente"}[driver] in next(
        iter(bench.stage._controllers.values())
    ).identity()


@ONE_DRIVER
def test_a_controller_that_is_not_there_is_given_up_in_time(driver):
    from tests.rigs.stages.conftest import Cable
    from wafer_viewer.rigs.stages.motion_controller import ControllerAxis
    from wafer_viewer.rigs.virtual.clock import VirtualClock
    from wafer_viewer.rigs.virtual.serial_port import VirtualPort

    class Nobody:
        def receive(self, data, time_s):
            return b""

    clock = VirtualClock()
    axis = ControllerAxis.of(axis_config(driver, "x", small_limits()))
    with pytest.raises(RigTimeout, match="power"):
        CONTROLLERS[driver].connect(Cable(VirtualPort(clock, Nobody())), clock, {"x": axis})
    assert clock.now_s() < 5.0
