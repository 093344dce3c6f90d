"""How often tilted, bowed, discoloured and missing dies are named right, beside other defects, on drawn products.

    python tests/bench/bench_die_states.py [--quick] [--wafers N] [--seed N]

Wafers of tests/bench/product_wafers.py with nine dies or more, the true lattice given (it names no dies). On each some
dies are tilted by 3 to 40 mrad, one is bowed, one discoloured by 10 to 20 %, and particles, pits, scratches and stains
lie on others and on those. Missing dies are those of the drawn wafer. Right is a defect of that class on the die; wrong
any other die-level class; a die-level class on a die that nothing was done to is false. Local defects are found with
their centre within half their size and 3 px; defects on no planted one, no listed die and no rim cell are false too.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.bench.harness import read_options, show
from tests.bench.product_wafers import Product, product
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.dies.die_lattice import over_surface
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Inspection

TILTS_MRAD = (3.0, 5.0, 8.0, 12.0, 20.0, 40.0)
DIE_KINDS = ("tilted die", "missing die", "bowed die", "discoloured die")
LEAST_DIES = 9


@dataclass(frozen=True, slots=True)
class Local:
    """A planted local defect: its kind, centre and size."""

    kind: str
    x_um: float
    y_um: float
    size_um: float


@dataclass(slots=True)
class Planted:
    """A drawn wafer with what was done to it: by die (column, row) a class and its size, and the local defects."""

    wafer: Product
    dies: dict[tuple[int, int], tuple[str, float]] = field(default_factory=dict[tuple[int, int], tuple[str, float]])
    local: list[Local] = field(default_factory=list[Local])


def planted(seed: int) -> Planted | None:
    """Return the wafer of a seed with planted defects; None with too few dies."""
    drawn = product(seed)
    grid, dice = drawn.grid, np.random.default_rng((seed, 77))
    sound = sorted(drawn.whole - drawn.missing)
    if len(sound) < LEAST_DIES or min(grid.cols, grid.rows) < 2:
        return None
    made = Planted(drawn, dict.fromkeys(drawn.whole & drawn.missing, ("missing die", 0.0)))
    order = [sound[int(k)] for k in dice.permutation(len(sound))]
    n_tilted = max(1, min(6, len(sound) // 6))
    for k, at in enumerate(order[:n_tilted]):
        made.dies[at] = ("tilted die", TILTS_MRAD[(seed + k) % len(TILTS_MRAD)])
    if len(sound) >= 2 * LEAST_DIES:
        made.dies[order[n_tilted]] = ("bowed die", float(dice.uniform(0.6, 3.0)))
        made.dies[order[n_tilted + 1]] = ("discoloured die", float(dice.uniform(0.1, 0.2)))
    surface = drawn.surface
    z_um, grey = surface.z_um.astype(np.float64), surface.all_in_focus.astype(np.float64)
    pixel_um = surface.pixel_um
    rows, cols = np.indices(z_um.shape).astype(np.float64)
    x_um, y_um = np.asarray(surface.x0_um + cols * pixel_um), np.asarray(surface.y0_um - rows * pixel_um)
    col, row, u, v = grid.to_die(x_um, y_um)
    on = (u >= 0) & (u <= grid.width_um) & (v >= 0) & (v <= grid.height_um)
    for at, (kind, size) in made.dies.items():
        die = on & (col == at[0]) & (row == at[1])
        a, b = u[die] - grid.width_um / 2, v[die] - grid.height_um / 2
        if kind == "tilted die":
            turn = float(dice.uniform(0, 2 * math.pi))
            z_um[die] += size / 1e3 * (a * math.cos(turn) + b * math.sin(turn))
        elif kind == "bowed die":
            far = (a**2 + b**2) / (grid.width_um**2 + grid.height_um**2) * 4
            z_um[die] += size * (1 - far)
        elif kind == "discoloured die":
            grey[die] *= 1 + size * float(dice.choice([-1, 1]))
    made.local = _local(dice, made, order, (z_um, grey), (x_um, y_um))
    altered = {
        name: np.where(np.isfinite(surface.z_um), z_um, np.nan).astype(np.float32) for name in ("z_um", "z_raw_um")
    }
    seen = np.clip(grey, 0, 255).astype(surface.all_in_focus.dtype)
    made.wafer = dataclasses.replace(drawn, surface=dataclasses.replace(surface, **altered, all_in_focus=seen))
    return made


def _local(dice: Any, made: Planted, order: list[tuple[int, int]], layers: Any, places: Any) -> list[Local]:
    grid, pixel_um = made.wafer.grid, made.wafer.surface.pixel_um
    found: list[Local] = []
    for k, at in enumerate(order[: max(4, len(order) // 2)]):
        size = float(dice.uniform(6, 14)) * pixel_um
        if 4 * size > min(grid.width_um, grid.height_um):
            continue
        u, v = (float(dice.uniform(size, n - size)) for n in (grid.width_um, grid.height_um))
        x, y = (float(one) for one in grid.to_stage(*at, u, v))
        r = np.hypot(places[0] - x, places[1] - y) / (size / 2)
        kind = ("particle", "pit", "stain")[k % 3]
        if kind == "stain":
            layers[1][...] *= 1 - 0.3 * (r < 1)
        else:
            layers[0][...] += (1 if kind == "particle" else -1) * 2.5 * np.exp(-((r / 0.7) ** 2))
            layers[1][...] *= 1 - 0.15 * np.exp(-((r / 0.7) ** 2))
        found.append(Local(kind, x, y, size))
    return found


Counts = dict[str, Counter[str]]


def judged(made: Planted, found: Inspection, counts: Counts) -> None:
    """Add what came of one wafer to the counts."""
    grid, pixel_um = made.wafer.grid, made.wafer.surface.pixel_um
    whole_area = grid.width_um * grid.height_um
    states = {die.name: die.state for die in found.dies}
    by_die: dict[str, list[str]] = {}
    for defect in found.found:
        if defect.seen_as in DIE_KINDS or defect.area.value > 0.5 * whole_area:
            by_die.setdefault(defect.die, []).append(str(defect.seen_as))
    for at, (kind, size) in made.dies.items():
        name = grid.name(*at)
        kinds = by_die.get(name, [])
        title = f"tilted {size:g} mrad" if kind == "tilted die" else kind
        if kind == "missing die":
            rim = at[0] in (0, grid.cols - 1) or at[1] in (0, grid.rows - 1)
            title = f"missing die, {'rim' if rim else 'inner'}"
        local = sum(d.die == name and d.seen_as not in DIE_KINDS for d in found.found)
        own = sum(_die_of(made, one) == at for one in made.local)
        word = "right" if kinds == [kind] else "wrong" if kinds else "no"
        counts.setdefault(title, Counter())[word] += 1
        counts[title]["beside"] += max(0, local - own)
        counts[title]["state missing"] += states.get(name) == "missing"
    planted_names = {grid.name(*at) for at in made.dies}
    whole = {grid.name(*at) for at in made.wafer.whole}
    sound = counts.setdefault("sound dies", Counter())
    sound["right"] += len(whole - planted_names)
    sound["wrong"] += sum(name in by_die for name in whole - planted_names)
    for one in made.local:
        near = max(one.size_um / 2, 3 * pixel_um)
        hit = any(math.hypot(d.center.x_um - one.x_um, d.center.y_um - one.y_um) <= near for d in found.found)
        counts.setdefault(f"{one.kind}, 6 to 14 px", Counter())["right" if hit else "no"] += 1
    for defect in found.found:
        if defect.die in planted_names or str(defect.seen_as) in DIE_KINDS:
            continue
        if any(
            math.hypot(defect.center.x_um - p.x_um, defect.center.y_um - p.y_um) <= p.size_um + 3 * pixel_um
            for p in made.local
        ):
            continue
        where = "false on whole dies" if defect.die in whole else "false elsewhere"
        counts.setdefault(where, Counter())["wrong"] += 1


def _die_of(made: Planted, one: Local) -> tuple[int, int]:
    col, row, _, _ = made.wafer.grid.to_die(np.array([one.x_um]), np.array([one.y_um]))
    return int(col[0]), int(row[0])


def main() -> None:
    asked = read_options(__doc__, wafers=40, seed=1)
    n = 4 if asked.quick else asked.wafers
    counts: Counts = {}
    used, mm2, begun = 0, 0.0, time.process_time()
    for seed in range(asked.seed, asked.seed + n):
        if (made := planted(seed)) is None:
            continue
        try:
            found = inspect(made.wafer.surface, over_surface(made.wafer.grid, made.wafer.surface))
        except MeasureError as fault:
            print(f"  seed {seed}: {fault}", flush=True)
            continue
        used, mm2 = used + 1, mm2 + found.inspected_mm2
        judged(made, found, counts)
    words = ("right", "wrong", "no", "beside", "state missing")
    rows = [[name, *(count[word] for word in words)] for name, count in sorted(counts.items())]
    show(
        f"Dies of {used} products of seeds {asked.seed} to {asked.seed + n - 1}, {mm2:.1f} mm2",
        "what | right | wrong | no | defects beside | state missing",
        rows,
    )
    print(f"  {(time.process_time() - begun) / max(1, used):.1f} s each", flush=True)


if __name__ == "__main__":
    main()
