"""Stitching of grids drawn by seed: random ground, repeating dies, lines, under uneven light and by poor stages.

    python tests/bench/bench_grids.py [--grids N] [--from SEED] [--each] [--narrow] [--peers] [--quick]
        [--scenes [NAME ...]]

--scenes: grids of many fields by name, 3 seeds each, of 16 x 13 and 40 x 40 fields; all of them take some minutes.
Seeds below 1000 are for tuning; figures to be quoted start at 1000. Errors are in pixels, apart from the place and turn
of the whole, without the fields that do not belong; a field is far off beyond 2 px. Of lines, only errors across them
count: nothing shows where a field lies along them. A grid is silently wrong where a field is far off and no note says
that anything is undecided.

The limit is the rms error of the best possible estimate: the inverse of the information that the pictures without noise
hold where true neighbours overlap, with a stage as good as the one that was drawn. Fields that overlap nothing, or only
lines along one direction, cannot be placed to .03 px by anybody; *of those that can* counts the other grids.

*Can be known* counts the misfits that a perfect observer could name: all but two fields that changed places among dies
without dust or blank ground, where nothing but the stage tells them apart, and it errs too much. The log odds of the
swap by the places of both fields, for the true scatter of the stage, must outweigh the number of pairs, and that one
scan in a thousand has swapped fields.

--narrow lets fields overlap by 4 to 7 % only. --peers runs the stitchers of `stitch_peers.py` on the same tiles, those
of the grids without missing fields and misfits.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.bench import peer_stitchers
from tests.bench.harness import Cell, read_options, show, took
from tests.bench.stitch_peers import PLACERS, PYTHON
from tests.truth.drawn_grids import PIXEL_UM, SCENES, MadeGrid, drawn, made, narrowed, planted
from wafer_viewer.reconstruct.stitching import stitch

FAR_PX = 2.0
CAN_PX = 0.02
"""Limit of a grid, in pixels, up to which .03 px can be asked for."""
SWAPPED_SCANS_NATS = np.log(1000)
"""Log odds against a scan with swapped fields."""
MOST_FOR_LIMIT = 100
"""Number of fields up to which the limit is computed: by a dense inverse."""
HEADER = (
    "ground | grids | rms px: median | mean | worst tenth | limit: median | <= .03 px | of those that can | "
    "normalised | believed | wrong | misfits | can be known | false alarms | silently wrong | ms per overlap"
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What stitching made of one grid: errors in pixels; overlaps by number; fields by number."""

    rms_px: float
    max_px: float
    limit_px: float
    normalised: tuple[float, ...]
    believed: int
    wrong: int
    overlaps: int
    found: int
    planted: int
    knowable: int
    alarms: int
    fields: int
    silent: bool
    seconds: float
    total_s: float
    notes: tuple[str, ...]


def main() -> None:
    asked = read_options(
        __doc__,
        grids=200,
        first_seed=1000,
        each=False,
        narrow=False,
        peers=False,
        scenes={"nargs": "*", "choices": (*SCENES, []), "metavar": "NAME"},
    )
    if asked.scenes is not None:
        judge_scenes(
            asked.scenes or list(SCENES), range(asked.first_seed, asked.first_seed + min(asked.grids, 3)), asked.each
        )
        return
    seeds = range(8) if asked.quick else range(asked.first_seed, asked.first_seed + asked.grids)
    found: dict[str, list[Outcome]] = defaultdict(list)
    judged(made(drawn(0)))  # compiles what is not compiled yet
    peers: dict[str, list[PeerOutcome]] = defaultdict(list)
    for seed in seeds:
        grid = narrowed(drawn(seed)) if asked.narrow else drawn(seed)
        tiles = made(grid)
        outcome = judged(tiles)
        found[grid.kind].append(outcome)
        found["all"].append(outcome)
        if asked.peers and not grid.missing and not grid.misfits:
            peers["this one"].append(PeerOutcome(grid.kind, outcome.rms_px, outcome.limit_px, outcome.total_s))
            for name in PLACERS:
                peers[name].append(peer_outcome(name, tiles))
        if asked.each:
            print(seed, grid.kind, told(grid), one_row(outcome), *outcome.notes, sep=" | ", flush=True)
    show(f"Positions of drawn grids, seeds from {seeds[0]}", HEADER, [row(name, some) for name, some in found.items()])
    if peers:
        show_peers(peers)


