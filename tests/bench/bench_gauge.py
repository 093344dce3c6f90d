"""The step between two gauge blocks, 399.88 um, from plan to height: how far it is from the truth, and what U says.

    python tests/bench/bench_gauge.py [--quick]

2 x 2 fields at full camera size across the step, 126 frames each, through the session as an operator has it; the goal
is 0.5 um. The truth is the same measurement on the heights that the virtual sample really has. --quick: one scan;
otherwise three, each of another rig.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np

from wafer_viewer.measure.step import step_height
from wafer_viewer.model.plan import FieldGrid, FocusSweep, Job
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import HeightMap, Mosaic
from wafer_viewer.rigs.config import RigConfig
from wafer_viewer.rigs.virtual.scene import scene
from wafer_viewer.session.session import Session

SCENE = scene("gauge_blocks")
GOAL_UM, PATIENCE_S = 0.5, 900.0
UPPER = Region.rectangle(-520, -380, -120, 380)
LOWER = Region.rectangle(120, -380, 520, 380)


def job_of(session: Session) -> Job:
    limits = session.wait_until(lambda s: s.rig.limits is not None, PATIENCE_S).rig.limits
    grid = FieldGrid(
        rows=2, cols=2, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um
    ).centred_on(0.0, 0.0)
    sweep = FocusSweep(z_step_um=SCENE.tour_z_step_um, n_frames=SCENE.tour_frames)
    return Job(product=SCENE.title, grid=grid, z_start_um=SCENE.tour_z_start_um, sweep=sweep)


def truth_of(mosaic: Mosaic) -> HeightMap:
    """The surface as it really is, on the mosaic's lattice."""
    seen = mosaic.window()
    x_um, y_um = np.meshgrid(seen.x_um, seen.y_um)
    z_um = SCENE.truth(x_um, y_um)
    origin = np.zeros(z_um.shape, np.uint8)
    return dataclasses.replace(seen, z_um=z_um, z_raw_um=z_um, origin=origin)


def measure(folder: Path, seed: int) -> None:
    session = Session(folder, RigConfig(scene="gauge_blocks", size="full", seed=seed))
    try:
        session.wait_until(lambda s: s.rig.state == "ready" and s.compute_ready, PATIENCE_S)
        session.edit_job(job_of(session)).result()
        began = time.perf_counter()
        session.start_scan(f"gauge-{seed}").result()
        session.wait_until(lambda s: not s.scanning, PATIENCE_S)
        scanned_s = time.perf_counter() - began
        done = session.wait_until(lambda s: s.surface_is_whole or bool(s.faults), PATIENCE_S)
        if done.surface is None:
            raise SystemExit(f"The scan failed: {done.faults}")
        surface_s = time.perf_counter() - began
        found = session.measure("step", (UPPER, LOWER))
        true_um = step_height(truth_of(session.mosaic()), UPPER, LOWER).height.value_um
    finally:
        session.close()
    height = found.height
    error_um = height.value_um - true_um
    expanded_um = height.expanded_um or 0.0
    print(
        f"rig {seed}: {height.value_um:.3f} ± {expanded_um:.3f} um (k = 2), truth {true_um:.3f} um, error "
        f"{error_um:+.3f} um (goal {GOAL_UM} um {'met' if abs(error_um) <= GOAL_UM else 'MISSED'}), "
        f"U {'covers it' if abs(error_um) <= expanded_um else 'DOES NOT COVER IT'} | scan {scanned_s:.0f} s, "
        f"surface {surface_s:.0f} s, {done.surface.measured_fraction:.1%} measured",
        flush=True,
    )
    for line in height.budget:
        print(f"    {line.u_um:.4f} um  {line.name}")


def main() -> None:
    parser = argparse.ArgumentParser(description="The step between two virtual gauge blocks against its truth.")
    parser.add_argument("--quick", action="store_true", help="one scan instead of three")
    for seed in range(1 if parser.parse_args().quick else 3):
        with tempfile.TemporaryDirectory() as folder:
            measure(Path(folder), seed)


if __name__ == "__main__":
    main()
