"""Brackets in alternating pulses: layout, price, and whole scans with triggers that are lost, ignored or too many."""

from __future__ import annotations

import pytest

from wafer_viewer.acquire.planner import plan_scan, price_all
from wafer_viewer.acquire.scan_runner import run_scan, trimmed
from wafer_viewer.model.acquisition.devices import ExposureSequencer
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, Shot
from wafer_viewer.model.errors import PlanError, RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.rig import virtual_limits

LIMITS = virtual_limits(540, 720)
FIELDS = FieldGrid(rows=2, cols=2, field_width_um=336.0, field_height_um=252.0).fields(5.0)
SWEEP = FocusSweep(z_step_um=1.2, n_frames=20)
TWO, THREE = (100.0, 3_000.0), (100.0, 400.0, 1_600.0)


def plan_of(exposures_us, limits=LIMITS, strategy="z_alternating", sweep=SWEEP):
    return plan_scan(FIELDS, sweep, exposures_us, limits, strategy)


def prices(exposures_us, limits=LIMITS, sweep=SWEEP):
    return {price.strategy: price for price in price_all(FIELDS, sweep, exposures_us, limits)}


@pytest.mark.parametrize("exposures_us", [TWO, THREE])
def test_every_exposure_has_the_z_step_of_the_plan_and_its_slots_the_same_z_upward_and_downward(exposures_us):
    plan, n = plan_of(exposures_us), len(exposures_us)
    assert [leg.train.direction for leg in plan.legs] == [1, -1, 1, -1]
    for leg in plan.legs:
        counts = [leg.train.first_count + leg.train.direction * leg.train.counts_per_frame * i for i in range(20 * n)]
        z_um = {shot: LIMITS.z.position_um(count) for shot, count in zip(leg.shots, counts, strict=True)}
        for shot, at_um in z_um.items():
            assert at_um == pytest.approx(5.0 + 1.2 * (shot.k + shot.exposure / n), abs=1e-9)
        assert all(a.exposure != b.exposure for a, b in zip(leg.shots, leg.shots[1:], strict=False))
        assert 1.2 / n / leg.speed_um_s >= LIMITS.camera.period_s(max(exposures_us))


def test_auto_takes_exposures_in_turn_only_where_that_is_faster():
    assert plan_of((60.0, 240.0), strategy="auto").strategy == "z_alternating"
    flashed = replace(LIMITS, strobe_us=20.0)
    unlike = plan_of((60.0, 50_000.0), flashed, strategy="auto")
    assert unlike.strategy == "z_snake", "in turn each pulse would wait for the period of the long exposure"
    assert "z_alternating" not in prices((60.0,))


def test_it_is_ruled_out_with_the_reason():
    fixed = replace(LIMITS, camera=replace(LIMITS.camera, exposure_sequence=False))
    assert "cannot change its exposure from frame to frame" in prices(TWO, fixed)["z_alternating"].ruled_out
    uneven = prices(THREE, sweep=FocusSweep(z_step_um=1.0, n_frames=20))["z_alternating"].ruled_out
    assert "100 counts of the z scale, no multiple of the 3 exposures: choose 0.99 um or 1.02 um" in uneven
    with pytest.raises(PlanError, match="is for 2 exposures or more: choose auto, or add an exposure"):
        plan_of((100.0,))


@pytest.mark.parametrize("first", [6, 7, 8])
def test_a_trimmed_leg_keeps_each_pulse_its_exposure(first):
    leg = plan_of(THREE).legs[0]
    part = trimmed(leg, lambda shot: shot in leg.shots[first:31], LIMITS)
    assert part.shots == leg.shots[first:31]
    assert part.train.first_count == leg.train.first_count + leg.train.counts_per_frame * first


def assert_right(plan, frames, place):
    """Each picture was exposed as its label says, at the z of the label, to within the errors of the scales."""
    n, last = len(plan.exposures_us), {frame.shot: frame for frame in frames}
    assert last.keys() == {shot for leg in plan.legs for shot in leg.shots}
    for frame in last.values():
        (_, _, z_um), exposure_us = place(frame.image)
        assert exposure_us == frame.exposure_us == plan.exposures_us[frame.shot.exposure]
        assert z_um == pytest.approx(frame.z_um, abs=0.05)
        assert frame.z_um == pytest.approx(5.0 + 1.2 * (frame.shot.k + frame.shot.exposure / n), abs=0.1)


FAULTS = {
    "none": Faults(),
    "ignored triggers": Faults(ignored_triggers=(1, 17, 50)),
    "ignored triggers, no counter": Faults(ignored_triggers=(1, 17, 50), trigger_counter=False),
    "extra edges": Faults(extra_edges=(9, 30), extra_edge_us=20_000.0),
    "lost and incomplete images": Faults(lost_images=(30,), incomplete=(31,), duplicated_images=(40,)),
    "lost counts": Faults(slips=(15,), slip_counts=250),
}


@pytest.mark.parametrize("exposures_us", [TWO, THREE])
@pytest.mark.parametrize("faults", FAULTS.values(), ids=FAULTS.keys())
def test_every_frame_is_labelled_right_whatever_is_lost(
    faults, exposures_us, virtual_rig, small_plan, recorder, control, place
):
    rig = virtual_rig(faults=faults)
    plan = plan_of(exposures_us, rig.limits)
    outcome = run_scan(plan, rig, recorder, control())
    assert outcome.missing == ()
    assert_right(plan, recorder.frames, place)


def test_frames_after_an_ignored_trigger_are_taken_again_because_their_exposure_differs(virtual_rig, recorder, control):
    rig = virtual_rig(faults=Faults(ignored_triggers=(11,)))
    outcome = run_scan(plan_of(TWO, rig.limits), rig, recorder, control())
    missed = recorder.of_kind("missed")
    assert missed[0][1:] == (Shot(1, 5, 0), 1100, "no image came for its pulse")
    assert {why for _, _, _, why in missed[1:]} == {
        "its image was exposed for 100 us instead of 3000 us",
        "its image was exposed for 3000 us instead of 100 us",
    }
    assert len(missed) == outcome.repaired == 30


def test_a_scan_takes_as_long_as_its_price(virtual_rig, recorder, control):
    rig = virtual_rig()
    plan = plan_of(TWO, rig.limits)
    assert run_scan(plan, rig, recorder, control()).duration_s == pytest.approx(plan.predicted_s, rel=0.03)


def test_a_camera_that_cannot_is_named(virtual_rig, recorder, control):
    class Fixed:
        """A camera with one exposure at a time."""

        def __init__(self, camera):
            self.start, self.stop, self.next_image = camera.start, camera.stop, camera.next_image
            self.trigger, self.triggers = camera.trigger, camera.triggers

    rig = virtual_rig()
    plan = plan_of(TWO, rig.limits)
    assert isinstance(rig.camera, ExposureSequencer)
    rig._camera = Fixed(rig.camera)
    with pytest.raises(RigError, match="cannot change its exposure from frame to frame: plan the scan again"):
        run_scan(plan, rig, recorder, control())
