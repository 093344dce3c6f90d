"""How right stitching is and what it costs, on simulated grids whose truth is known, beside the paper and others.

    python tests/bench/bench_stitch.py [--quick] [--only SECTION ...]

The grid is 16 x 13 fields of 1080 x 1440 px, 12 % overlap; the stage errs by 6 px rms in the plane, 1 um along z, 1e-4
in tilt. --quick: 4 x 3 fields of half as many rows and columns. Otherwise some half an hour with all peers and 15 GB of
the temp folder; simulated fields and what the peers found stay there, so that a run that was stopped goes on from
there.
Other people's stitchers run in an environment of their own (see tests/bench/stitch_peers.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.bench import stitch_peers
from tests.bench.harness import Cell, met, read_options, run_sections, show, some_of, took
from tests.bench.stitch_costs import STORE, Cost, Meter, costs_of, found_poses, with_levels
from tests.bench.stitch_judge import (
    Blend,
    Positions,
    at_stage,
    at_truth,
    mosaic_of,
    position_error,
    rms,
    rmse_um,
    seam_steps_um,
    without_z,
)
from tests.truth.field_grid import Grid, Made, make
from wafer_viewer.model.surface.field_poses import Poses, RejectionReason
from wafer_viewer.model.surface.height_map import HeightMap

POSITION_GOAL_PX, WORST_GOAL_PX, SPOILT_GOAL_PX = 0.10, 0.5, 0.2
RMSE_GOAL, STEP_GOAL_UM, WIDE_STEP_GOAL_UM = 1.05, 0.01, 0.06
STITCH_GOAL_S, MEMORY_GOAL_MB, GROWTH_GOAL, SPLICE_GOAL_S, PAPER_SPLICE_S = 15.0, 1500.0, 1.2, 1.5, 17.5
PAPER_JOB = Grid(rows=9, cols=7, overlap_x=0.424, overlap_y=0.332)
"""3000 x 3200 um, 44 Mpx."""
PART = Grid(rows=8, cols=6)
SMALL = {"field_rows": 540, "field_cols": 720}
ERRORS = ("rms px", "max px", "turn and stretch apart")
HARDER = {
    "as a rule": {},
    "10 % of overlaps blank, 3 % wrong": {"blank_fraction": 0.1, "wrong_fraction": 0.03},
    "the same, 8 x 6 fields": {"seed": 2},
    "texture on 30 % of a die, noisy pictures": {"textured_fraction": 0.3, "grey_noise": 5.0},
    "no texture at all": {"textured_fraction": 0.0},
    "light changes by 20 %": {"brightness": 0.2},
    "camera turned by 2 mrad, scale off by 0.1 %": {"camera_turn": 2e-3, "camera_scale": 1e-3},
    "fields sag by 0.5 um, wafer by 20 um": {"field_sag_um": 0.5, "bow_um": 20.0},
}


def main() -> None:
    run_sections(SECTIONS, read_options(__doc__, only=some_of(SECTIONS)))


def whole(quick: bool) -> Grid:
    """The grid that figures are for."""
    return Grid(rows=4, cols=3, **SMALL) if quick else Grid()


def positions(quick: bool) -> None:
    """Where fields are found, on good overlaps and on worse."""
    rows: list[tuple[Cell, ...]] = []
    for title, options in list(HARDER.items())[: 2 if quick else None]:
        grid = replace(whole(quick), **options) if goals_px(options)[0] else replace(PART, **options)
        made = make(grid)
        poses = found_poses(made)
        off = position_error(poses.x_um, poses.y_um, made, ~poses.left_out)
        limit, worst = goals_px(options)
        told = limit and f"{limit:g} {met(off.rms_px, limit)}", worst and met(off.max_px, worst)
        rows.append((title, *told_px(off), *told))
        rows[-1] += (int(np.sum(poses.shifts.doubt != RejectionReason.NONE)), int(poses.left_out.sum()))
        if options:
            made.remove()
    at = make(whole(quick))
    rows.append(("where the stage has them", *told_px(position_error(at.stage_x_um, at.stage_y_um, at))))
    header = ("overlaps", "rms", "max", "rms, turn and stretch apart", "goal rms", f"max {WORST_GOAL_PX}")
    title = f"Error of {at.known.grid.rows} x {at.known.grid.cols} positions, px; without a goal: of 8 x 6"
    show(title, (*header, "doubted", "left out"), [row + (None,) * (8 - len(row)) for row in rows])


def told_px(off: Positions) -> tuple[Cell, ...]:
    return tuple(f"{value:.3f}" for value in (off.rms_px, off.max_px, off.without_turn_px))


def goals_px(options: dict[str, float]) -> tuple[float | None, float | None]:
    """The figures that were promised: rms and largest."""
    if not options:
        return POSITION_GOAL_PX, WORST_GOAL_PX
    return (SPOILT_GOAL_PX if "wrong_fraction" in options else None), None


def heights(quick: bool) -> None:
    """The surface against the truth, and its seams, with each part of the method taken away in turn."""
    made = make(whole(quick))
    poses = found_poses(made)
    ways: dict[str, tuple[Poses, Blend]] = {
        "paper: ramps at the stage's positions": (at_stage(poses), "ramp"),
        "registered poses, blend by confidence": (poses, "confidence"),
        "true poses, blend by confidence (bound)": (at_truth(poses, made), "confidence"),
        "ramps instead of confidence": (poses, "ramp"),
        "z not solved for": (without_z(poses), "confidence"),
        "z solved for at the stage's positions": (with_levels(made, at_stage(poses)), "confidence"),
    }
    windows = 16 if quick else 64
    found = {name: (rmse_um(made, at, blend, windows), seam_steps_um(made, at)) for name, (at, blend) in ways.items()}
    rows = [(name, f"{rmse:.3f}", *steps_told(steps)) for name, (rmse, steps) in found.items()]
    show("Heights against the truth, um", ("way", "RMSE", "seam step: median", "95 %", "max"), rows)
    ours, bound = (found[name] for name in list(ways)[1:3])
    ratio, (median, wide) = ours[0] / bound[0], np.quantile(ours[1], (0.5, 0.95)).tolist()
    print(f"  RMSE {ratio:.4f} of that with true poses{goal(ratio, RMSE_GOAL, quick)}; seam step:", end=" ")
    print(f"median {median:.4f} um{goal(median, STEP_GOAL_UM, quick)}, 95 % {wide:.4f} um", end="")
    print(goal(wide, WIDE_STEP_GOAL_UM, quick))
    level = rms((poses.z_um - poses.z_um.mean()) - (made.known.z_um - made.known.z_um.mean()))
    print(f"  z of fields {level:.3f} um rms off, tilt {rms(poses.tilt_x - made.known.tilt_x):.2e} along x", flush=True)


def steps_told(steps: np.ndarray) -> tuple[str, ...]:
    return tuple(f"{value:.4f}" for value in (*np.quantile(steps, (0.5, 0.95)), steps.max()))


def costs(quick: bool) -> None:
    """Time and memory of the whole grid, and memory of one with four times as many fields."""
    if not quick:
        show_costs("16 x 13 fields of 1080 x 1440", costs_of(whole(quick)), True)
    size = (270, 360) if quick else (540, 720)
    grid = Grid(*((3, 3) if quick else (16, 13)), *size)
    found = {}
    for one in (grid, replace(grid, rows=2 * grid.rows, cols=2 * grid.cols)):
        made = make(one)
        found[one] = costs_of(one)
        show_costs(f"{one.rows} x {one.cols} fields of {one.field_rows} x {one.field_cols}", found[one], False)
        made.remove()
    few, many = map(peak_mb, found.values())
    print(f"  four times the fields: {many / few:.2f} times the memory{goal(many / few, GROWTH_GOAL, quick)}")


def show_costs(title: str, found: dict[str, Cost], judged: bool) -> None:
    rows = [(name, cost.clock_s, cost.processor_s, f"{cost.peak_mb:.0f}") for name, cost in found.items()]
    header = ("on two threads", "s by the clock", "s of processor", "peak of anonymous memory, MB")
    show(f"Stitching {title}", header, rows)
    parts = [cost for name, cost in found.items() if name != STORE]
    clock_s, processor_s, peak = sum(c.clock_s for c in parts), sum(c.processor_s for c in parts), peak_mb(found)
    in_time, in_memory = goal(clock_s, STITCH_GOAL_S, not judged), goal(peak, MEMORY_GOAL_MB, not judged)
    print(f"  registration + poses + blend: {clock_s:.1f} s by the clock{in_time},", end=" ")
    print(f"{processor_s:.1f} s of processor; peak {peak:.0f} MB{in_memory}", flush=True)


def goal(value: float, limit: float, unjudged: bool = False) -> str:
    """Whether a figure is what was promised; nothing of a quick run, for the promise is of the whole grid."""
    return "" if unjudged else f" (goal {limit:g} {met(value, limit)})"


def peak_mb(found: dict[str, Cost]) -> float:
    return max(cost.peak_mb for cost in found.values())


def splice(quick: bool) -> None:
    """The paper's splicing step: fields where the stage has them, added up with linear ramps, in memory."""
    made = make(replace(PAPER_JOB, rows=3, cols=3, **SMALL) if quick else PAPER_JOB)
    mosaic = mosaic_of(made.heights, None, "ramp")
    size = f"{mosaic.shape[0] * mosaic.shape[1] / 1e6:.1f} Mpx"
    clock_s, processor_s = splice_s(made, "ramp")
    limit = None if quick else f"{SPLICE_GOAL_S:g} {met(clock_s, SPLICE_GOAL_S)}"
    rows: list[tuple[Cell, ...]] = [("ours, linear ramps (all layers)", clock_s, processor_s, limit)]
    rows += [("ours, by confidence (all layers)", *splice_s(made, "confidence"), None)]
    rows += [("paper, 9 x 7 fields, its machine", PAPER_SPLICE_S, None, None)]
    for name in ("opencv feather",) if quick else stitch_peers.SPLICERS:
        told = stitch_peers.splice_s(name, made)
        rows.append((f"{name} (heights only)", *((told, None) if isinstance(told, str) else told), None))
    header = ("", "s", "of processor", "goal")
    show(f"Splicing {made.known.grid.rows} x {made.known.grid.cols} fields, {size}, s", header, rows)
    made.remove()


