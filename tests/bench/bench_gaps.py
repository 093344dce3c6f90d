"""How far peaks beside a gap of the stack are moved, by how many frames are missing and how far the frames are apart.

    python tests/bench/bench_gaps.py [--quick] [--scenes N] [--from SEED]

A plane in small stairs through all phases of the frames (`tests/truth/phase.py`), drawn by seed: NA 0.2 to 0.45,
contrast 8 to 25 %, 8 to 40 ke. One frame or two neighbouring ones in the middle are missing. Errors are the mean errors
of the stairs within the reach that is told; u is what the heights are told beside the gap, U = 2 u. Tuning sees seeds
below 1000. --quick: two scenes of each.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tests.bench.harness import percent, read_options, show
from tests.truth.phase import STAIR_PX, Stairs, Tilted, stairs
from tests.truth.unseen import FIRST_REPORTED_SEED
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.preprocess.frame_jitter import FrameGap, frame_gaps

SCENES, QUICK_SCENES = 6, 2
STEPS_DOF = (0.25, 0.35, 0.45, 0.6, 0.75)
MARGIN_PX = 12


def scene(step_dof: float, seed: int) -> Stairs:
    """The stairs of a seed."""
    rng = np.random.default_rng((seed, 41))
    na, contrast, full_well_e = rng.uniform(0.2, 0.45), rng.uniform(0.08, 0.25), rng.uniform(8e3, 4e4)
    return stairs(Tilted(float(na), step_dof, float(contrast), float(full_well_e), seed=seed))


def moved(seen: Stairs, missing: int) -> tuple[NDArray[np.float64], FrameGap]:
    """Mean errors of the stairs that a gap in the middle concerns, in um, and the gap."""
    present = np.ones(len(seen.stack.z_um), bool)
    first = len(present) // 2
    present[first : first + missing] = False
    stack = dataclasses.replace(seen.stack, present=present)
    (gap,) = frame_gaps(stack.z_um[present], stack.depth_of_field_um)
    off_um = (reconstruct(stack, threads=1).z_raw_um - seen.truth_um)[MARGIN_PX:-MARGIN_PX].astype(np.float64)
    columns = range(MARGIN_PX, off_um.shape[1] - MARGIN_PX, STAIR_PX)
    concerned = [off_um[:, c : c + STAIR_PX] for c in columns if gap.concerns(seen.truth_um[c : c + 1])[0]]
    return np.array([np.nanmedian(stair) for stair in concerned if np.isfinite(stair).any()]), gap


def main() -> None:
    asked = read_options(__doc__, scenes=SCENES, first_seed=FIRST_REPORTED_SEED)
    seeds = range(asked.first_seed, asked.first_seed + (QUICK_SCENES if asked.quick else asked.scenes))
    rows = []
    for step_dof in STEPS_DOF:
        seen = [scene(step_dof, seed) for seed in seeds]
        for missing in (1, 2):
            found = [(one.scene.step_um, *moved(one, missing)) for one in seen]
            steps = np.concatenate([error_um / step_um for step_um, error_um, _ in found])
            of_u = np.concatenate([error_um / gap.u_um for _, error_um, gap in found])
            u = float(np.mean([gap.u_um / step_um for step_um, _, gap in found]))
            errors = (float(np.sqrt(np.mean(steps**2))), float(np.abs(steps).max()))
            rows.append((f"{step_dof:g}, {missing} missing", *errors, u, percent(float(np.mean(np.abs(of_u) <= 2)))))
    header = ("step in depths of field", "rms error, steps", "largest", "told u", "U covers %")
    show(f"Heights beside a gap, SIMULATED, {len(seeds)} scenes each, seeds from {seeds.start}", header, rows)


if __name__ == "__main__":
    main()
