"""Stitching of grids drawn by seed: random ground, repeating dies, lines, under uneven light and by poor stages.

    python tests/bench/bench_grids.py [--grids N] [--from SEED] [--each] [--quick] [--scenes [NAME ...]]

--scenes: grids of many fields by name, 3 seeds each, of 16 x 13 and 40 x 40 fields; all of them take some minutes.
Seeds below 1000 are for tuning; figures to be quoted start at 1000. Errors are in pixels, apart from the place and turn
of the whole, without the fields that do not belong; a field is far off beyond 2 px. A grid is silently wrong where a
field is far off and no note says that anything is undecided.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.bench.tables import Cell, show
from tests.truth.drawn_grids import PIXEL_UM, SCENES, MadeGrid, drawn, made, planted
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.reconstruct.stitching import stitch

FAR_PX = 2.0
HEADER = (
    "ground", "grids", "rms px: median", "mean", "worst tenth", "<= .03 px", "normalised", "believed", "wrong",
    "misfits", "false alarms", "silently wrong", "ms per overlap",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Outcome:
    """What stitching made of one grid: errors in pixels; overlaps by number; fields by number."""

    rms_px: float
    max_px: float
    normalised: tuple[float, ...]
    believed: int
    wrong: int
    overlaps: int
    found: int
    planted: int
    alarms: int
    fields: int
    silent: bool
    seconds: float
    notes: tuple[str, ...]


def main() -> None:
    parser = argparse.ArgumentParser(description="Stitching of grids drawn by seed.")
    parser.add_argument("--grids", type=int, default=200)
    parser.add_argument("--from", type=int, default=1000, dest="first")
    parser.add_argument("--each", action="store_true", help="a row for each grid")
    parser.add_argument("--quick", action="store_true", help="eight grids for tuning")
    parser.add_argument("--scenes", nargs="*", choices=(*SCENES, []), metavar="NAME", help="grids of many fields")
    asked = parser.parse_args()
    if asked.scenes is not None:
        judge_scenes(asked.scenes or list(SCENES), range(asked.first, asked.first + min(asked.grids, 3)), asked.each)
        return
    seeds = range(8) if asked.quick else range(asked.first, asked.first + asked.grids)
    found: dict[str, list[Outcome]] = defaultdict(list)
    judged(made(drawn(0)))  # compiles what is not compiled yet
    for seed in seeds:
        grid = drawn(seed)
        outcome = judged(made(grid))
        found[grid.kind].append(outcome)
        found["all"].append(outcome)
        if asked.each:
            print(seed, grid.kind, told(grid), one_row(outcome), *outcome.notes, sep=" | ", flush=True)
    show(f"Positions of drawn grids, seeds from {seeds[0]}", HEADER, [row(name, some) for name, some in found.items()])


def judge_scenes(names: list[str], seeds: range, each: bool) -> None:
    """Stitch grids of `SCENES`, with the largest error of each."""
    judged(made(drawn(0)))
    rows: list[tuple[Cell, ...]] = []
    for name in names:
        some = [judged(made(planted(name, seed))) for seed in seeds]
        if each:
            print(name, *map(one_row, some), sep="\n  ", flush=True)
        rows.append((*row(name, some), f"{max(o.max_px for o in some):.3f}"))
    show(f"Positions of grids of many fields, seeds from {seeds[0]}", (*HEADER, "max px"), rows)


def judged(grid: MadeGrid) -> Outcome:
    """Stitch a grid and compare with where its fields are."""
    began = time.process_time()
    poses = stitch(grid.heights).poses
    seconds = time.process_time() - began
    counted = np.array([n not in grid.misfits for n in range(len(grid.heights))]) & ~poses.left_out
    off_px = errors_px(poses, grid, counted)
    between = counted[poses.shifts.first] & counted[poses.shifts.second]
    believed = poses.shifts.believed & between
    measured = np.column_stack((poses.shifts.x_um, poses.shifts.y_um))
    moved = grid.true_um - grid.stage_um
    error = measured - (moved[poses.shifts.second] - moved[poses.shifts.first])
    u = np.column_stack((poses.shifts.u_x_um, poses.shifts.u_y_um))
    held = believed[:, None] & (u < 1.0 * PIXEL_UM)
    wrong = believed & (np.abs(np.where(held, error, 0)) > FAR_PX * PIXEL_UM).any(axis=1)
    left = set(np.flatnonzero(poses.left_out).tolist())
    return Outcome(
        rms_px=float(np.sqrt(np.mean(off_px**2))),
        max_px=float(np.abs(off_px).max()),
        normalised=tuple((error / u)[held & ~wrong[:, None]].tolist()),
        believed=int(believed.sum()),
        wrong=int(wrong.sum()),
        overlaps=int(between.sum()),
        found=len(left & set(grid.misfits)),
        planted=len(grid.misfits),
        alarms=len(left - set(grid.misfits)),
        fields=len(grid.heights),
        silent=bool((np.abs(off_px) > FAR_PX).any() and not poses.notes),
        seconds=seconds / max(1, len(poses.shifts.first)),
        notes=poses.notes,
    )


def errors_px(poses: Poses, grid: MadeGrid, counted: np.ndarray) -> np.ndarray:
    """Return errors (x, y) of the counted fields, [n, 2], apart from the place and turn of the whole; in pixels.

    Across one direction only where the ground is made of lines.
    """
    centre = np.array([(n - 1) / 2 for n in grid.heights[0].shape[::-1]]) * (PIXEL_UM, -PIXEL_UM)
    true = (grid.true_um + centre)[counted]
    off = np.column_stack((poses.x_um, poses.y_um))[counted] - true
    if grid.drawn.kind == "lines":
        angle = grid.drawn.angle
        across = np.array([-np.sin(angle), -np.cos(angle)])
        off = (off @ across)[:, None] * across
    arm = true - true.mean(axis=0)
    off = off - np.median(off, axis=0)
    basis = np.column_stack((arm.ravel(), np.column_stack((arm[:, 1], -arm[:, 0])).ravel()))
    near = np.repeat(np.abs(off).max(axis=1) < FAR_PX * PIXEL_UM, 2)
    if near.sum() > 4 and grid.drawn.kind != "lines":
        off = off - (basis @ np.linalg.lstsq(basis[near], off.ravel()[near], rcond=None)[0]).reshape(off.shape)
    return off / PIXEL_UM


def told(grid) -> str:
    return (
        f"{grid.rows}x{grid.cols} of {grid.shape[0]}x{grid.shape[1]} overlap {grid.overlap:.2f} pitch "
        f"{min(grid.pitch_px):.0f} stage {grid.stage_px:.1f}+{grid.backlash_px:.1f} ({grid.stage_of_pitch:.2f}) "
        f"light {grid.fall_off:.2f} noise {grid.noise:.1f} blank {grid.blank:.2f} {dict(grid.misfits)}"
    )


def one_row(o: Outcome) -> str:
    sure = float(np.sqrt(np.mean(np.square(o.normalised)))) if o.normalised else float("nan")
    return (
        f"rms {o.rms_px:.3f} max {o.max_px:.2f} norm {sure:.2f} believed {o.believed}/{o.overlaps} wrong {o.wrong} "
        f"misfits {o.found}/{o.planted} alarms {o.alarms} {'SILENT' if o.silent else ''}"
    )


def row(name: str, some: list[Outcome]) -> tuple[Cell, ...]:
    """A row of the table."""
    rms = np.sort([o.rms_px for o in some])
    sure = np.concatenate([o.normalised for o in some])
    worst = rms[-max(1, len(rms) // 10) :].mean()
    return (
        name,
        len(some),
        *(f"{v:.3f}" for v in (np.median(rms), rms.mean(), worst)),
        f"{np.mean(rms <= 0.03):.0%}",
        f"{np.sqrt(np.mean(sure**2)):.2f}" if len(sure) else "-",
        f"{sum(o.believed for o in some)} of {sum(o.overlaps for o in some)}",
        sum(o.wrong for o in some),
        f"{sum(o.found for o in some)} of {sum(o.planted for o in some)}",
        f"{sum(o.alarms for o in some)} of {sum(o.fields for o in some)}",
        sum(o.silent for o in some),
        f"{1e3 * np.mean([o.seconds for o in some]):.1f}",
    )


if __name__ == "__main__":
    main()
