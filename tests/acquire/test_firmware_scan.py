"""Scans in which the firmware's core counts the virtual stage: as on the virtual box, and no frame in a wrong slot."""

from __future__ import annotations

import numpy as np
import pytest

from tests.acquire.ledger import Ledger
from tests.rigs.pulse_box.firmware_box import FirmwareBox
from tests.rigs.pulse_box.worlds import build, missing_tools
from tests.support.campaigns import drawn_after
from wafer_viewer.acquire.conformance.runner import CHECKS, run_checks
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.serial_port import Interference

STRATEGIES = ["z_snake", "x_lines", "stop_and_shoot"]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The firmware's core as a library."""
    if reason := missing_tools("library"):
        pytest.skip(f"The firmware cannot be built: {reason}.")
    folder = tmp_path_factory.mktemp("pulse_box")
    build(folder, "library")
    return folder / "libpulse_box.so"


@pytest.fixture
def with_firmware(library, monkeypatch):
    """A function that lets rigs switched on from now on have the firmware in their box."""

    def set_up():
        monkeypatch.setattr(
            "wafer_viewer.rigs.virtual.rig.VirtualPulseBox", lambda *parts: FirmwareBox(library, *parts)
        )

    return set_up


GAUGE_JOB = {"rows": 7, "cols": 9, "n_frames": 126}


@pytest.mark.parametrize(
    ("strategy", "job"),
    [
        *((strategy, {"n_frames": 60}) for strategy in STRATEGIES),
        pytest.param("z_snake", GAUGE_JOB, marks=[pytest.mark.slow, pytest.mark.campaign], id="7938 frames"),
    ],
)
def test_frames_are_bit_for_bit_those_of_the_virtual_box(
    strategy, job, virtual_rig, small_plan, recorder, control, with_firmware
):
    sinks = [recorder, type(recorder)()]
    for sink in sinks:
        rig = virtual_rig()
        run_scan(small_plan(rig, strategy, **job), rig, sink, control())
        with_firmware()
    assert "host" in rig.box.identity.name
    assert sinks[0].events == sinks[1].events
    for a, b in zip(sinks[0].frames, sinks[1].frames, strict=True):
        assert (a.shot, a.pulse_count, a.z_um, a.device_time_us) == (b.shot, b.pulse_count, b.z_um, b.device_time_us)
        np.testing.assert_array_equal(a.image, b.image)


@pytest.mark.parametrize("seed", drawn_after(2, range(12)))
def test_slips_restarts_and_disturbed_lines_at_random_put_no_frame_into_a_wrong_slot(
    seed, virtual_rig, small_plan, control, place, with_firmware
):
    rng, ledger = np.random.default_rng(seed), Ledger()
    with_firmware()
    rig = virtual_rig(
        faults=Faults(
            slips=(int(rng.integers(1, 110)),),
            slip_counts=int(rng.integers(4, 400)),
            slips_reported=bool(rng.integers(2)),
            reboots=(int(rng.integers(150, 240)),),
            ignored_triggers=tuple(map(int, rng.choice(np.arange(1, 240), 3, replace=False))),
            wire=Interference(lost_fraction=0.02, damaged_fraction=0.02, seed=seed),
        )
    )
    plan = small_plan(rig, STRATEGIES[seed % 2 * 2], n_frames=60)
    run_scan(plan, rig, ledger, control())
    faults = " ".join(ledger.faults)
    assert "restarted" in faults
    assert "slipped" in faults or "quadrature" in faults
    assert len(ledger.kept) == plan.n_frames
    for shot, frame in ledger.kept.items():
        assert place(frame.image)[0][2] == pytest.approx(frame.z_um, abs=0.12)
        assert frame.z_um == pytest.approx(plan.sweep.z_um(plan.field(shot.field), shot.k), abs=0.12)


def test_the_firmware_meets_the_demands_of_the_conformance_checks(virtual_rig, with_firmware):
    with_firmware()
    rig = virtual_rig()
    results = run_checks(rig, move=True, checks=[check for check in CHECKS if "camera" not in check.roles])
    assert {result.name: result.why for result in results if result.verdict != "passed"} == {}
    assert "host" in rig.identities()[1].identity