def splice_s(made: Made, blend: Blend) -> tuple[float, float]:
    """By the clock and of the processor, the least of some runs; maps are in memory before, as for the others."""
    mosaic = mosaic_of([copied(h) for h in made.heights], None, blend)
    return took(mosaic.window, 4).both


def peers(quick: bool) -> None:
    """Where other people's stitchers lay the same tiles, and in what time."""
    made = make(whole(quick) if quick else PART)
    found_poses(made)
    meter = Meter()
    poses = found_poses(made, meter)
    off = position_error(poses.x_um, poses.y_um, made, ~poses.left_out)
    ours = [sum(getattr(c, k) for c in meter.costs.values()) for k in ("clock_s", "processor_s")]
    rows: list[tuple[Cell, ...]] = [("ours (x, y, z and tilt)", *ours, *told_px(off))]
    for name in stitch_peers.QUICK if quick else stitch_peers.PLACERS:
        placed = stitch_peers.place(name, made)
        told = told_px(placed.found) if placed.found else (placed.why_not, None, None)
        rows.append((stitch_peers.TITLES.get(name, name), placed.seconds, placed.processor_s, *told))
    size = f"{made.known.grid.rows} x {made.known.grid.cols} fields"
    show(f"Positions of {size} by other programs", ("program", "s", "of processor", *ERRORS), rows)


