"""How long it takes to place very many fields, how well they are placed, and in how much memory.

    python tests/bench/bench_poses.py [--quick]

Fields lie on a full circle; their overlaps are simulated (10 % of them blank, 3 % wrong; 3 % of the seams wrong; a
turned camera that leans and bends every field). The full run goes up to 1 000 000 fields, a 300 mm wafer, each size in
a process of its own; --quick ends at 1000. Seconds are by the clock; the processors' own time stands beside them.
choice: seconds of the processor to choose among the offsets of a pattern that 1 % of the overlaps show, up to 100 000
fields, with the number of those overlaps and of those to be measured at a wrong offset.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.truth.overlaps import FIELD_UM, PIXEL_UM, Fields, repeating, seams_of, shifts_of, wafer
from wafer_viewer.reconstruct.pose_graph.candidate_choice import choose_candidates
from wafer_viewer.reconstruct.pose_graph.lateral_poses import solve_positions
from wafer_viewer.reconstruct.pose_graph.vertical_poses import solve_heights

SIZES = (1_000, 10_000, 100_000, 1_000_000)
HEADER = (
    f"{'fields':>9} {'overlaps':>9} | {'x, y s':>8} {'rms px':>7} {'far off':>8} {'u px':>6} | "
    f"{'z s':>8} {'rms um':>7} {'far off':>8} {'u um':>6} | {'all s':>8} {'of cores':>8} {'peak MB':>8} | "
    f"{'choice s':>8} {'of':>6} {'wrong':>6}"
)
REPEATING, PITCH_PX, MOST_CHOSEN = 0.01, 45.0, 100_000


def main() -> None:
    parser = argparse.ArgumentParser(description="How long it takes to place very many fields.")
    parser.add_argument("--quick", action="store_true", help="1000 fields")
    parser.add_argument("--size", type=int, help="one size only, in this process")
    wanted = parser.parse_args()
    if wanted.size:
        print(measured(wanted.size), flush=True)
        return
    print(HEADER, flush=True)
    for size in SIZES[:1] if wanted.quick else SIZES:
        subprocess.run([sys.executable, __file__, "--size", str(size)], check=True)


def measured(size: int) -> str:
    """A row of the table."""
    fields = wafer(size)
    shifts, true = shifts_of(fields, np.random.default_rng(size), wrong=0.03, blank=0.1, turn=1e-3)
    busy = time.process_time()
    begun = time.perf_counter()
    found = solve_positions(fields.x_um, fields.y_um, shifts, PIXEL_UM)
    xy_s, busy_s = time.perf_counter() - begun, time.process_time() - busy
    off_px = np.column_stack((found.x_um, found.y_um)) - true
    off_px = np.hypot(*(off_px - np.median(off_px, axis=0)).T) / PIXEL_UM

    seams, poses = seams_of(fields, np.random.default_rng(size), wrong=0.03, sag_um=(0.05, 0.0, 0.05), lean=(1e-3, 0.0))
    busy = time.process_time()
    begun = time.perf_counter()
    levels = solve_heights(
        fields.x_um, fields.y_um, seams, z_error_um="auto", tilt_error="auto", field_size_um=FIELD_UM
    )
    z_s, busy_s = time.perf_counter() - begun, busy_s + time.process_time() - busy
    off_um = np.abs(levels.z_um - poses[:, 0])
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return (
        f"{len(fields.x_um):9d} {len(fields.pairs):9d} | "
        f"{xy_s:8.2f} {_rms(off_px[off_px < 1]):7.3f} {np.sum(off_px >= 1):8d} {found.u_x_um.mean() / PIXEL_UM:6.3f} | "
        f"{z_s:8.2f} {_rms(off_um[off_um < 0.5]):7.3f} {np.sum(off_um >= 0.5):8d} {levels.u_z_um.mean():6.3f} | "
        f"{xy_s + z_s:8.2f} {busy_s:8.2f} {peak_mb:8.0f} | "
        f"{chosen(fields) if size <= MOST_CHOSEN else '':>8}"
    )


def chosen(fields: Fields) -> str:
    """Return the seconds of the choice among the offsets of patterns, overlaps that show one, those chosen wrong."""
    random = np.random.default_rng(len(fields.x_um))
    shifts, true = shifts_of(fields, random, wrong=0.03, blank=0.1, turn=1e-3)
    shifts = repeating(shifts, random, REPEATING, PITCH_PX)
    begun = time.process_time()
    choice = choose_candidates(fields.x_um, fields.y_um, shifts, PIXEL_UM)
    took_s = time.process_time() - begun
    if choice is None:
        return ""
    moved = true - np.column_stack((fields.x_um, fields.y_um))
    off = choice.expected_um - (moved[shifts.second] - moved[shifts.first])
    wrong = choice.to_measure & (np.abs(off).max(axis=1) > PIXEL_UM)
    return f"{took_s:8.2f} {np.sum(shifts.repeats):6d} {np.sum(wrong):6d}"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main()
