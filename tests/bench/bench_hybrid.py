"""The gauge-block job with the machine code of the pulse box: labels, heights and planted faults.

    python tests/bench/bench_hybrid.py [--quick] [--seed N]

The image for the ATmega2560 counts the virtual stage and triggers the virtual camera, in an emulator on the rig's own
clock. First the job, 9 x 7 fields of 126 frames, is scanned with it and with the virtual pulse box, with small pictures
of the middle of each field of the gauge blocks; labels, pictures and the heights of 8 fields are compared. So they are
with a virtual pulse box that fires as late as the machine code did, each pulse: then all has to be equal. Then it is
scanned with 200 faults planted at random through the machine code, with pictures that only say where they were taken.
--quick: 2 fields, and 20 faults in 12 fields of 60 frames. Everything is SIMULATED.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from functools import partial
from pathlib import Path

import numpy as np

from tests.acquire.conftest import Control, PlaceRenderer, place_of
from tests.acquire.ledger import Ledger
from tests.bench.bench_plan import JOBS
from tests.bench.harness import read_options, show
from tests.rigs.pulse_box.worlds import build, missing_tools
from tests.support.hybrid_rig import hybrid_rig, played_back_rig, without_ringing
from tests.support.placed_scene import PlacedScene, pictured, placed_at, raw_heights_um
from tests.support.planted_faults import scan_with_faults, z_error_counts
from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.acquisition.focus_stack import Frame
from wafer_viewer.model.acquisition.plan import FocusSweep, ScanPlan, Shot
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import VirtualRig, scene_renderer, virtual_limits
from wafer_viewer.rigs.virtual.scenes.catalogue import scene

LIMITS = virtual_limits(50, 64)
SCENE = "gauge_blocks"
(FIELDS, SWEEP), *_ = JOBS.values()
HEIGHT_FIELDS = 8
"""Fields whose heights are compared."""
Frames = dict[Shot, Frame]


def plan_of(rig: VirtualRig, n_fields: int, sweep: FocusSweep = SWEEP) -> ScanPlan:
    z_start_um = scene(SCENE).tour_z_start_um
    fields = tuple(replace(field, z_start_um=z_start_um) for field in FIELDS[:n_fields])
    return plan_scan(fields, sweep, (100.0,), rig.limits, "z_snake")


def take(switch_on: Callable[..., AbstractContextManager[VirtualRig]], n_fields: int) -> tuple[Frames, list[float]]:
    """Frames of the job on a rig, and the places of all pulses if its box is machine code."""
    settings = {"renderer": PlacedScene(scene_renderer(SCENE, LIMITS)), "limits": LIMITS, "seed": 0}
    begun, ledger = time.perf_counter(), Ledger()
    with switch_on(**settings) as rig:
        plan = plan_of(rig, n_fields)
        outcome = run_scan(plan, rig, ledger, Control())
        name, per_um = rig.box.identity.name, rig.limits.z.counts_per_um
        off_nm = [z_error_counts(rig, lambda image: [placed_at(image)], f) / per_um * 1e3 for f in ledger.kept.values()]
    print(
        f"{name}: {outcome.kept} of {plan.n_frames} frames in {outcome.duration_s:.1f} s of the rig, "
        f"{time.perf_counter() - begun:.0f} s here; true z {np.mean(off_nm):.2f} nm from the label, at most "
        f"{max(off_nm):.2f} nm; {len(ledger.faults)} faults reported",
        flush=True,
    )
    return ledger.kept, getattr(rig._firmware, "places_um", [])


def label(frame: Frame) -> tuple:
    return frame.shot, frame.pulse_count, frame.x_um, frame.y_um, frame.z_um, frame.exposure_us, frame.status


def compare(virtual: Frames, hybrid: Frames, n_fields: int) -> None:
    """Labels, pictures and heights of the two."""
    mislabelled = sum(shot not in hybrid or label(frame) != label(hybrid[shot]) for shot, frame in virtual.items())
    pairs = [(pictured(frame.image).astype(int), pictured(hybrid[shot].image)) for shot, frame in virtual.items()]
    same = sum(np.array_equal(a, b) for a, b in pairs)
    share = np.mean([(a != b).mean() for a, b in pairs])
    print(f"frames mislabelled: {mislabelled} of {len(virtual)} (goal 0)")
    print(
        f"pictures bit for bit equal: {same} of {len(pairs)}; {share:.3%} of the pixels differ, by at most "
        f"{max(np.abs(a - b).max() for a, b in pairs)} of 255"
    )
    off_nm, n_points = [], 0
    for field in FIELDS[: min(n_fields, HEIGHT_FIELDS)]:
        a, b = raw_heights_um(virtual, field), raw_heights_um(hybrid, field)
        both = np.isfinite(a) & np.isfinite(b)
        n_points += int((np.isfinite(a) | np.isfinite(b)).sum())
        off_nm.append(np.abs(a - b)[both] * 1e3)
    all_nm = np.concatenate(off_nm)
    print(
        f"heights of the first {len(off_nm)} fields: {len(all_nm)} of {n_points} points measured in both; equal: "
        f"{(all_nm == 0).mean():.1%}; within 10 nm (1 count of the scale): {(all_nm <= 10).mean():.2%}; difference, "
        f"RMS {np.sqrt((all_nm**2).mean()):.1f} nm, at most {all_nm.max():.0f} nm"
    )


def compare_as_late(folder: Path, n_fields: int) -> None:
    """Labels, pictures and heights with a virtual pulse box that fires where the machine code did."""
    print("the same light, by a virtual pulse box as late as the machine code, on a stage that does not ring:")
    with without_ringing():
        hybrid, places_um = take(partial(hybrid_rig, folder), n_fields)
        virtual, _ = take(partial(played_back_rig, places_um), n_fields)
    compare(virtual, hybrid, n_fields)


def plant(folder: Path, n_faults: int, n_fields: int, sweep: FocusSweep, apart: tuple[int, int], seed: int) -> None:
    begun = time.perf_counter()
    with hybrid_rig(folder, renderer=PlaceRenderer(), limits=virtual_limits(16, 24)) as rig:
        plan = plan_of(rig, n_fields, sweep)
        done = scan_with_faults(rig, plan, Control, place_of, n_faults, apart, seed)
    title = f"{n_faults} faults planted at random, {plan.n_frames} frames, {len(done.attempts)} passes"
    rows = done.table()
    total = ("all", *(sum(numbers) for numbers in list(zip(*rows, strict=True))[1:]))
    show(title, ("fault", "planted", "found", "mended in the pass", "pass again", "scan refused"), [*rows, total])
    print(
        f"frames in a wrong slot: {done.wrong_slots} of {len(done.ledger.kept)} (goal 0); true z half a count or more "
        f"from the label: {done.off}; slots empty: {plan.n_frames - len(done.ledger.kept)}; "
        f"{time.perf_counter() - begun:.0f} s"
    )


def main() -> None:
    asked = read_options(__doc__, seed=1)
    if reason := missing_tools("avr", "lockstep"):
        raise SystemExit(f"The firmware cannot be built: {reason}.")
    n_fields = 2 if asked.quick else len(FIELDS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build(folder, "avr", "lockstep")
        virtual, _ = take(lambda **settings: closing(VirtualRig(**settings)), n_fields)
        hybrid, _ = take(partial(hybrid_rig, folder), n_fields)
        compare(virtual, hybrid, n_fields)
        compare_as_late(folder, min(n_fields, HEIGHT_FIELDS))
        if asked.quick:
            plant(folder, 20, 12, FocusSweep(z_step_um=4.0, n_frames=60), (20, 60), asked.seed)
        else:
            plant(folder, 200, n_fields, SWEEP, (20, 80), asked.seed)


if __name__ == "__main__":
    main()