def judge_scenes(names: list[str], seeds: range, each: bool) -> None:
    """Stitch grids of `SCENES`, with the largest error of each."""
    judged(made(drawn(0)))
    rows: list[tuple[Cell, ...]] = []
    for name in names:
        some = [judged(made(planted(name, seed))) for seed in seeds]
        if each:
            print(name, *map(one_row, some), sep="\n  ", flush=True)
        rows.append((*row(name, some), f"{max(o.max_px for o in some):.3f}"))
    show(f"Positions of grids of many fields, seeds from {seeds[0]}", f"{HEADER} | max px", rows)


def judged(grid: MadeGrid) -> Outcome:
    """Stitch a grid and compare with where its fields are."""
    stitched = took(lambda: stitch(grid.heights).poses)
    poses, seconds = stitched.result, stitched.processor_s
    counted = np.array([n not in grid.misfits for n in range(len(grid.heights))]) & ~poses.left_out
    off_px = errors_px(poses.x_um, poses.y_um, grid, counted)
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
        limit_px=limit_px(grid, counted) if counted.size <= MOST_FOR_LIMIT else float("nan"),
        normalised=tuple((error / u)[held & ~wrong[:, None]].tolist()),
        believed=int(believed.sum()),
        wrong=int(wrong.sum()),
        overlaps=int(between.sum()),
        found=len(left & set(grid.misfits)),
        planted=len(grid.misfits),
        knowable=0 if _hides_swap(grid) else len(grid.misfits),
        alarms=len(left - set(grid.misfits)),
        fields=len(grid.heights),
        silent=bool((np.abs(off_px) > FAR_PX).any() and not poses.notes),
        seconds=seconds / max(1, len(poses.shifts.first)),
        total_s=seconds,
        notes=poses.notes,
    )


def errors_px(x_um: np.ndarray, y_um: np.ndarray, grid: MadeGrid, counted: np.ndarray) -> np.ndarray:
    """Return errors (x, y) of the counted fields, [n, 2], apart from the place and turn of the whole; in pixels.

    Across one direction only where the ground is made of lines.
    """
    centre = np.array([(n - 1) / 2 for n in grid.heights[0].shape[::-1]]) * (PIXEL_UM, -PIXEL_UM)
    true = (grid.true_um + centre)[counted]
    off = np.column_stack((x_um, y_um))[counted] - true
    if grid.drawn.kind == "lines":
        across = _across(grid)
        off = (off @ across)[:, None] * across
    arm = true - true.mean(axis=0)
    off = off - np.median(off, axis=0)
    basis = np.column_stack((arm.ravel(), np.column_stack((arm[:, 1], -arm[:, 0])).ravel()))
    near = np.repeat(np.abs(off).max(axis=1) < FAR_PX * PIXEL_UM, 2)
    if near.sum() > 4 and grid.drawn.kind != "lines":
        off = off - (basis @ np.linalg.lstsq(basis[near], off.ravel()[near], rcond=None)[0]).reshape(off.shape)
    return off / PIXEL_UM


def _hides_swap(grid: MadeGrid) -> bool:
    """Return whether two fields changed places where neither pictures nor the stage can tell."""
    if "swapped" not in grid.misfits.values() or not grid.drawn.periodic or grid.drawn.dust or grid.drawn.blank:
        return False
    n = len(grid.heights)
    return swap_nats(grid) < SWAPPED_SCANS_NATS + np.log(n * (n - 1) / 2)


def swap_nats(grid: MadeGrid) -> float:
    """Return the log odds of the two swapped fields of a pattern against its other periods, by the stage alone.

    The scatter of the stage and what its errors have in common are known.
    """
    drawn_ = grid.drawn
    a, b = (n for n, what in grid.misfits.items() if what == "swapped")
    kept = np.array([k for k in range(drawn_.rows * drawn_.cols) if k not in drawn_.missing])
    true, stage = (at / PIXEL_UM * (1, -1) for at in (grid.true_um, grid.stage_um))
    common = np.column_stack((np.ones(len(kept)), stage, kept // drawn_.cols % 2))
    rest = true - stage - common @ np.linalg.lstsq(common, true - stage, rcond=None)[0]
    cos, sin = np.cos(drawn_.angle), np.sin(drawn_.angle)
    to_dies, pitch = np.array([[cos, sin], [-sin, cos]]), np.array(drawn_.pitch_px)
    apart = to_dies @ (true[b] - true[a])
    periods = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 2), -1).reshape(-1, 2) * pitch
    nats = 0.0
    for n, shown in ((a, apart), (b, -apart)):
        places = rest[n] + (shown - np.rint(shown / pitch) * pitch + periods) @ to_dies
        nats += (np.sum(places**2, axis=1).min() - np.sum(rest[n] ** 2)) / (2 * drawn_.stage_px**2)
    return float(nats)


