"""Flights of the camera: where they lead, when they are given up, what they have drawn on the way."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.gui.scenes.test_scene_view import until
from wafer_viewer.gui.page.browser_info import BrowserInfo, may_fly
from wafer_viewer.gui.scene.camera_controller import FLIGHT_S, LATE_S, STEP_S, CameraAnimator, CameraTransition, between
from wafer_viewer.gui.scene.camera_presets import CameraPose, direction_of

AT = np.array([1.0, 2.0, 0.1])
TOP, ISO = (CameraPose(AT + direction_of(preset) * 4, AT) for preset in ("top", "iso"))
NEAR = CameraPose(AT + 0.3 + direction_of("iso") * 0.5, AT + 0.3)
WAIT_S = 10.0
SHARES = st.floats(0, 1)
PLACES = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


@st.composite
def poses(draw: st.DrawFn) -> CameraPose:
    turn, rise, look_at = draw(st.floats(0, 6.3)), draw(st.floats(0.05, 1.55)), draw(PLACES)
    away = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    return CameraPose(look_at + away * draw(st.floats(0.05, 30)), look_at)


def distance(pose: CameraPose) -> float:
    return float(np.linalg.norm(pose.position - pose.look_at))


@given(start=poses(), goal=poses())
def test_a_flight_begins_where_the_camera_is_and_ends_exactly_at_its_goal(start, goal) -> None:
    first = between(start, goal, 0.0)
    assert np.allclose(first.position, start.position, atol=1e-6)
    assert np.allclose(first.look_at, start.look_at, atol=1e-6)
    assert between(start, goal, 1.0) is goal


@given(start=poses(), goal=poses(), share=SHARES)
def test_on_the_way_the_camera_is_no_nearer_farther_or_lower_than_at_both_ends(start, goal, share) -> None:
    pose = between(start, goal, share)
    near, far = sorted((distance(start), distance(goal)))
    assert near * (1 - 1e-6) <= distance(pose) <= far * (1 + 1e-6)
    low, high = sorted((start.direction[2], goal.direction[2]))
    assert low - 1e-6 <= pose.direction[2] <= high + 1e-6


@given(share=SHARES)
def test_the_goal_never_drifts_away_from_the_middle_of_the_picture(share) -> None:
    aside = np.linalg.norm(NEAR.look_at - ISO.look_at)
    pose = between(ISO, NEAR, share)
    assert np.linalg.norm(NEAR.look_at - pose.look_at) / distance(pose) <= aside / distance(ISO) + 1e-9


def test_the_camera_turns_the_shorter_way_round() -> None:
    west, east = (CameraPose(np.array([np.sin(a), np.cos(a), 1.0]), np.zeros(3)) for a in (-0.2, 0.2))
    assert between(west, east, 0.5).direction == pytest.approx(np.array([0, 1, 1]) / np.sqrt(2), abs=1e-9)


def flown(flight: CameraTransition, tells: bool = True) -> list[CameraPose]:
    """All steps of a flight in a browser that tells of each at once, or of none."""
    sent: list[CameraPose] = []
    for number in itertools.count():
        pose = flight.step(number * STEP_S)
        if pose is None:
            return sent
        sent.append(pose)
        assert not tells or flight.heard(pose.position)
    return sent


def test_a_flight_takes_as_long_as_it_says_and_its_last_step_is_the_goal() -> None:
    flight = CameraTransition(TOP, NEAR, 0.0)
    sent = flown(flight)
    assert len(sent) == pytest.approx(FLIGHT_S / STEP_S, abs=1)
    assert sent[-1] is NEAR
    assert not flight.late


def test_a_browser_that_is_late_is_sent_to_the_goal_at_once() -> None:
    flight = CameraTransition(TOP, NEAR, 0.0)
    sent = flown(flight, tells=False)
    assert flight.late
    assert sent[-1] is NEAR
    assert len(sent) * STEP_S < LATE_S + 3 * STEP_S < FLIGHT_S


def test_a_place_where_the_flight_has_not_been_is_a_hand_at_the_camera() -> None:
    flight = CameraTransition(TOP, NEAR, 0.0)
    steps = [flight.step(k * STEP_S) for k in range(4)]
    assert flight.heard(np.array([9.0, 9.0, 9.0]))  # what the browser did before the first step came
    assert all(flight.heard(step.position) for step in steps[2::-1] if step is not None)
    assert steps[3] is not None
    assert not flight.heard(steps[3].position + 0.05)


class Camera:
    """A camera that is put somewhere, and tells so."""

    def __init__(self) -> None:
        self.pose, self.puts = TOP, list[CameraPose]()
        self.tells = lambda pose: self.pilot.heard(pose.position)
        self.at_goal = threading.Event()
        self.pilot = CameraAnimator(self.put, lambda: self.pose)
        self.pilot.able = True

    def put(self, pose: CameraPose) -> None:
        self.pose = pose
        self.puts.append(pose)
        self.tells(pose)
        if pose in (NEAR, ISO):
            self.at_goal.set()


@pytest.fixture
def camera() -> Iterator[Camera]:
    made = Camera()
    yield made
    made.pilot.close()


def until_landed(camera: Camera) -> None:
    assert camera.at_goal.wait(WAIT_S)
    until(lambda: camera.pilot.goal is None)


@pytest.mark.slow
def test_a_pilot_brings_the_camera_to_the_goal_exactly(camera: Camera) -> None:
    assert camera.pilot.fly(TOP, NEAR)
    assert camera.pilot.goal is NEAR
    until_landed(camera)
    assert camera.pose is NEAR
    assert len(camera.puts) > 2


@pytest.mark.slow
def test_another_flight_takes_the_place_of_the_first(camera: Camera) -> None:
    begun = threading.Event()
    camera.tells = lambda pose: begun.set()
    camera.pilot.fly(TOP, NEAR)
    assert begun.wait(WAIT_S)
    camera.tells = lambda pose: camera.pilot.heard(pose.position)
    camera.pilot.fly(camera.pose, ISO)
    until_landed(camera)
    assert camera.pose is ISO
    assert NEAR not in camera.puts


@pytest.mark.slow
def test_a_hand_at_the_camera_ends_the_flight_where_it_is(camera: Camera) -> None:
    def tells(pose: CameraPose) -> None:
        camera.pilot.heard(pose.position)
        if len(camera.puts) == 3:
            camera.pilot.heard(pose.position + 0.5)
            camera.at_goal.set()

    camera.tells = tells
    camera.pilot.fly(TOP, NEAR)
    assert camera.at_goal.wait(WAIT_S)
    assert camera.pilot.goal is None
    camera.pilot.fly(TOP, ISO)
    until_landed(camera)
    assert NEAR not in camera.puts


@pytest.mark.slow
def test_a_camera_that_does_not_stand_where_it_was_put_is_put_there_again(camera: Camera) -> None:
    def elsewhere(pose: CameraPose) -> None:
        camera.pilot.heard(pose.position)
        if camera.puts.count(NEAR) == 1:
            camera.pose = CameraPose(NEAR.position, NEAR.look_at + 0.1)
            camera.at_goal.clear()

    camera.tells = elsewhere
    camera.pilot.fly(TOP, NEAR)
    until_landed(camera)
    until(lambda: camera.puts.count(NEAR) == 2)
    assert camera.pose is NEAR


def test_slow_browsers_and_people_who_want_stillness_have_it_jump() -> None:
    assert may_fly(BrowserInfo(renderer="ANGLE (NVIDIA, GeForce GTX 1650)"))
    assert may_fly(BrowserInfo())
    assert not may_fly(BrowserInfo(renderer="ANGLE (Google, Vulkan 1.3.0 (SwiftShader Device (Subzero)))"))
    assert not may_fly(BrowserInfo(renderer="ANGLE (NVIDIA, GeForce GTX 1650)", still=True))
    pilot = CameraAnimator(lambda pose: None, lambda: TOP)
    assert not pilot.fly(TOP, NEAR)
    assert pilot.goal is None


def test_after_a_late_flight_the_camera_jumps_for_a_while() -> None:
    now_s = [0.0]
    late, landed = threading.Event(), threading.Event()

    def stand(pose: CameraPose) -> None:
        now_s[0] += LATE_S + 0.1
        (landed if pose is NEAR else late).set()

    pilot = CameraAnimator(stand, lambda: NEAR, lambda: now_s[0])
    pilot.able = True
    assert pilot.fly(TOP, NEAR)
    assert landed.wait(WAIT_S)
    assert not pilot.fly(NEAR, TOP)
    now_s[0] += 100
    assert pilot.fly(NEAR, TOP)
    pilot.close()
