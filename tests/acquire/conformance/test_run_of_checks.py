"""Safety of a run: what moves and how far, stops, and devices that are lost on the way."""

from __future__ import annotations

import pytest

from tests.acquire.conformance.conftest import BY_NAME
from wafer_viewer.acquire.conformance.bench import TravelLimits, travel_windows
from wafer_viewer.acquire.conformance.runner import CHECKS, run_checks
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import virtual_limits

LIMITS = virtual_limits(16, 24)
MOVING = [check.name for check in CHECKS if check.moves]


@pytest.fixture
def rig(switched_on):
    rig = switched_on()
    yield rig
    rig.close()


def ends_of_motions(rig):
    """Collect where each motion of each axis ends, um."""
    ends = {axis: [] for axis in rig.stage.axes}
    rig.stage.on_motion(lambda axis, time_s: ends[axis].append(rig.stage.axes[axis].profile.position_at(1e9)))
    return ends


def test_without_a_word_nothing_moves(rig):
    results = list(run_checks(rig, move=False))
    assert rig.stage.motions == 0
    assert [result.name for result in results if result.verdict == "not run"] == MOVING
    assert all("--move" in result.why for result in results if result.name in MOVING)
    assert all(result.verdict == "passed" for result in results if result.name not in MOVING)


def test_axes_are_announced_before_they_move_and_stay_in_their_ranges(rig):
    rig.stage.move_to(x_um=150_000.0, y_um=-20.0, z_um=3_000.0)
    ends, said = ends_of_motions(rig), []
    before = rig.stage.motions
    for _ in run_checks(rig, move=True, tell=lambda words: said.append((words, rig.stage.motions))):
        pass
    assert [words[:60] for words, _ in said] == [
        "z moves by 620.0 um at the most, between 2380.0 and 3000.0 u",
        "x moves by 17400.0 um at the most, between 137600.0 and 1550",
        "y moves by 17400.0 um at the most, between -8720.0 and 8680.",
    ]
    assert {motions for _, motions in said} == {before}
    assert (min(ends["z"]), max(ends["z"])) == pytest.approx((2_380.0, 3_000.0))
    assert (min(ends["x"]), max(ends["x"])) == pytest.approx((137_600.0, 155_000.0))
    assert (min(ends["y"]), max(ends["y"])) == pytest.approx((-8_720.0, 8_680.0))
    at = rig.stage.position()
    assert (at.x_um, at.y_um, at.z_um) == pytest.approx((150_000.0, -20.0, 3_000.0))


def test_ranges_are_those_that_were_asked_for(rig):
    ends = ends_of_motions(rig)
    travel = TravelLimits(longest_um=400.0, z_um=(50.0, 150.0))
    assert all(result.verdict == "passed" for result in run_checks(rig, move=True, travel=travel))
    assert (min(ends["x"]), max(ends["x"])) == pytest.approx((-200.0, 200.0))
    assert (min(ends["z"][:-1]), max(ends["z"][:-1])) == pytest.approx((50.0, 150.0))
    assert ends["z"][-1] == pytest.approx(0.0, abs=1e-9), "where it began"


@pytest.mark.parametrize(
    ("travel", "words"),
    [
        (TravelLimits(z_um=(0.0, 10_001.0)), "z axis cannot go to 10001"),
        (TravelLimits(z_um=(10.0, 10.0)), "is empty"),
        (TravelLimits(longest_um=0.0), "must be over 0"),
    ],
)
def test_a_range_that_cannot_be_is_refused_before_anything_runs(travel, words, rig):
    with pytest.raises(RigError, match=words):
        run_checks(rig, move=True, travel=travel)
    assert rig.stage.motions == 0


def test_z_keeps_below_its_position_and_the_safe_height():
    assert travel_windows(LIMITS, Position(0, 0, -100.0), TravelLimits())["z"].high_um == -100.0
    assert travel_windows(LIMITS, Position(0, 0, 9_900.0), TravelLimits())["z"].high_um == LIMITS.objective.safe_z_um
    low = travel_windows(LIMITS, Position(0, 0, LIMITS.z.low_um), TravelLimits())["z"]
    assert (low.low_um, low.high_um) == (-10_000.0, -9_380.0)


def test_the_fastest_speed_follows_range_and_box():
    short = travel_windows(LIMITS, Position(0, 0, 0), TravelLimits(longest_um=100.0))["x"]
    assert 500.0 < short.speed_um_s < LIMITS.x.speed_um_s
    assert 2 * LIMITS.x.run_up_um(short.speed_um_s) + 64e-3 * short.speed_um_s == pytest.approx(100.0, abs=0.2)
    slow = replace(LIMITS, count_rate_hz=40_000.0)
    assert travel_windows(slow, Position(0, 0, 0), TravelLimits())["x"].speed_um_s == pytest.approx(2_000.0)


@pytest.mark.parametrize("name", ["camera_frames", "stage_stops", "box_pulses_slow", "slips"])
def test_a_stop_leaves_the_rig_at_rest_and_the_rest_is_not_run(name, rig):
    names = [check.name for check in CHECKS]
    running, looks = [], []

    def should_stop():
        looks.append(running[-1:] == [name])
        return sum(looks) > 3

    results = {
        one.name: one
        for one in run_checks(rig, move=True, begin=lambda check: running.append(check.name), should_stop=should_stop)
    }
    stopped = names[names.index(name) :]
    assert running[-1] == name
    assert {one: results[one].verdict for one in stopped} == dict.fromkeys(stopped, "not run")
    assert {results[one].why for one in stopped} == {"Stopped before its end."}
    assert not rig.stage.moving()
    with pytest.raises(RigError, match="not armed"):
        rig.box.fire()


def test_an_interruption_stops_the_stage(rig):
    def look():
        if rig.stage.motions > 3:
            raise KeyboardInterrupt
        return False

    with pytest.raises(KeyboardInterrupt):
        list(run_checks(rig, move=True, checks=[BY_NAME["slips"]], should_stop=look))
    rig.clock.sleep(0.2)
    assert not rig.stage.moving()


def test_a_box_that_is_lost_is_named_and_the_rest_goes_on(rig):
    def begin(check):
        if check.name == "box_heartbeat":
            rig._port.close()

    results = {one.name: one for one in run_checks(rig, move=True, begin=begin)}
    assert results["box_heartbeat"].verdict == "failed"
    assert "port is closed" in results["box_heartbeat"].why
    lost = [check.name for check in CHECKS if "pulse box" in check.roles][5:]
    assert {results[name].verdict for name in lost if name != "box_heartbeat"} == {"not run"}
    assert "The pulse box no longer works" in results["slips"].why
    alone = [check.name for check in CHECKS if "pulse box" not in check.roles]
    assert len(alone) == 7
    assert {results[name].verdict for name in alone} == {"passed"}


def test_without_light_brightness_is_not_judged(switched_on):
    rig = switched_on(light=0.0)
    (result,) = run_checks(rig, move=False, checks=[BY_NAME["camera_brightness"]])
    assert (result.verdict, result.why) == ("not run", "There is no light: switch it on and run it again.")


def test_a_box_that_is_referenced_already_is_not_judged_by_its_refusal(rig):
    checks = [BY_NAME["box_counts_at_rest"], BY_NAME["box_refuses_without_reference"]]
    _, result = run_checks(rig, move=False, checks=checks)
    assert result.verdict == "not run"
    assert "switch the box off and on" in result.why