def _across(grid: MadeGrid) -> np.ndarray:
    """Return the unit vector (x, y), upwards, across the lines of the ground."""
    return np.array([-np.sin(grid.drawn.angle), -np.cos(grid.drawn.angle)])


def limit_px(grid: MadeGrid, counted: np.ndarray) -> float:
    """Return the least rms error (Cramer and Rao) that pictures and stage allow, as `errors_px` counts it."""
    places = np.flatnonzero(counted)
    at = grid.true_um[places] / PIXEL_UM * (1, -1)
    n, noise2 = len(places), grid.drawn.noise**2 + 1 / 12
    stage2 = grid.drawn.stage_px**2 + grid.drawn.backlash_px**2 / 4
    information = np.eye(2 * n) / stage2
    for i in range(n):
        for j in range(i + 1, n):
            told_px = _information(grid.clean[places[i]], at[j] - at[i]) / (2 * noise2)
            if told_px.any():
                a, b = slice(2 * i, 2 * i + 2), slice(2 * j, 2 * j + 2)
                information[a, a] += told_px
                information[b, b] += told_px
                information[a, b] -= told_px
                information[b, a] -= told_px
    covariance = np.linalg.inv(information)
    arm = at - at.mean(axis=0)
    shared = [np.tile((1.0, 0.0), n), np.tile((0.0, 1.0), n)]
    if grid.drawn.kind == "lines":
        across = np.kron(np.eye(n), np.outer(_across(grid) * (1, -1), _across(grid) * (1, -1)))
        covariance = across @ covariance @ across
    else:
        shared += [arm.ravel(), np.column_stack((arm[:, 1], -arm[:, 0])).ravel()]
    basis = np.linalg.qr(np.column_stack(shared))[0]
    free = np.eye(2 * n) - basis @ basis.T
    return float(np.sqrt(np.trace(free @ covariance @ free) / (2 * n)))


def _information(grey: np.ndarray, apart_px: np.ndarray) -> np.ndarray:
    """Return the summed outer products of the gradient (x, y) of a field where one that is (x, y) px apart overlaps."""
    rows, cols = grey.shape
    left, top = (int(np.ceil(max(0.0, v))) for v in apart_px)
    right, bottom = (int(np.floor(min(n, n + v))) for n, v in zip((cols, rows), apart_px, strict=True))
    if right - left < 3 or bottom - top < 3:
        return np.zeros((2, 2))
    down, across = np.gradient(grey[top:bottom, left:right].astype(float))
    each = np.stack((across.ravel(), down.ravel()))
    return each @ each.T


@dataclass(frozen=True, slots=True)
class PeerOutcome:
    """What a stitcher made of a grid: rms error, None where it gave up; the limit; seconds of processor."""

    kind: str
    rms_px: float | None
    limit_px: float
    seconds: float


