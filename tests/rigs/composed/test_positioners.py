"""Positioners on simulated controllers: files, motions, faults, and the optics that follow from them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.rigs.composed.test_composed_rig import changed, example, read
from wafer_viewer.acquire.commanded_frames import CommandedFrames
from wafer_viewer.acquire.motion import come_to_rest, move_positioner, read_positioners
from wafer_viewer.model.errors import MotionStopped, RigError, RigTimeout
from wafer_viewer.rigs.composed.device_checks import check_devices
from wafer_viewer.rigs.rig_config import device_opener, open_rig

RIG = "nosepiece_simulated"
POSITIONERS = "devices.positioners"


@pytest.fixture
def switch_on(tmp_path):
    rigs = []

    def opened(data: dict | None = None):
        data = data or example(RIG)
        data["devices"]["camera"]["options"] = {"scene": "plane"}
        rigs.append(open_rig(read(data, tmp_path)))
        return rigs[-1]

    yield opened
    for rig in rigs:
        rig.close()


def go(rig, name, to, should_stop=lambda: False):
    return move_positioner(rig, name, to, should_stop)


def simulated(rig):
    """The far end of the cable of the only controller."""
    return rig.stage._controllers["chain"]._line._port._device


def spare(**changes):
    return {"role": "light", "controller": "chain", "address": "9", **changes}


SCALE = {"units_per_unit": 1.0, "low": 0.0, "high": 100.0, "speed": 1.0, "acceleration": 1.0}
WRONG = {
    f"{POSITIONERS}.lamp.role": ("filter", r"role.*filter|filter.*role|'filter'"),
    f"{POSITIONERS}.lamp.controller": ("focus", r"positioners\.lamp\.controller is 'focus'.*one of .*chain"),
    f"{POSITIONERS}.lamp.address": ("A", r"positioners\.lamp\.address is 'A'.*device and axis"),
    f"{POSITIONERS}.zoom.address": ("1", r"both have the address '1' of 'chain'.*its own"),
    f"{POSITIONERS}.tilt_a.address": ("3 1", r"both have the address '3.*its own"),
    f"{POSITIONERS}.lamp.high": (120.0, r"high is 120.*at most 100 %"),
    f"{POSITIONERS}.lamp.low": (100.0, r"high is 100.*over low"),
    f"{POSITIONERS}.zoom.units_per_unit": (0.0, r"units_per_unit is 0\.0.*over 0"),
    f"{POSITIONERS}.zoom.speed": (0.0, r"speed is 0\.0.*over 0"),
    f"{POSITIONERS}.zoom.positions": ({"far": {"at": 9.0}}, r"positions\.far\.at is 9: it must be between 1 and 4"),
    f"{POSITIONERS}.nosepiece.positions": (None, r"positions is .*one table for each objective"),
    f"{POSITIONERS}.nosepiece.positions.20x.objective": (None, r"positions\.20x\.objective must be given"),
    f"{POSITIONERS}.nosepiece.positions.20x.objective.safe_z_um": (6_000.0, r"safe_z_um.*20x.*at most.*5000"),
    f"{POSITIONERS}.x": (spare(**SCALE), r"positioners\.x: the name must be.*not x, y or z"),
    f"{POSITIONERS}.tilt_c": (spare(**SCALE, role="tilt_a") | {"high": 9.0}, r"both have the role 'tilt_a'"),
    "devices.objective": (
        example("zaber_simulated")["devices"]["objective"],
        r"positioners\.nosepiece both name objectives: leave the first out",
    ),
}


@pytest.mark.parametrize("path", WRONG)
def test_a_file_whose_positioners_are_wrong_is_refused_with_field_and_mend(path, tmp_path):
    value, words = WRONG[path]
    with pytest.raises(RigError, match=f"(?s)rig.toml.*{words}"):
        read(changed(path, value, RIG), tmp_path)


def test_a_file_without_any_objective_is_refused(tmp_path):
    with pytest.raises(RigError, match=r"devices\.objective is missing.*role 'objective'"):
        read(changed("devices.objective", None), tmp_path)


def test_a_positioner_that_was_switched_on_is_not_homed_and_its_first_motion_homes_it(switch_on):
    rig = switch_on()
    assert {state.reading.words for state in read_positioners(rig)} == {"not homed"}
    assert go(rig, "lamp", 40.0).position == pytest.approx(40.0, abs=0.01)
    assert go(rig, "zoom", "narrow").words == "narrow"
    assert simulated(rig).axes["lamp"].homed
    assert not simulated(rig).axes["tilt_a"].homed


@pytest.mark.slow
def test_turning_the_nosepiece_changes_setup_limits_pixel_and_calibration(switch_on):
    rig = switch_on()
    assert (rig.setup.objective, rig.calibration) == ("unknown", None)
    assert rig.limits.objective.safe_z_um == 4_800.0  # the highest of all: any may be in the light path
    go(rig, "zoom", "wide")
    go(rig, "nosepiece", "20x")
    assert (rig.setup.objective, rig.setup.zoom) == ("20x/0.42", 1.0)
    assert rig.limits.objective.numerical_aperture == 0.42
    assert rig.calibration.pixel_um == rig.limits.pixel_um == 0.233645
    assert rig.calibration.problem(rig.setup, "2026-11-23") is None
    go(rig, "nosepiece", "10x")
    assert rig.calibration.pixel_um == rig.limits.pixel_um == 0.46729
    go(rig, "zoom", 2.0)
    assert rig.limits.pixel_um == pytest.approx(0.233645)
    assert rig.limits.objective.magnification == 20.0
    assert rig.calibration is None


@pytest.mark.slow
def test_z_is_at_the_safe_z_of_all_objectives_while_anything_turns_and_stays_while_the_light_changes(switch_on):
    rig = switch_on()
    go(rig, "nosepiece", "10x")
    go(rig, "tilt_b", 0.0)
    for name, to, lifts in (("lamp", 50.0, False), ("nosepiece", "20x", True), ("tilt_b", 1.0, True)):
        rig.stage.move_to(z_um=0.0)
        axis, seen_um = simulated(rig).axes[name], []

        def look(axis=axis, seen_um=seen_um):
            if axis.moving:
                seen_um.append(rig.stage.position().z_um)
            return False

        go(rig, name, to, look)
        assert seen_um
        assert min(seen_um) == pytest.approx(4_800.0 if lifts else 0.0, abs=0.01)
        if lifts:
            assert max(seen_um) == pytest.approx(4_800.0, abs=0.01)


def test_an_objective_that_is_in_the_light_path_already_does_not_lift_z(switch_on):
    rig = switch_on()
    go(rig, "nosepiece", "10x")
    rig.stage.move_to(z_um=-100.0)
    go(rig, "nosepiece", "10x")
    assert rig.stage.position().z_um == pytest.approx(-100.0, abs=0.01)


@pytest.mark.parametrize(
    ("name", "to", "words"),
    [
        ("lamp", 101.0, r"'lamp' cannot go to 101 %: its range is 0 to 100 %"),
        ("lamp", "bright", r"'lamp' cannot go to 'bright': it must be a number in %"),
        ("nosepiece", "50x", r"'nosepiece' cannot go to '50x': it must be one of '10x', '20x'"),
        ("nosepiece", 45.0, r"'nosepiece' cannot go to '45.0': it must be one of '10x', '20x'"),
        ("filter", 1.0, r"no positioner 'filter': it has lamp, nosepiece, zoom, tilt_a, tilt_b"),
    ],
)
def test_a_goal_that_cannot_be_is_refused_before_anything_moves(name, to, words, switch_on):
    rig = switch_on()
    with pytest.raises(RigError, match=words):
        go(rig, name, to)
    assert not rig.stage.homed()


@pytest.mark.slow
def test_a_positioner_that_never_arrives_is_stopped_at_its_deadline_and_named(switch_on):
    rig = switch_on()
    go(rig, "tilt_a", 0.0)
    simulated(rig).axes["tilt_a"].endless = True
    begun_s = rig.clock.now_s()
    with pytest.raises(RigTimeout, match=r"tilt_a axis still reports motion long after.*check its drive"):
        go(rig, "tilt_a", 1.0)
    assert rig.clock.now_s() - begun_s < 5.0


@pytest.mark.slow
def test_an_alarm_is_told_in_words_and_leaves_an_objective_that_is_not_known(switch_on):
    rig = switch_on()
    go(rig, "nosepiece", "10x")
    axis = simulated(rig).axes["nosepiece"]

    def stall():
        if axis.moving and axis.units > 40 * 1066.0:
            axis.stall()
        return False

    with pytest.raises(RigError, match=r"nosepiece axis of the Zaber controller reports FS: it stalled.*home it"):
        go(rig, "nosepiece", "20x", stall)
    assert rig.setup.objective == "unknown"
    assert rig.calibration is None
    assert go(rig, "nosepiece", "20x").named == "20x"


def test_a_stop_ends_the_motion_of_a_positioner(switch_on):
    rig = switch_on()
    go(rig, "lamp", 0.0)
    axis = simulated(rig).axes["lamp"]
    with pytest.raises(MotionStopped, match=r"'lamp' was stopped at \d+\.\d %"):
        go(rig, "lamp", 100.0, lambda: axis.units > 2_000.0)
    assert not rig.stage.moving()
    assert 20.0 < rig.positioners["lamp"].position() < 60.0
    axis.move(0.0, 100.0)  # as if a motion went on in spite of its driver
    come_to_rest(rig)
    assert not axis.moving


@pytest.mark.slow
def test_the_simulated_camera_looks_through_the_objective_and_by_the_light_of_the_lamp(switch_on):
    rig = switch_on()
    go(rig, "lamp", 100.0)
    rig.stage.move_to(x_um=0.0, y_um=0.0, z_um=0.0)

    def seen():
        frames = CommandedFrames(rig, 50.0)
        frames.open()
        frame = frames.take()
        frames.close()
        return frame.image.astype(float)

    bright = seen()
    go(rig, "lamp", 25.0)
    assert seen().mean() == pytest.approx(bright.mean() / 4, rel=0.02)
    go(rig, "lamp", 100.0)
    go(rig, "nosepiece", "10x")
    go(rig, "zoom", "wide")
    rig.stage.move_to(z_um=0.0)
    assert np.abs(seen() - bright).mean() > 5.0  # unhomed, it looked through the first objective with another's pixels


@pytest.mark.parametrize(
    ("driver", "address", "units_per_unit"), [("grbl", "A", 1.0), ("grbl", "B", -1.0), ("pi_gcs2", "7", 0.5)]
)
def test_positioners_run_on_the_further_axes_of_every_driver(driver, address, units_per_unit, switch_on):
    data = example(RIG)
    data["devices"]["controllers"]["turner"] = {"driver": driver, "port": "simulated"}
    place = {"controller": "turner", "address": address, "units_per_unit": units_per_unit, "low": -1.5}
    data["devices"]["positioners"]["tilt_a"] |= place
    rig = switch_on(data)
    assert go(rig, "tilt_a", 1.25).position == pytest.approx(1.25, abs=0.002)
    assert go(rig, "tilt_a", -0.5).position == pytest.approx(-0.5, abs=0.002)
    rig.stage.stop()


def test_a_grbl_board_without_the_axis_says_so():
    from wafer_viewer.rigs.stages.grbl import DRIVER
    from wafer_viewer.rigs.stages.motion_controller import ControllerAxis
    from wafer_viewer.rigs.virtual.clock import VirtualClock
    from wafer_viewer.rigs.virtual.serial_port import VirtualPort

    class Board:
        def receive(self, data, time_s):
            return b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n" if b"?" in data else b"ok\r\n"

    clock = VirtualClock()
    with pytest.raises(RigError, match=r"no axis A for tilt_a: it reports 3 axes, X, Y, Z"):
        DRIVER.connect(VirtualPort(clock, Board()), clock, {"tilt_a": ControllerAxis("A", 1.0, 1.0)})


def test_the_doctor_names_each_positioner_with_its_range_and_names(tmp_path):
    checks = {check.what: check for check in check_devices(device_opener(read(example(RIG), tmp_path)), move=False)}
    nosepiece = "SIMULATED, Objective, not homed, range 0 to 180 deg, positions 10x, 20x"
    assert checks["Positioner 'nosepiece'"].found == nosepiece
    assert checks["Positioner 'lamp'"].mend == ""
