"""Scans with the machine code of the pulse box, emulated on the clock of the virtual rig."""

from __future__ import annotations

import numpy as np
import pytest

from tests.acquire.conftest import COLS, ROWS, PlaceRenderer
from tests.acquire.ledger import Ledger
from tests.bench.bench_plan import JOBS
from tests.rigs.pulse_box.worlds import build, missing_tools
from tests.support.campaigns import drawn_after
from tests.support.hybrid_rig import hybrid_rig, played_back_rig, without_ringing
from tests.support.placed_scene import PlacedScene, pictured, raw_heights_um
from tests.support.planted_faults import scan_with_faults, z_error_counts
from wafer_viewer.acquire.pass_runner import device_clock
from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.acquire.pulse_reconciliation import reference_axes
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import scene_renderer, virtual_limits
from wafer_viewer.rigs.virtual.scenes.catalogue import scene

(FIELDS, SWEEP), *_ = JOBS.values()
pytestmark = pytest.mark.slow
LATENCY_US = 30.0
"""Longest time from an edge of the scale to the trigger: interrupt, three axes and the pulse."""


@pytest.fixture(scope="module")
def firmware(tmp_path_factory):
    """A folder with the board's image and the program that emulates it in lock-step."""
    if reason := missing_tools("avr", "lockstep"):
        pytest.skip(f"The firmware cannot be built: {reason}.")
    folder = tmp_path_factory.mktemp("pulse_box")
    build(folder, "avr", "lockstep")
    return folder


@pytest.fixture
def switch_on(firmware):
    """A function that switches on a hybrid rig whose pictures say where they were taken."""
    return lambda: hybrid_rig(firmware, renderer=PlaceRenderer(), limits=virtual_limits(ROWS, COLS))


def plan_of(rig, rows=1, cols=2, n_frames=60):
    grid = FieldGrid(rows=rows, cols=cols, field_width_um=336.0, field_height_um=252.0)
    return plan_scan(grid.fields(5.0), FocusSweep(z_step_um=4.0, n_frames=n_frames), (100.0,), rig.limits, "z_snake")


def labels(sink):
    return [(f.shot, f.pulse_count, f.x_um, f.y_um, f.z_um, f.exposure_us, f.status) for f in sink.frames]


def test_frames_have_the_labels_and_within_the_latency_the_places_of_the_virtual_box(
    switch_on, virtual_rig, recorder, control, place
):
    rig, by_board = virtual_rig(), type(recorder)()
    run_scan(plan_of(rig), rig, recorder, control())
    with switch_on() as rig:
        plan = plan_of(rig)
        run_scan(plan, rig, by_board, control())
        assert "atmega2560" in rig.box.identity.name
    assert by_board.events == recorder.events
    assert labels(by_board) == labels(recorder)
    speed_um_s = plan.legs[0].speed_um_s
    for a, b in zip(recorder.frames, by_board.frames, strict=True):
        (_, _, z_um), (_, _, late_um) = place(a.image)[0], place(b.image)[0]
        direction = plan.legs[0].train.direction * (-1) ** (a.shot.field - 1)
        assert 0 < direction * (late_um - z_um) <= speed_um_s * LATENCY_US * 1e-6


@pytest.mark.campaign
def test_heights_are_bit_for_bit_those_of_the_virtual_box_that_fires_as_late(firmware, control):
    limits = virtual_limits(50, 64)
    settings = {"renderer": PlacedScene(scene_renderer("gauge_blocks", limits)), "limits": limits, "seed": 0}
    sinks = Ledger(), Ledger()

    def scanned(rig, sink):
        fields = [replace(field, z_start_um=scene("gauge_blocks").tour_z_start_um) for field in FIELDS[:2]]
        plan = plan_scan(fields, SWEEP, (100.0,), rig.limits, "z_snake")
        run_scan(plan, rig, sink, control())
        return fields

    with without_ringing():
        with hybrid_rig(firmware, **settings) as rig:
            fields = scanned(rig, sinks[0])
            places_um = rig._firmware.places_um
        with played_back_rig(places_um, **settings) as rig:
            scanned(rig, sinks[1])
    assert len(sinks[0].kept) == len(sinks[1].kept) == 2 * SWEEP.n_frames
    for shot, frame in sinks[0].kept.items():
        other = sinks[1].kept[shot]
        assert (frame.pulse_count, frame.z_um) == (other.pulse_count, other.z_um)
        np.testing.assert_array_equal(pictured(frame.image), pictured(other.image))
    a, b = (np.stack([raw_heights_um(sink.kept, field) for field in fields]) for sink in sinks)
    assert np.isfinite(a).mean() > 0.3
    np.testing.assert_array_equal(a, b)


@pytest.mark.campaign
def test_a_second_run_is_the_same_to_the_microsecond(switch_on, recorder, control):
    sinks = recorder, type(recorder)()
    for sink in sinks:
        with switch_on() as rig:
            run_scan(plan_of(rig, cols=1, n_frames=30), rig, sink, control())
    times = [[frame.device_time_us for frame in sink.frames] for sink in sinks]
    assert times[0] == times[1]
    for a, b in zip(sinks[0].frames, sinks[1].frames, strict=True):
        np.testing.assert_array_equal(a.image, b.image)


def test_moves_faster_than_the_board_counts_cost_it_no_time(switch_on):
    """A timer that waits behind the edges would miss turns of 32.8 ms."""
    with switch_on() as rig:
        reference_axes(rig)
        before = device_clock(rig, 100.0)
        for z_um in (1_000.0, 0.0):
            rig.stage.move_to(z_um=z_um)
        off = rig.box.count("z")
        after = device_clock(rig, 100.0, before)
    assert abs(off) > 2, "the board lost counts, as it may in such a move"
    assert after.offset_us - before.offset_us == pytest.approx(20e-6 * (after.at_us - before.at_us), abs=5.0)


@pytest.mark.campaign
def test_faults_at_random_are_found_and_put_no_frame_into_a_wrong_slot(switch_on, control, place):
    with switch_on() as rig:
        plan = plan_of(rig, rows=2, cols=4)
        done = scan_with_faults(rig, plan, control, place, n_faults=20, apart=(15, 45), seed=3)
    planted = {kind: n for kind, n, *_ in done.table()}
    assert sum(planted.values()) == 20
    assert {kind: found for kind, _, found, *_ in done.table()} == planted
    assert done.wrong_slots == done.off == 0
    assert len(done.ledger.kept) == plan.n_frames


@pytest.mark.parametrize("counts", drawn_after(1, [1, 2, 3, 4]))
def test_a_slip_of_few_counts_at_the_scale_is_found(counts, switch_on, control, place):
    ledger = Ledger()
    with switch_on() as rig:
        board = rig._firmware
        board.on_pulse = lambda number, time_s: board.slip(counts, reported=False) if number == 10 else None
        run_scan(plan_of(rig, cols=1, n_frames=30), rig, ledger, control())
        errors = [z_error_counts(rig, place, frame) for frame in ledger.kept.values()]
    assert f"slipped by -{counts} count" in ledger.faults[0]
    assert len(ledger.kept) == 30
    assert max(errors) < 0.5