def peer_outcome(name: str, grid: MadeGrid) -> PeerOutcome:
    """Run a program of `peer_stitchers.py` on a grid."""
    drawn_ = grid.drawn
    counted = np.ones(len(grid.heights), bool)
    row, col = (k.ravel() for k in np.indices((drawn_.rows, drawn_.cols)))
    stage_px = grid.stage_um / PIXEL_UM
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / f"{n}.npz") for n in range(len(row))]
        for file, height in zip(files, grid.heights, strict=True):
            np.savez(file, all_in_focus=height.all_in_focus)
        edges = [
            (a, b)
            for a in range(len(row))
            for b in range(a + 1, len(row))
            if abs(row[a] - row[b]) + abs(col[a] - col[b]) == 1
        ]
        told_ = {"row": row, "col": col, "top_px": -stage_px[:, 1], "left_px": stage_px[:, 0]}
        np.savez(Path(folder) / "job.npz", files=np.array(files), edges=np.array(edges), **told_)
        result = Path(folder) / "result.npz"
        command = [PYTHON, peer_stitchers.__file__, name, str(Path(folder) / "job.npz"), str(result)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            return PeerOutcome(drawn_.kind, None, limit_px(grid, counted), np.nan)
        with np.load(result) as found:
            x_um, y_um = found["left_px"] * PIXEL_UM, -found["top_px"] * PIXEL_UM
            centre = np.array([(n - 1) / 2 for n in drawn_.shape[::-1]]) * (PIXEL_UM, -PIXEL_UM)
            off = errors_px(x_um + centre[0], y_um + centre[1], grid, counted)
            rms = float(np.sqrt(np.mean(off**2)))
            return PeerOutcome(drawn_.kind, rms, limit_px(grid, counted), float(found["processor_s"]))


def show_peers(peers: dict[str, list[PeerOutcome]]) -> None:
    """Show the rms errors of all stitchers on the same grids, the kinds of ground side by side."""
    kinds = sorted({o.kind for o in peers["this one"]})
    header = ("stitcher", "grids", "gave up", *(f"{k}: median, <= .03 px" for k in kinds), "mean", "s per grid")
    rows: list[tuple[Cell, ...]] = []
    for name, some in peers.items():
        done = [o for o in some if o.rms_px is not None]
        each = [np.array([o.rms_px for o in done if o.kind == kind]) for kind in kinds]
        told_ = [f"{np.median(rms):.3f}, {np.mean(rms <= 0.03):.0%}" if len(rms) else "-" for rms in each]
        mean = f"{np.mean([o.rms_px for o in done]):.3f}" if done else "-"
        spent = f"{np.mean([o.seconds for o in done]):.2f}" if done else "-"
        rows.append((name, len(some), len(some) - len(done), *told_, mean, spent))
    show("The same tiles: rms px", header, rows)


def told(grid) -> str:
    return (
        f"{grid.rows}x{grid.cols} of {grid.shape[0]}x{grid.shape[1]} overlap {grid.overlap:.2f} pitch "
        f"{min(grid.pitch_px):.0f} stage {grid.stage_px:.1f}+{grid.backlash_px:.1f} ({grid.stage_of_pitch:.2f}) "
        f"light {grid.fall_off:.2f} noise {grid.noise:.1f} blank {grid.blank:.2f} {dict(grid.misfits)}"
    )


def one_row(o: Outcome) -> str:
    sure = float(np.sqrt(np.mean(np.square(o.normalised)))) if o.normalised else float("nan")
    return (
        f"rms {o.rms_px:.3f} limit {o.limit_px:.3f} max {o.max_px:.2f} norm {sure:.2f} "
        f"believed {o.believed}/{o.overlaps} wrong {o.wrong} "
        f"misfits {o.found}/{o.planted} alarms {o.alarms} {'SILENT' if o.silent else ''}"
    )


def row(name: str, some: list[Outcome]) -> tuple[Cell, ...]:
    """A row of the table."""
    rms = np.sort([o.rms_px for o in some])
    sure = np.concatenate([o.normalised for o in some])
    can = [o for o in some if o.limit_px <= CAN_PX]
    worst = rms[-max(1, len(rms) // 10) :].mean()
    return (
        name,
        len(some),
        *(f"{v:.3f}" for v in (np.median(rms), rms.mean(), worst, np.median([o.limit_px for o in some]))),
        f"{np.mean(rms <= 0.03):.0%}",
        f"{sum(o.rms_px <= 0.03 for o in can)} of {len(can)}",
        f"{np.sqrt(np.mean(sure**2)):.2f}" if len(sure) else "-",
        f"{sum(o.believed for o in some)} of {sum(o.overlaps for o in some)}",
        sum(o.wrong for o in some),
        f"{sum(o.found for o in some)} of {sum(o.planted for o in some)}",
        sum(o.knowable for o in some),
        f"{sum(o.alarms for o in some)} of {sum(o.fields for o in some)}",
        sum(o.silent for o in some),
        f"{1e3 * np.mean([o.seconds for o in some]):.1f}",
    )


if __name__ == "__main__":
    main()
