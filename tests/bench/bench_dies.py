"""How often the dies of a patterned wafer are found, how exactly, and whether what is no lattice is refused.

    python tests/bench/bench_dies.py [--quick] [--wafers N] [--seed N] [--only WORD] [--optics N] [--products N]
        [--given]

Made-up wafers thrown with dice, 600 x 720 pixels, some 50 dies: heights and picture with noise, bow of 10 um and 2 %
unmeasured. Right is a lattice whose dies lie within half a pixel everywhere on the surface, or a refusal where there is
none; wrong is any other lattice. --products N: as many wafers of tests/bench/product_wafers.py from the seed on, right
where every whole die is found with its size. --given: with the pitches and the size of the dies known, as
typed with half a percent of error. --optics N: as many wafers of tests/truth as well, seen through the
virtual optics, dies half a pixel off their places.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.bench.die_scenes import LATTICES, NO_LATTICES, Dice, Thrown
from tests.bench.harness import read_options, show
from tests.bench.product_wafers import judged, product
from tests.support.patterned_surface import Wafer
from wafer_viewer.measure.dies.die_lattice import find_dies
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid, ProductDies
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap

RIGHT_PX, SEEN_PX = 0.5, 1.5
"""How far dies may lie off at most; through the optics, where each lies 0.5 px (k = 1) off its lattice itself."""
NUMBER = {"type": int, "default": 0}
HEADER = "wafers | n | right | refused | wrong | pitch off, px | worst | corner off, px | worst | s each"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one wafer: how far pitches and corners are off, px; None where it was refused."""

    pitch_px: float | None
    corner_px: float | None
    seconds: float


def main() -> None:
    asked = read_options(__doc__, wafers=10, seed=1, only="", optics=NUMBER, products=NUMBER, given=False)
    n, step = (1, 2) if asked.quick else (asked.wafers, 1)
    rows = [
        [name, *_row([_outcome(thrown, dice) for dice in _dice(asked.seed, name, n)], thrown in NO_LATTICES.values())]
        for name, thrown in list((LATTICES | NO_LATTICES).items())[::step]
        if asked.only in name
    ]
    show(f"Dies found, {n} wafers of each kind from seed {asked.seed}", HEADER, rows)
    if asked.products:
        begun = time.process_time()
        words = [_product(asked.seed + k, asked.given) for k in range(asked.products)]
        rows = [
            [kind, *_counted([word for one, word in words if one == kind])] for kind in sorted({k for k, _ in words})
        ]
        show(
            "Dies of products found",
            "array | n | right | refused | wrong",
            [*rows, ["all", *_counted([w for _, w in words])]],
        )
        print(f"  {(time.process_time() - begun) / asked.products:.1f} s each, drawing included", flush=True)
    if asked.optics:
        seen = [_optics(asked.seed + k) for k in range(asked.optics)]
        show("Dies found through the virtual optics", HEADER, [["9 x 8 dies, 0.5 px off", *_row(seen, False, SEEN_PX)]])


def _product(seed: int, given: bool = False) -> tuple[str, str]:
    """Return the kind of array of a seed, and what came of it."""
    drawn = product(seed)
    typed = np.random.default_rng((seed, 5)).uniform(0.995, 1.005, 2)
    grid, pitch = drawn.grid, (drawn.grid.pitch_x_um * typed[0], drawn.grid.pitch_y_um * typed[1])
    street = grid.street_x_um * drawn.shown[0], grid.street_y_um * drawn.shown[1]
    sides = {"width_um": pitch[0] - street[0], "height_um": pitch[1] - street[1]}
    size = ProductDies(pitch_x_um=pitch[0], pitch_y_um=pitch[1], **sides) if given else None
    try:
        right, why = judged(find_dies(drawn.surface, size=size), drawn)
    except MeasureError:
        return drawn.kind, "refused"
    if not right:
        print(f"  seed {seed}: {why}", flush=True)
    return drawn.kind, "right" if right else "wrong"


def _counted(words: list[str]) -> list[str]:
    return [str(len(words)), *(str(words.count(word)) for word in ("right", "refused", "wrong"))]


def _dice(seed: int, name: str, n: int) -> list[Dice]:
    return [np.random.default_rng((seed, k, *name.encode())) for k in range(n)]


def _outcome(throw: Callable[[Dice], Thrown], dice: Dice) -> Outcome:
    thrown = throw(dice)
    return _found(thrown.surface, thrown.wafer.grid if thrown.wafer else None, thrown.every)


def _found(surface: HeightMap, true: DieGrid | None, every: tuple[int, int] = (1, 1)) -> Outcome:
    begun = time.process_time()
    try:
        grid = find_dies(surface)
    except MeasureError:
        return Outcome(None, None, time.process_time() - begun)
    seconds = time.process_time() - begun
    if true is None:
        return Outcome(math.inf, math.inf, seconds)
    return Outcome(*off_px(grid, true, surface.pixel_um, every), seconds)


def off_px(grid: DieGrid, true: DieGrid, pixel_um: float, every: tuple[int, int]) -> tuple[float, float]:
    """(pitches, lower left corners of the dies on the surface), each as far as it is off at most, in pixels.

    With another pitch than so many dies the corners are off by as much as dies lie between what is found.
    """
    asked = true.pitch_x_um * every[0], true.pitch_y_um * every[1]
    pitch_um = max(abs(grid.pitch_x_um - asked[0]), abs(grid.pitch_y_um - asked[1]))
    col, row, _, _ = true.to_die(*grid.to_stage(0, 0, true.width_um / 2, true.height_um / 2))
    cols, rows = np.array(grid.places).T
    there = true.to_stage(cols * every[0] + int(col), rows * every[1] + int(row))
    corners = np.hypot(*np.subtract(grid.to_stage(cols, rows), there))
    return pitch_um / pixel_um, float(corners.max()) / pixel_um


def _optics(seed: int) -> Outcome:
    from tests.truth.defects import make
    from tests.truth.planted import DIE_UM, PITCH_UM, STREET_PX, Plan
    from tests.truth.planted import PIXEL_UM as FINE_UM

    street = STREET_PX * FINE_UM / 2
    true = Wafer(pitch_x_um=PITCH_UM[0], pitch_y_um=PITCH_UM[1], width_um=DIE_UM[0], height_um=DIE_UM[1]).grid
    return _found(make(Plan(seed=seed), 0.186).surface, replace(true, x0_um=street, y0_um=street))


def _row(outcomes: list[Outcome], none: bool, right_px: float = RIGHT_PX) -> list[str]:
    found = [one for one in outcomes if one.corner_px is not None]
    right = len(outcomes) - len(found) if none else sum(one.corner_px < right_px for one in found)
    wrong = len(found) if none else len(found) - right
    counts = [str(count) for count in (len(outcomes), right, len(outcomes) - len(found), wrong)]
    seconds = f"{np.median([one.seconds for one in outcomes]):.2f}"
    known = [] if none else [one for one in found if one.corner_px < right_px]
    pitches, corners = _median_worst([one.pitch_px for one in known]), _median_worst([one.corner_px for one in known])
    return [*counts, *pitches, *corners, seconds]


def _median_worst(each: list[float]) -> tuple[str, str]:
    return (f"{np.median(each):.3f}", f"{max(each):.3f}") if each else ("", "")


if __name__ == "__main__":
    main()
