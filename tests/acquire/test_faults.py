"""Scans on a rig that slips, loses, invents and hangs: no frame stands in a wrong slot, and every fault is named."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.acquire.ledger import Ledger
from tests.support.campaigns import drawn_after
from wafer_viewer.acquire.motion import ARRIVED_WITHIN_UM, come_to_rest, move
from wafer_viewer.acquire.scan_runner import PASS_TRIES, run_scan
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import RigError, RigTimeout
from wafer_viewer.rigs.virtual.faults import Faults

FIELDS = {"rows": 2, "cols": 2, "n_frames": 60}
N = 240


@pytest.fixture
def scan(virtual_rig, small_plan, control, place):
    """A function that scans four fields of 60 frames with faults: what was kept, and how many frames are wrong."""

    def take(strategy="z_snake", **faults):
        rig, ledger = virtual_rig(faults=Faults(**faults)), Ledger()
        plan = small_plan(rig, strategy, **FIELDS)
        error = None
        try:
            run_scan(plan, rig, ledger, control())
        except RigError as fault:
            error = fault
        wrong = [f.shot for f in ledger.kept.values() if abs(place(f.image)[0][2] - f.z_um) > 0.12]
        slots = [
            f.shot
            for f in ledger.kept.values()
            if abs(f.z_um - plan.sweep.z_um(plan.field(f.shot.field), f.shot.k)) > 0.12
        ]
        return ledger, wrong + slots, error

    return take


EXPOSING_US = 16_800.0
"""So long after a pulse of a pass the camera is ready again, and the next pulse is not yet due."""
PAIRING = {
    "one extra edge while the camera is busy": {"extra_edges": (30,)},
    "one extra edge that exposes": {"extra_edges": (30,), "extra_edge_us": EXPOSING_US},
    "an extra edge after each 37th": {"extra_edges": tuple(range(37, 500, 37))},
    "an exposing edge after each 37th": {"extra_edges": tuple(range(37, 200, 37)), "extra_edge_us": EXPOSING_US},
    "an edge before the first pulse": {"extra_edges": (0, 60, 120), "extra_edge_us": 400_000.0},
    "a camera that numbers exposures, three triggers ignored": {
        "counts_exposures": True,
        "ignored_triggers": (20, 90, 150),
    },
    "the same and an extra edge": {
        "counts_exposures": True,
        "ignored_triggers": (20, 90),
        "extra_edges": (40,),
        "extra_edge_us": EXPOSING_US,
    },
    "a counter that wraps": {"counter_wraps_at": 16},
    "images twice": {"duplicated_images": tuple(range(3, 300, 7))},
    "lost images": {"lost_images": tuple(range(5, 240, 10)), "trigger_counter": False},
    "incomplete images": {"incomplete": tuple(range(5, 240, 17))},
    "an ignored trigger at either end": {"ignored_triggers": (1, 60, 61, 120)},
}


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["z_snake", "stop_and_shoot"])
@pytest.mark.parametrize("case", PAIRING)
def test_no_frame_stands_in_a_wrong_slot(case, strategy, scan):
    ledger, wrong, error = scan(strategy, **PAIRING[case])
    assert error is None
    assert wrong == []
    assert len(ledger.kept) == N


@pytest.mark.parametrize(
    ("case", "says"),
    [
        ("one extra edge while the camera is busy", "counted 1 edge that the pulse box did not send"),
        ("an extra edge after each 37th", "In 4 passes the camera counted edges"),
        ("a camera that numbers exposures, three triggers ignored", "did not count 1 pulse"),
    ],
)
def test_a_counter_that_disagrees_with_the_time_is_named(case, says, scan):
    ledger, wrong, _ = scan(**PAIRING[case])
    assert wrong == []
    assert any(says in fault for fault in ledger.faults), ledger.faults


SUSPECT = {
    "quadrature errors": (
        {"slips": (30,), "slip_counts": 14},
        r"7 quadrature errors on the z scale, and .* slipped by -14 counts \(-0\.14 um\)",
    ),
    "a slip that nobody reports": (
        {"slips": (30,), "slip_counts": 250, "slips_reported": False},
        r"slipped by -250 counts \(-2\.50 um\)",
    ),
    "a slip of one count that nobody reports": (
        {"slips": (30,), "slip_counts": 1, "slips_reported": False},
        r"slipped by -1 count \(-0\.01 um\)",
    ),
    "suppressed pulses": ({"suppressed_pulses": (25, 30, 40)}, "suppressed 3 pulses"),
    "exposures that the box did not see": (
        {"unseen_exposures": (25, 26)},
        "58 exposures for 60 pulses and 60 images",
    ),
}


@pytest.mark.parametrize("case", SUSPECT)
def test_a_pass_that_cannot_be_trusted_is_taken_again_and_named(case, scan):
    faults, says = SUSPECT[case]
    ledger, wrong, error = scan(**faults)
    assert error is None
    assert wrong == []
    assert len(ledger.kept) == N
    assert len(ledger.summaries) == 5, "four passes, one of them again"
    assert len(ledger.missed_why) == 60
    (reported,) = ledger.faults
    assert "None of the 60 frames of the pass that begins at field 1 is kept" in reported
    assert re.search("try 2 of [34]", reported)
    assert re.search(says, reported), reported


def test_a_slip_of_one_count_does_not_use_up_the_tries_of_a_pass(scan, virtual_rig, place):
    ledger, wrong, error = scan(suppressed_pulses=(25, 85), slips=(140, 205), slip_counts=1, slips_reported=False)
    assert (error, wrong, len(ledger.kept)) == (None, [], N)
    assert [re.search(r"try \d of \d", fault).group() for fault in ledger.faults] == [
        "try 2 of 3", "try 3 of 3", "try 4 of 4", "try 5 of 5",
    ]  # fmt: skip
    assert all(z_error_counts(virtual_rig(), place, frame) < 0.5 for frame in ledger.kept.values())


def test_single_counts_alone_do_not_end_a_scan_and_are_named(scan):
    ledger, wrong, error = scan(slips=tuple(range(10, 3_000, 60)), slip_counts=1, slips_reported=False)
    assert (error, wrong, len(ledger.kept)) == (None, [], N)
    assert any("slipped by -1 count" in fault for fault in ledger.faults)
    assert any("+1 counts" in fault or "-1 counts" in fault for fault in ledger.faults if "are kept" in fault)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_a_box_that_always_slips_ends_the_scan_with_a_sentence(direction, scan):
    first = 10 if direction == "up" else 90
    ledger, wrong, error = scan(slips=tuple(range(first, 3_000, 20)), slip_counts=250)
    assert wrong == []
    assert len(ledger.kept) == (0 if direction == "up" else 60)
    assert len(ledger.summaries) == PASS_TRIES + len(ledger.kept) // 60
    text = str(error)
    assert "in 3 tries" in text
    assert "quadrature errors on the z scale" in text
    assert "counts (" in text
    assert "Check the cable and the signal of the scale" in text


def test_a_slip_between_passes_is_mended_before_frames_are_taken_and_named(virtual_rig, small_plan, control, place):
    rig, ledger = virtual_rig(), Ledger()
    plan = small_plan(rig, **FIELDS)
    end = ledger.pass_ended

    def pass_ended(number, summary):
        end(number, summary)
        rig._firmware.slip(300, reported=False)

    ledger.pass_ended = pass_ended
    run_scan(plan, rig, ledger, control())
    assert len(ledger.kept) == N
    assert all(abs(place(f.image)[0][2] - f.z_um) < 0.12 for f in ledger.kept.values())
    assert "z axis slipped, by" in ledger.faults[0]
    assert "In 3 passes the pulse box's count of the z axis slipped between passes" in ledger.faults[-1]


def test_a_counter_that_starts_anywhere_is_set_by_the_stages_position(virtual_rig, small_plan, control, place):
    rig, ledger = virtual_rig(), Ledger()
    rig.stage.move_to(z_um=50.0)
    rig._firmware.reboot()
    run_scan(small_plan(rig, **FIELDS), rig, ledger, control())
    assert len(ledger.kept) == N
    assert all(abs(place(f.image)[0][2] - f.z_um) < 0.12 for f in ledger.kept.values())
    assert ledger.faults == [
        "The pulse box restarted (boot 2, before 1): check its power. Its counts are set again from the position of "
        "the stage."
    ]


@pytest.mark.parametrize("strategy", ["z_snake", "x_lines", "stop_and_shoot"])
def test_a_pass_in_which_the_box_restarts_is_taken_again(strategy, scan):
    ledger, wrong, error = scan(strategy, reboots=(0, 30, 100))
    assert error is None
    assert wrong == []
    assert len(ledger.kept) == N
    assert "the pulse box restarted in the pass. It is taken again (try 2 of 3)." in ledger.faults[1]


@pytest.mark.parametrize("counts", [1, 2])
def test_single_counts_between_passes_are_mended_and_named(counts, virtual_rig, small_plan, control, place):
    rig, ledger = virtual_rig(), Ledger()
    plan = small_plan(rig, **FIELDS)
    end = ledger.pass_ended

    def pass_ended(number, summary):
        end(number, summary)
        rig._firmware.slip(counts, reported=False)

    ledger.pass_ended = pass_ended
    run_scan(plan, rig, ledger, control())
    assert len(ledger.kept) == N
    assert all(z_error_counts(rig, place, frame) < 0.5 for frame in ledger.kept.values())
    assert "z axis slipped, by" in ledger.faults[0]


def z_error_counts(rig, place, frame):
    """Difference between the labelled and the true scale position of a frame, in counts of the scale."""
    label = Position(frame.x_um, frame.y_um, frame.z_um)
    return abs(place(frame.image)[0][2] - rig.stage.truth_of(label).z_um) * rig.limits.z.counts_per_um


@pytest.mark.parametrize(("noise", "lasting"), [(1, False), (1, True), (2, False)])
@pytest.mark.parametrize("seed", drawn_after(1, range(3)))
def test_a_stage_that_does_not_tell_single_counts_gives_few_false_alarms(
    noise, lasting, seed, virtual_rig, small_plan, control, monkeypatch
):
    """Vibration of one reading to the next, and errors that last from motion to motion, of so many counts."""
    rig, ledger, rng = virtual_rig(), Ledger(), np.random.default_rng(seed)
    plan = small_plan(rig, rows=4, cols=5, n_frames=20)
    position, motion = rig.stage.position, {}

    def read(position=position, rig=rig, lasting=lasting, motion=motion, rng=rng):
        here = position()
        key = rig.stage._motions if lasting else len(motion)
        off = motion.setdefault(key, int(rng.integers(-noise, noise + 1)))
        return replace(here, z_um=here.z_um + off / rig.limits.z.counts_per_um)

    monkeypatch.setattr(rig.stage, "position", read)
    run_scan(plan, rig, ledger, control())
    assert len(ledger.kept) == 400
    assert len(ledger.summaries) <= 20 + 8
    rig.close()


def test_a_box_that_restarts_in_every_pass_ends_the_scan(scan):
    ledger, wrong, error = scan(reboots=tuple(range(20, 1_000, 10)))
    assert wrong == []
    assert len(ledger.kept) == 0
    assert re.search("in 3 tries .* the pulse box restarted in the pass. Check the power of the pulse box", str(error))


def test_a_box_too_slow_for_moves_is_set_before_each_pass_and_limits_the_speed_of_passes(
    virtual_rig, small_plan, control, place, monkeypatch
):
    monkeypatch.setattr("wafer_viewer.rigs.virtual.pulse_box_firmware.COUNT_RATE_HZ", 4_000)
    rig, ledger = virtual_rig(), Ledger()
    plan = small_plan(rig, **FIELDS)
    assert {leg.speed_um_s for leg in plan.legs} == {40.0}
    move_to = rig.stage.move_to

    def lose_counts(**goal):
        move_to(**goal)
        if rig._firmware._settings["AX"]:
            rig._firmware.slip(500, reported=False)

    monkeypatch.setattr(rig.stage, "move_to", lose_counts)
    run_scan(plan, rig, ledger, control())
    assert len(ledger.kept) == N
    assert all(abs(place(f.image)[0][2] - f.z_um) < 0.12 for f in ledger.kept.values())
    assert ledger.faults == []


@pytest.mark.parametrize("strategy", ["z_snake", "stop_and_shoot"])
def test_a_stage_that_reports_motion_for_ever_is_given_up(strategy, virtual_rig, small_plan, control):
    rig, ledger = virtual_rig(faults=Faults(endless_motions=(1,))), Ledger()
    began_s = rig.clock.now_s()
    with pytest.raises(RigTimeout) as reported:
        run_scan(small_plan(rig, strategy, **FIELDS), rig, ledger, control())
    text = str(reported.value)
    assert "does not report the end of its motion" in text
    assert "the z axis stands at" in text
    assert "should be at" in text
    assert "pulse box disarmed" in text
    assert "home the stage" in text
    assert rig.clock.now_s() - began_s < 10.0
    assert not rig.stage.moving()
    assert ledger.kept == {}


def test_a_stage_that_is_late_is_waited_for_within_reason(scan):
    ledger, wrong, error = scan(late_motions=(0, 1, 2, 3), late_s=1.0)
    assert error is None
    assert wrong == []
    assert len(ledger.kept) == N


@pytest.mark.parametrize(("motion", "axis"), [(0, "z"), (1, "z"), (2, "x"), (3, "z")])
def test_a_stage_that_does_not_arrive_is_named_with_its_place_and_its_goal(motion, axis, scan):
    _, wrong, error = scan(late_motions=(motion,), late_s=60.0)
    assert isinstance(error, RigTimeout)
    assert wrong == []
    assert f"The {axis} axis did not arrive" in str(error)
    assert "it stands at" in str(error)
    assert "instead of" in str(error)


def test_an_early_standstill_report_is_waited_out(virtual_rig, monkeypatch):
    rig = virtual_rig()
    monkeypatch.setattr(rig.stage, "_arrive", lambda should_stop: None)
    move(rig, {"x": 5_000.0, "z": 40.0}, lambda: False)
    assert rig.stage.position().x_um == pytest.approx(5_000.0, abs=ARRIVED_WITHIN_UM)
    assert rig.stage.position().z_um == pytest.approx(40.0, abs=ARRIVED_WITHIN_UM)


@pytest.mark.parametrize(("device", "call"), [("camera", "next_image"), ("camera", "start"), ("stage", "start")])
def test_an_error_of_a_devices_driver_is_reported_as_that_devices(
    device, call, virtual_rig, small_plan, control, monkeypatch
):
    rig = virtual_rig()

    def broken(*_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(getattr(rig, device), call, broken)
    with pytest.raises(RigError, match=rf"The {device} failed \(Input/output error\): check its cable"):
        run_scan(small_plan(rig), rig, Ledger(), control())


def test_a_long_pause_does_not_shift_the_clocks_by_a_pulse(virtual_rig, small_plan, control, place):
    rig, ledger = virtual_rig(faults=Faults(trigger_counter=False)), Ledger()
    hand = control(pause_after=60)
    hand.wait_while_paused = lambda: (setattr(hand, "pause_after", None), rig.clock.sleep(1_500.0))
    run_scan(small_plan(rig, **FIELDS), rig, ledger, hand)
    assert len(ledger.kept) == N
    assert all(abs(place(f.image)[0][2] - f.z_um) < 0.12 for f in ledger.kept.values())


@pytest.mark.parametrize("seed", drawn_after(2, range(20)))
def test_random_extra_and_ignored_triggers_and_lost_images_mislabel_none(seed, scan):
    rng = np.random.default_rng(seed)
    extra, ignored, lost = (rng.choice(np.arange(1, 240), n, replace=False) for n in (6, 4, 3))
    ledger, wrong, error = scan(
        str(rng.choice(["z_snake", "stop_and_shoot"])),
        extra_edges=tuple(map(int, extra)),
        extra_edge_us=float(rng.uniform(50.0, 17_000.0)),
        ignored_triggers=tuple(map(int, ignored)),
        lost_images=tuple(map(int, lost)),
        counts_exposures=bool(rng.integers(2)),
        trigger_counter=bool(rng.integers(4)),
        counter_wraps_at=int(rng.choice([0, 16, 256])),
    )
    assert (error, wrong, len(ledger.kept)) == (None, [], N)
    assert {why for whys in ledger.missed_why.values() for why in whys}, "an ignored trigger leaves a hole"


def test_the_hole_of_an_ignored_trigger_is_its_own(scan):
    ledger, _, _ = scan(ignored_triggers=(10,))
    assert ledger.missed_why == {Shot(1, 9): ["no image came for its pulse"]}


def test_a_stop_that_the_stage_does_not_obey_is_no_wait_for_ever(virtual_rig, monkeypatch):
    rig = virtual_rig()
    monkeypatch.setattr(rig.stage, "moving", lambda: True)
    with pytest.raises(RigTimeout, match=r"still reports motion .* after the stop command.*emergency stop"):
        come_to_rest(rig)
    assert rig.clock.now_s() < 5.0
