"""Checks of devices: each alone, and the counts of the pulse box against the motion of the stage."""

from __future__ import annotations

import dataclasses

import pytest

from tests.support.paths import ROOT
from wafer_viewer.model.acquisition.rig_limits import AxisLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.composed.device_checks import check_devices, check_index_marks, check_stage
from wafer_viewer.rigs.rig_config import device_opener, read_config
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

RIGS = ROOT / "assets/rigs"


def checks_of(name, *, move):
    return list(check_devices(device_opener(read_config(RIGS / f"{name}.toml")), move=move))


@pytest.fixture
def rig():
    rig = VirtualRig(limits=virtual_limits(16, 24), renderer=object())
    yield rig
    rig.close()


def axes_of(rig) -> dict[str, AxisLimits]:
    return {"x": rig.limits.x, "y": rig.limits.y, "z": rig.limits.z}


def test_without_a_word_nothing_moves():
    opener = device_opener(read_config(RIGS / "zaber_simulated.toml"))
    checks = list(check_devices(opener, move=False))
    assert [check.what for check in checks] == [
        "Controller 'stage' at simulated",
        "Pulse box at simulated",
        "Camera 'virtual'",
        "Stage",
    ]
    assert not any(check.mend for check in checks)
    assert "firmware 7.35" in checks[0].found
    assert "not homed" in checks[-1].found
    at = opener.virtual.stage.position()
    assert (at.x_um, at.y_um, at.z_um) == (0.0, 0.0, 0.0)


def test_on_request_it_homes_and_compares_counts_with_motion():
    *_, stage, z, x, y = checks_of("zaber_simulated", move=True)
    assert "homed" in stage.found
    assert "moved by +500.00 um, the box counted +50000" in z.found
    assert "moved by -999.98 um, the box counted -19999" in x.found
    assert "moved by -999.98 um, the box counted -20000" in y.found
    assert not any(check.mend for check in (z, x, y))


def test_every_device_that_does_not_answer_is_named():
    checks = checks_of("grbl_pi", move=True)
    assert [check.what.split("'")[0].split(" at")[0] for check in checks] == [
        "Controller ",
        "Controller ",
        "Pulse box",
        "Camera ",
    ]
    assert all(check.mend for check in checks)
    assert "/dev/ttyUSB0 cannot be opened" in checks[0].found


class Counter:
    """A pulse box whose count follows by a factor, and is off by some counts."""

    def __init__(self, box, factor=1, off=0):
        self.box, self.factor, self.off = box, factor, off

    def count(self, axis):
        return self.factor * self.box.count(axis) + self.off


def test_counts_at_rest_are_compared(rig):
    rig.stage.move_to(x_um=100.0)
    _, _, x, _ = check_stage(rig.stage, rig.box, axes_of(rig), move=False)
    assert "2000, by the position of the stage 2000: as the stage" in x.found
    _, z, x, y = check_stage(rig.stage, Counter(rig.box, off=50), axes_of(rig), move=False)
    assert "50, by the position of the stage 0: a scan sets it" in y.found
    assert not any(check.mend for check in (z, x, y))


@pytest.mark.parametrize(
    ("counts_per_um", "mend"),
    [
        (20.0, ""),
        (20.2, r"counts_per_um of the x axis is 20.2 in the rig's file and 20.0000 by this motion: correct it"),
        (80.0, r"is 80 in the rig's file and 20.0000"),
    ],
)
def test_a_wrong_scale_is_found_by_motion(counts_per_um, mend, rig):
    axes = axes_of(rig) | {"x": replace(rig.limits.x, counts_per_um=counts_per_um)}
    checks = {check.what: check for check in check_stage(rig.stage, rig.box, axes, move=True)}
    assert mend in checks["Count of x"].mend
    assert (checks["Count of x"].mend == "") == (mend == "")
    assert checks["Count of y"].mend == checks["Count of z"].mend == ""


@pytest.mark.parametrize(
    ("factor", "mend"), [(-1, "swap the channels A and B"), (0, "connect the scale of the z axis")]
)
def test_a_wrongly_connected_scale_is_found_by_motion(factor, mend, rig):
    _, z, *_ = check_stage(rig.stage, Counter(rig.box, factor), axes_of(rig), move=True)
    assert mend in z.mend


def test_a_stage_that_fails_is_a_finding_and_an_interruption_stops_it(rig):
    class Broken:
        def __init__(self, fault):
            self.fault, self.stopped = fault, False

        def position(self):
            raise self.fault

        def stop(self):
            self.stopped = True

    (check,) = check_stage(Broken(RigError("The stage was lost.")), None, axes_of(rig), move=False)
    assert check.mend
    stage = Broken(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        list(check_stage(stage, None, axes_of(rig), move=False))
    assert stage.stopped


SAFE_UM = 5_000.0
MARKS_UM = {"z": -4_000.0, "y": -3_000.0}


@pytest.fixture
def marked():
    """A rig whose z and y scales have index marks, and its axes."""
    limits = virtual_limits(16, 24)
    known = {axis: replace(limits.axis(axis), index_um=um) for axis, um in MARKS_UM.items()}
    rig = VirtualRig(limits=replace(limits, **known), renderer=object())
    rig.stage.move_to(x_um=100.0, y_um=200.0, z_um=50.0)
    yield rig
    rig.close()


def marks_of(rig, *, move, box=None):
    return list(check_index_marks(rig.stage, box or rig.box, axes_of(rig), SAFE_UM, move=move))


def test_marks_are_named_at_rest_and_passed_on_request_only(marked):
    z, y = marks_of(marked, move=False)
    assert z.what == "Index mark of z"
    assert "at -3000.00 um by the rig's file; the pulse box has an input for it" in y.found
    assert marked.box.latched("y") is None
    z, y = marks_of(marked, move=True)
    assert "met at -4000.00 um by the position of the stage, -4000.00 um by the rig's file" in z.found
    assert z.mend == y.mend == ""
    at = marked.stage.position()
    assert (at.x_um, at.y_um, at.z_um) == pytest.approx((100.0, 200.0, 50.0), abs=0.1), "back at the start"


def test_a_mark_elsewhere_or_nowhere_is_told_with_its_mend(marked):
    marked.stage.axes["y"].index_um += 3.5
    marked.stage.axes["z"].index_um = None
    z, y = marks_of(marked, move=True)
    assert z.found == "not met between -4200.00 and -3800.00 um"
    assert "check its cable" in z.mend
    assert "set index_um of the y axis to -2996.50" in y.mend


def test_a_box_without_inputs_for_marks_is_told_before_anything_moves(marked):
    class Old:
        def hello(self):
            return dataclasses.replace(marked.box.hello(), name="old", has_index=False)

    checks = marks_of(marked, move=True, box=Old())
    assert [check.what for check in checks] == ["Index mark of z", "Index mark of y"]
    assert "(old) has no inputs for index marks" in checks[0].found
    assert "update its firmware" in checks[0].mend
    assert marked.stage.position().y_um == pytest.approx(200.0)


def test_a_rig_without_marks_has_no_such_check(rig):
    assert marks_of(rig, move=True) == []
