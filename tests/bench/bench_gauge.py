"""The step between two gauge blocks, 399.88 um, from plan to height: how far it is from the truth, and what U says.

    python tests/bench/bench_gauge.py [--quick] [--kept FILE]

2 x 2 fields at full camera size across the step, 126 frames each, through the session as an operator has it; the joint
lies inside a field, since a seam on it would tell nothing of the two heights. The truth is the same measurement on the
heights that the virtual sample really has. Everything is SIMULATED, and U has no certificate's term. Twenty scans, each
of another rig: each is added to the file --kept, and a run that was stopped goes on from there. --quick: one scan, with
a camera of half as many rows and columns.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.harness import HOME, keep_run, read_options, read_runs
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.job import Job
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.rigs.virtual.rig import Size
from wafer_viewer.rigs.virtual.scenes.catalogue import scene
from wafer_viewer.session.session import Session

SCENE = scene("gauge_blocks")
RIGS = 20
GOAL_UM, COVERED, PAPER_UM = 0.05, 18, 0.16
"""The mean error allowed, how many of the rigs U has to cover the truth in, and the error that the paper reports."""
PATIENCE_S = 900.0
KEPT = HOME / "gauge.jsonl"


@dataclasses.dataclass(frozen=True, slots=True)
class Place:
    """Where a camera of some size looks, and its regions on both faces, clear of the shadow of the step."""

    size: Size
    middle_um: tuple[float, float]
    upper: Region
    lower: Region


FULL = Place("full", (150.0, 0.0), Region.rectangle(-470, -380, -120, 380), Region.rectangle(120, -380, 520, 380))
SMALL = Place("small", (75.0, 0.0), Region.rectangle(-235, -190, -120, 190), Region.rectangle(120, -190, 260, 190))


def job_of(session: Session, place: Place) -> Job:
    limits = session.wait_until(lambda s: s.rig.limits is not None, PATIENCE_S).rig.limits
    grid = FieldGrid(
        rows=2, cols=2, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um
    ).centred_on(*place.middle_um)
    sweep = FocusSweep(z_step_um=SCENE.tour_z_step_um, n_frames=SCENE.tour_frames)
    return Job(product=SCENE.title, grid=grid, z_start_um=SCENE.tour_z_start_um, sweep=sweep)


def truth_of(mosaic: Mosaic) -> HeightMap:
    """The surface as it really is, on the mosaic's lattice."""
    seen = mosaic.window()
    x_um, y_um = np.meshgrid(seen.x_um, seen.y_um)
    z_um = SCENE.truth(x_um, y_um)
    origin = np.zeros(z_um.shape, np.uint8)
    return dataclasses.replace(seen, z_um=z_um, z_raw_um=z_um, origin=origin)


def measure(folder: Path, seed: int, place: Place) -> dict[str, Any]:
    """Scan with one rig: its height, U, truth, budget and times."""
    session = Session(folder, RigConfig(scene="gauge_blocks", size=place.size, seed=seed))
    try:
        session.wait_until(lambda s: s.rig.state == "ready" and s.compute_ready, PATIENCE_S)
        session.edit_job(job_of(session, place)).result()
        began = time.perf_counter()
        session.start_scan(f"gauge-{seed}").result()
        session.wait_until(lambda s: not s.scanning, PATIENCE_S)
        scanned_s = time.perf_counter() - began
        done = session.wait_until(lambda s: s.surface_is_whole or bool(s.faults), PATIENCE_S)
        if done.surface is None:
            raise SystemExit(f"The scan failed: {done.faults}")
        surface_s = time.perf_counter() - began
        found = session.measure("step", (place.upper, place.lower))
        true_um = step_height(truth_of(session.mosaic()), place.upper, place.lower).height.value_um
    finally:
        session.close()
    return {
        "rig": seed,
        "height_um": found.height.value_um,
        "expanded_um": found.height.expanded_um or 0.0,
        "true_um": true_um,
        "budget": {line.name: line.u_um for line in found.height.budget},
        "not_evaluated": found.not_evaluated,
        "scan_s": scanned_s,
        "surface_s": surface_s,
        "measured": done.surface.measured_fraction,
    }


def tell(run: dict[str, Any]) -> None:
    error_um = run["height_um"] - run["true_um"]
    print(
        f"rig {run['rig']}: {run['height_um']:.3f} ± {run['expanded_um']:.3f} um (k = 2), truth {run['true_um']:.3f} "
        f"um, error {error_um:+.3f} um, U {'covers it' if abs(error_um) <= run['expanded_um'] else 'DOES NOT COVER IT'}"
        f" | scan {run['scan_s']:.0f} s, surface {run['surface_s']:.0f} s, {run['measured']:.1%} measured",
        flush=True,
    )


def conclude(runs: list[dict[str, Any]]) -> None:
    """The mean over the rigs against the goals, and the last budget."""
    errors_um = np.array([run["height_um"] - run["true_um"] for run in runs])
    covered = sum(abs(e) <= run["expanded_um"] for e, run in zip(errors_um, runs, strict=True))
    mean_um = float(errors_um.mean())
    print(
        f"{len(runs)} rigs, SIMULATED: mean error {mean_um:+.4f} um (goal {GOAL_UM}: "
        f"{'met' if abs(mean_um) <= GOAL_UM else 'MISSED'}; the paper: {PAPER_UM}), largest "
        f"{np.abs(errors_um).max():.3f} um, U covers {covered} of {len(runs)} (goal {COVERED} of {RIGS})"
    )
    for name, u_um in runs[-1]["budget"].items():
        print(f"    {u_um:.4f} um  {name}")
    print(f"    not evaluated: {', '.join(runs[-1]['not_evaluated'])}")


def main() -> None:
    asked = read_options(__doc__, kept=KEPT)
    runs = [] if asked.quick else read_runs(asked.kept)
    for run in runs:
        tell(run)
    for seed in range(len(runs), 1 if asked.quick else RIGS):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(measure(Path(folder), seed, SMALL if asked.quick else FULL))
        tell(runs[-1])
        keep_run(None if asked.quick else asked.kept, runs[-1])
    conclude(runs)


if __name__ == "__main__":
    main()
