"""What single overlaps tell: how long it takes, how far they are off, and whether their uncertainties are right.

    python tests/bench/bench_overlaps.py [--quick] [--from SEED] [--grids N]

The full run compares all overlaps of the grid of 16 x 13 fields of full size, and of smaller grids where nothing shakes
or fields are larger, pictures are blank, wrong, weak or differently lit, and fields are turned, mirrored or of another
wafer; --quick takes grids of small fields. --from, --grids: seeds of the grids, whose overlaps count together; seeds
below 1000 are for tuning. How far parts of overlaps are displaced counts as in stitching: pooled over those of a grid.
Milliseconds are those of one core's work, the best of three runs; |e|/u is the root mean square of errors over their
standard uncertainties, of believed overlaps whose content is not wrong; > 3 u: the fraction of them above three.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tests.bench.harness import read_options, took
from tests.truth.field_grid import PIXEL_UM, SMALL, Grid, Made, make
from wafer_viewer.model.surface.field_poses import HeightOffsets, RejectionReason, Shifts
from wafer_viewer.reconstruct.registration.height_seams import compare
from wafer_viewer.reconstruct.registration.misplaced_fields import misplaced_fields
from wafer_viewer.reconstruct.registration.pair_registration import register, with_pooled_drift

MIDDLING = replace(Grid(), rows=4, cols=4)
CASES: dict[str, dict[str, Any]] = {
    "nothing shakes": {"shiver_px": 0.0},
    "fields twice as large": {"rows": 3, "cols": 3, "field_rows": 540, "field_cols": 720},
    "15 % blank, 6 % wrong": {"blank_fraction": 0.15, "wrong_fraction": 0.06},
    "little texture, noise": {"textured_fraction": 0.2, "grey_noise": 4.0},
    "light differs by 30 %": {"brightness": 0.3},
    "turned, mirrored, foreign": {"turned": (5,), "mirrored": (10,), "foreign": (3,)},
}
HEADER = (
    f"{'':<28} {'overlaps':>8} | {'ms':>5} {'rms px':>7} {'max px':>7} {'|e|/u':>6} {'> 3 u':>6} | "
    f"{'ms':>5} {'rms um':>7} {'|e|/u':>6} | doubts; left out"
)


def main() -> None:
    asked = read_options(__doc__, first_seed=1, grids=1)
    seeds = range(asked.first_seed, asked.first_seed + asked.grids)
    print(HEADER, flush=True)
    whole, part = (SMALL, SMALL) if asked.quick else (Grid(), MIDDLING)
    print(row("the whole grid", whole, seeds), flush=True)
    for name, changes in CASES.items():
        print(row(name, replace(part, **changes), seeds), flush=True)


def row(name: str, grid: Grid, seeds: range) -> str:
    """A row of the table."""
    found = [judged(replace(grid, seed=seed)) for seed in seeds]
    n = sum(one.overlaps for one in found)
    off_px, sure = np.concatenate([one.off_px for one in found], axis=1)
    off_um, chi = np.concatenate([one.off_um for one in found]), rms(np.array([one.chi for one in found]))
    shift_ms, seam_ms = (sum(s) / n for s in zip(*(one.spent_ms for one in found), strict=True))
    doubts = Counter(d for one in found for d in one.doubts)
    far_fraction = np.mean(np.abs(sure) > 3)
    told = ", ".join(f"{n} {RejectionReason(d).name.lower()}" for d, n in sorted(doubts.items()))
    return (
        f"{name:<28} {n:>8} | {shift_ms:>5.1f} {rms(off_px):>7.3f} {np.abs(off_px).max():>7.3f} "
        f"{rms(sure):>6.2f} {far_fraction:>6.1%} | {seam_ms:>5.1f} {rms(off_um):>7.4f} {chi:>6.2f} | {told}; "
        f"{[one.left_out for one in found] if len(found) > 1 else found[0].left_out}"
    )


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the overlaps of one grid told: errors in pixels and over their uncertainties, [2, n]; those of heights."""

    overlaps: int
    off_px: np.ndarray
    off_um: np.ndarray
    chi: float
    spent_ms: tuple[float, float]
    doubts: list[int]
    left_out: list[int]


def judged(grid: Grid) -> Outcome:
    """Compare all overlaps of a grid."""
    made = make(grid)
    pairs = made.known.grid.edges
    register(made.heights, pairs[:2], threads=1)
    registered = took(lambda: register(made.heights, pairs, threads=1), 3)
    compared = took(lambda: compare(made.heights, pairs, made.known.x_um, made.known.y_um, threads=1), 3)
    shifts, spent_ms = registered.result, (1e3 * registered.processor_s, 1e3 * compared.processor_s)
    off_um, chi = seam_errors(made, compared.result)
    left_out = misplaced_fields(len(made.heights), shifts).tolist()
    errors = shift_errors(made, with_pooled_drift(shifts))
    if grid.seed > 1:
        made.remove()
    return Outcome(len(pairs), np.stack(errors), off_um, chi, spent_ms, shifts.doubt.tolist(), left_out)


def shift_errors(made: Made, shifts: Shifts) -> tuple[np.ndarray, np.ndarray]:
    """Errors of believed overlaps in pixels, x and y, and over their uncertainties."""
    known, true = made.known, shifts.believed & ~made.known.wrong
    off = []
    for stage, at, told, u in (
        (made.stage_x_um, known.x_um, shifts.x_um, shifts.u_x_um),
        (made.stage_y_um, known.y_um, shifts.y_um, shifts.u_y_um),
    ):
        moved = at - stage
        error = told - (moved[shifts.second] - moved[shifts.first])
        off.append(np.stack([error[true] / PIXEL_UM, error[true] / u[true]]))
    return tuple(np.concatenate(off, axis=1))


def seam_errors(made: Made, seams: HeightOffsets) -> tuple[np.ndarray, float]:
    """Errors of z in um, and those of z and slopes over their uncertainties, at the true positions."""
    known = made.known
    odd = np.isin(np.arange(len(made.heights)), (*known.grid.turned, *known.grid.mirrored, *known.grid.foreign))
    there = (seams.n_pixels > 0) & ~known.wrong & ~odd[seams.first] & ~odd[seams.second]
    a, b, x, y = seams.first, seams.second, seams.mid_x_um, seams.mid_y_um
    first, second = (
        known.z_um[n] + known.tilt_x[n] * (x - known.x_um[n]) + known.tilt_y[n] * (y - known.y_um[n]) for n in (a, b)
    )
    slopes = known.tilt_x[b] - known.tilt_x[a], known.tilt_y[b] - known.tilt_y[a]
    off = np.stack([seams.z_um - second + first, seams.slope_x - slopes[0], seams.slope_y - slopes[1]], axis=1)[there]
    chi = np.einsum("ni,nij,nj->n", off, seams.information[there], off) / 3
    return off[:, 0], float(np.sqrt(chi.mean()))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


if __name__ == "__main__":
    main()
