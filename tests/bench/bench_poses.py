"""How long it takes to place very many fields, how well they are placed, and in how much memory.

    python tests/bench/bench_poses.py [--quick]

Fields lie on a full circle; their overlaps are simulated (10 % of them blank, 3 % wrong; 3 % of the seams wrong; a
turned camera that leans and bends every field). The full run goes up to 1 000 000 fields, a 300 mm wafer, each size in
a process of its own; --quick ends at 1000. Seconds are by the clock; the processors' own time stands beside them.
choice: seconds of the processor to choose among the offsets of a pattern that 1 % of the overlaps show, up to 100 000
fields, with the number of those overlaps and of those to be measured at a wrong offset.
"""

from __future__ import annotations

import numpy as np

from tests.bench.harness import Cell, alone, peak_mb, read_options, show, took
from tests.truth.overlaps import FIELD_UM, PIXEL_UM, Fields, repeating, seams_of, shifts_of, wafer
from wafer_viewer.reconstruct.pose_graph.candidate_choice import choose_candidates
from wafer_viewer.reconstruct.pose_graph.lateral_poses import solve_positions
from wafer_viewer.reconstruct.pose_graph.vertical_poses import solve_heights

SIZES = (1_000, 10_000, 100_000, 1_000_000)
HEADER = (
    "fields | overlaps | x, y s | rms px | far off | u px | z s | rms um | far off | u um | all s | of cores | "
    "peak MB | choice s | of | wrong"
)
REPEATING, PITCH_PX, MOST_CHOSEN = 0.01, 45.0, 100_000


def main() -> None:
    sizes = SIZES[:1] if read_options(__doc__).quick else SIZES
    show("Poses of very many fields", HEADER, [alone(measured, size) for size in sizes])


def measured(size: int) -> tuple[Cell, ...]:
    """A row of the table."""
    fields = wafer(size)
    shifts, true = shifts_of(fields, np.random.default_rng(size), wrong=0.03, blank=0.1, turn=1e-3)
    placed = took(lambda: solve_positions(fields.x_um, fields.y_um, shifts, PIXEL_UM))
    found = placed.result
    off_px = np.column_stack((found.x_um, found.y_um)) - true
    off_px = np.hypot(*(off_px - np.median(off_px, axis=0)).T) / PIXEL_UM

    seams, poses = seams_of(fields, np.random.default_rng(size), wrong=0.03, sag_um=(0.05, 0.0, 0.05), lean=(1e-3, 0.0))
    levelled = took(
        lambda: solve_heights(
            fields.x_um, fields.y_um, seams, z_error_um="auto", tilt_error="auto", field_size_um=FIELD_UM
        )
    )
    levels = levelled.result
    off_um = np.abs(levels.z_um - poses[:, 0])
    both = (placed.clock_s + levelled.clock_s, placed.processor_s + levelled.processor_s)
    in_the_plane = _rms(off_px[off_px < 1]), int(np.sum(off_px >= 1)), float(found.u_x_um.mean()) / PIXEL_UM
    along_z = _rms(off_um[off_um < 0.5]), int(np.sum(off_um >= 0.5)), float(levels.u_z_um.mean())
    row = (str(len(fields.x_um)), len(fields.pairs), placed.clock_s, *in_the_plane, levelled.clock_s, *along_z)
    return *row, *both, peak_mb(), *(chosen(fields) if size <= MOST_CHOSEN else (None,) * 3)


def chosen(fields: Fields) -> tuple[Cell, ...]:
    """Return the seconds of the choice among the offsets of patterns, overlaps that show one, those chosen wrong."""
    random = np.random.default_rng(len(fields.x_um))
    shifts, true = shifts_of(fields, random, wrong=0.03, blank=0.1, turn=1e-3)
    shifts = repeating(shifts, random, REPEATING, PITCH_PX)
    made = took(lambda: choose_candidates(fields.x_um, fields.y_um, shifts, PIXEL_UM))
    if (choice := made.result) is None:
        return (None,) * 3
    moved = true - np.column_stack((fields.x_um, fields.y_um))
    off = choice.expected_um - (moved[shifts.second] - moved[shifts.first])
    wrong = choice.to_measure & (np.abs(off).max(axis=1) > PIXEL_UM)
    return made.processor_s, int(np.sum(shifts.repeats)), int(np.sum(wrong))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main()
