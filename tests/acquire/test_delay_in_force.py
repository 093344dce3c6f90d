"""The delay from a pulse to the exposure that a scan goes by."""

from __future__ import annotations

import pytest

from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.rigs.virtual.faults import CalibrationErrors


def largest_error_um(frames, place):
    return max(abs(place(frame.image)[0][2] - frame.z_um) for frame in frames)


def test_frames_are_where_they_were_taken_with_the_delay_in_force(virtual_rig, small_plan, recorder, control, place):
    rig = virtual_rig(errors=CalibrationErrors(trigger_delay_us=5_000.0))
    plan = small_plan(rig, "z_snake")
    speed_um_s = plan.legs[0].speed_um_s
    run_scan(plan, rig, recorder, control())
    assert largest_error_um(recorder.frames, place) == pytest.approx(5_000e-6 * speed_um_s, abs=0.1)
    recorder.frames.clear()
    run_scan(plan, rig, recorder, control(), delay_us=5_012.0)
    assert largest_error_um(recorder.frames, place) < 0.1
