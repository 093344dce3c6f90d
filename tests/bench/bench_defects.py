"""How many planted defects are captured on noisy height maps, how many false ones a mm2, how long and with what memory.

    python tests/bench/bench_defects.py [--quick] [--seed N]
    python tests/bench/bench_defects.py --speed [--quick]     9 and 165 Mpx from disk, alone and on two workers

Made-up patterned wafers (tests/support/noisy_wafer.py): dies 360 px wide, up to half a pixel off their places, normal
noise, 2 % of the pixels unmeasured, a bow of 10 um, pixels of 0.5 um; bumps and pits that show in the heights only.
Goals: 0.95 captured of 6 sigma and 6 px, and of 3 sigma and 20 px; at most 0.1 false a mm2; 9 Mpx in 6 s on two cores,
165 Mpx in 120 s, 3 GB. Heights from focus err in patches: what that does is measured by bench_defects_truth.py.
"""

from __future__ import annotations

import math

from tests.bench.defects_speed import show_speed
from tests.bench.harness import Cell, met, peak_mb, percent, read_options, show, took
from tests.support.noisy_wafer import Planted, Wafer, scattered, wafer
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.model.inspection.defect import Inspection

DIE_PX, STREET_PX = 360, 20
FULL, QUICK = 8, 4
"""Dies along each side."""
N_PLANTED = 40
CAPTURE, FALSE_PER_MM2, SECONDS, GIGABYTES = 0.95, 0.1, 6.0, 3.0
CASES = ((6.0, 6.0), (20.0, 3.0), (40.0, 6.0))
"""Diameter in px, height in sigma."""


def main() -> None:
    given = read_options(__doc__, speed=False, seed=1)
    if given.speed:
        show_speed(given.quick)
        return
    side = QUICK if given.quick else FULL
    shape = (side * (DIE_PX + STREET_PX), side * (DIE_PX + STREET_PX))
    inspect((clean := made(side, given.seed, ())).surface, clean.grid)
    rows = [case(side, given.seed, ())]
    rows += [case(side, given.seed + k, scattered(k, N_PLANTED, shape, *c)) for k, c in enumerate(CASES, 1)]
    header = "Planted | Mpx | captured | % | goal | false | per mm2 | goal | foretold | s | cpu s | goal"
    show("Defects on noisy height maps", header, rows)
    print(f"\nPeak memory, the wafers themselves with it: {peak_mb() / 1e3:.2f} GB (goal {GIGABYTES:g} GB).")


def made(side: int, seed: int, planted: tuple[Planted, ...]) -> Wafer:
    """One wafer of side x side dies."""
    return wafer(seed, (side, side), (DIE_PX, DIE_PX), planted, street_px=STREET_PX)


def case(side: int, seed: int, planted: tuple[Planted, ...]) -> list[Cell]:
    """One line of the table."""
    of = made(side, seed, planted)
    inspected = took(lambda: inspect(of.surface, of.grid))
    found = inspected.result
    hits, false = judged(of, found)
    mpx = of.surface.z_um.size / 1e6
    per_mm2 = false / found.inspected_mm2
    share = hits / len(planted) if planted else math.nan
    name = f"{planted[0].size_px:g} px, {planted[0].height_sigma:g} sigma" if planted else "none"
    captured = [f"{hits}/{len(planted)}", percent(share), met(share, CAPTURE, True)] if planted else [None, None, None]
    goals = met(per_mm2, FALSE_PER_MM2), met(inspected.clock_s, SECONDS * mpx / 9)
    return [name, mpx, *captured, false, per_mm2, goals[0], found.expected_false_per_mm2, *inspected.both, goals[1]]


def judged(of: Wafer, found: Inspection) -> tuple[int, int]:
    """How many planted ones have a defect on them, and how many defects lie on none."""
    near = [
        [math.hypot(d.center.x_um - p.x_um, d.center.y_um - p.y_um) <= max(2.0, p.size_px / 4) for d in found.found]
        for p in of.planted
    ]
    false = sum(not any(line[k] for line in near) for k in range(len(found.found)))
    return sum(any(line) for line in near), false


if __name__ == "__main__":
    main()