def odd(quick: bool) -> None:
    """Fields that do not belong: named and left out, the others as if they were not there."""
    size = {"rows": 5, "cols": 5, **SMALL}
    kinds = {"turned": (7, 16), "mirrored": (7, 16), "foreign": (7, 16), "empty": (7, 16)}
    rows: list[tuple[Cell, ...]] = []
    notes: tuple[str, ...] = ()
    for kind, planted in list(kinds.items())[: 1 if quick else None]:
        made = make(Grid(**size, **{kind: planted}))
        poses = found_poses(made)
        off = position_error(poses.x_um, poses.y_um, made, ~poses.left_out)
        left = ", ".join(str(n + 1) for n in np.flatnonzero(poses.left_out)) or "none"
        steps = seam_steps_um(made, poses)
        rows.append((kind, ", ".join(str(n + 1) for n in planted), left, *told_px(off)[:2], float(steps.max())))
        notes += poses.notes
        made.remove()
    header = ("two fields of 25", "planted", "left out", "rms px", "max px", "largest seam step, um")
    show("Fields that do not belong; errors of the others", header, rows)
    print(*(f"  {note}" for note in notes), sep="\n", flush=True)


def copied(height: HeightMap) -> HeightMap:
    """A copy that is not mapped from a file."""
    names = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")
    return replace(height, **{name: getattr(height, name).copy() for name in names})


SECTIONS: dict[str, Callable[[bool], None]] = {
    "positions": positions,
    "heights": heights,
    "odd": odd,
    "costs": costs,
    "splice": splice,
    "peers": peers,
}

if __name__ == "__main__":
    main()
