"""How many planted defects are found on patterned wafers, how many that are none, and whether class and size are right.

    python tests/bench/bench_defects_truth.py [--quick] [--wafers N] [--seed N] [--keep FILE] [--sensitivity N]
    python tests/bench/bench_defects_truth.py --paper FOLDER/wafer.wafer     of `wafer-viewer paper --keep FOLDER`
    python tests/bench/bench_defects_truth.py --learn [--wafers N] [--seed N]      classes proposed from judgements
    python tests/bench/bench_defects_truth.py --speed        9 and 165 Mpx: seconds and memory

Focus stacks rendered through the virtual optics, reconstructed with the default recipe, laid side by side, inspected
with the default recipe of defects, or another setting of its dial. Dies lie 0.5 px off their places, the wafer bows by
10 um, the gates leave some per cent unmeasured. Seeds change from run to run unless one is given; --keep FILE keeps
what each wafer gave, and a stopped run goes on. Words of SEMI M50: capture rate, false count rate; limits of 95 %.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tests.bench.defects_learning import show_learning
from tests.bench.defects_paper import show_paper
from tests.bench.defects_record import Hit, Wafer, recorded
from tests.bench.defects_speed import show_speed
from tests.bench.harness import Cell, keep_run, met, percent, read_options, read_runs, show, took
from tests.truth.defects import Plan, make
from tests.truth.matching import Rate, false_limit_per_mm2
from tests.truth.planted import DIAMETERS_PX, GEOMETRIC, HEIGHTS_SIGMA
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.dies.die_lattice import find_dies
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection

CAPTURE, FALSE_PER_MM2, CLASS_RIGHT = 0.95, 0.1, 0.9
WAFER_MM2 = np.pi * 150.0**2
QUICK = Plan(cols=5, rows=4)


def main() -> None:
    switches = {"speed": False, "learn": False}
    dial = DefectRecipe().sensitivity
    given = read_options(__doc__, wafers=20, seed=int, keep=Path, sensitivity=dial, paper=Path, **switches)
    if given.paper:
        show_paper(given.paper)
    elif given.speed:
        show_speed(given.quick)
    else:
        first = given.seed if given.seed is not None else secrets.randbelow(100_000)
        plans = [Plan(seed=first + n) for n in range(given.wafers)]
        quick = [Plan(cols=QUICK.cols, rows=QUICK.rows, seed=first)]
        recipe = DefectRecipe(sensitivity=given.sensitivity)
        if given.learn:
            show_learning(quick if given.quick else plans)
            return
        show_all(inspected(quick if given.quick else plans, given.keep, recipe), first)


def inspected(plans: Sequence[Plan], keep: Path | None, recipe: DefectRecipe) -> list[Wafer]:
    """What every wafer gave; those that a file holds are not made again."""
    known = [Wafer.read(run) for run in read_runs(keep)]
    for plan in plans:
        if len(known) < len(plans) and plan.seed not in {wafer.seed for wafer in known}:
            known.append(one_wafer(plan, recipe))
            keep_run(keep, asdict(known[-1]))
    return known


def one_wafer(plan: Plan, recipe: DefectRecipe) -> Wafer:
    """Make a wafer and inspect it."""
    made = make(plan)

    def inspection() -> Inspection:
        try:
            return inspect(made.surface, find_dies(made.surface), recipe)
        except MeasureError as refused:
            print(f"Wafer {plan.seed} was refused, all of it counts as missed: {refused}", flush=True)
            return Inspection()

    inspected = took(inspection)
    return recorded(made, inspected.result, inspected.clock_s)


def show_all(wafers: Sequence[Wafer], first: int) -> None:
    """Every table."""
    hits = [hit for wafer in wafers for hit in wafer.hits]
    area, unmeasured = sum(w.area_mm2 for w in wafers), float(np.mean([w.unmeasured for w in wafers]))
    print(
        f"{len(wafers)} wafers from seed {first}, {area:.2f} mm2, {percent(unmeasured)} % of the pixels unmeasured, "
        f"deviation of heights {wafers[0].sigma_um:.3f} um, {len(hits)} planted; {sum(w.seconds for w in wafers):.1f} s"
    )
    show_capture(hits)
    show_cells(hits)
    show_false(sum(len(w.false) for w in wafers), sum(w.parts for w in wafers), area)
    show_classes([hit for hit in hits if hit.found])
    show_sizes([hit for hit in hits if hit.found])


def show_capture(hits: Sequence[Hit]) -> None:
    """The two goals, by class."""
    groups: dict[str, Callable[[Hit], bool]] = {
        "6 sigma, 6 px and more": lambda hit: hit.height_sigma >= 6,
        "3 sigma, 20 px and more": lambda hit: hit.height_sigma >= 3 and hit.diameter_px >= 20,
    }
    for title, wanted in groups.items():
        some = [hit for hit in hits if hit.kind in GEOMETRIC and wanted(hit)]
        rows = [(kind, *capture_row([h for h in some if h.kind == kind]), "") for kind in GEOMETRIC]
        whole = rate(some)
        rows.append(("all", *capture_row(some), met(whole.share, CAPTURE, True)))
        show(f"Captured: {title}", ("class", "found", "of", "%", "from", "to", f"goal {CAPTURE:.2f}"), rows)
    for kind in ("missing die", "tilted die"):
        part = rate([hit for hit in hits if hit.kind == kind])
        print(f"  {kind}: {part.hits} of {part.of}")


def rate(hits: Sequence[Hit]) -> Rate:
    return Rate(sum(hit.found for hit in hits), len(hits))


def capture_row(hits: Sequence[Hit]) -> tuple[Cell, ...]:
    one = rate(hits)
    limits = (percent(one.low), percent(one.high)) if one.of else ("-", "-")
    return one.hits, one.of, percent(one.share), *limits


def show_cells(hits: Sequence[Hit]) -> None:
    """Found of planted by class, height and diameter."""
    header = ("class, height", *(f"{d} px" for d in DIAMETERS_PX))
    rows: list[tuple[Cell, ...]] = []
    for kind in GEOMETRIC:
        for sigmas in HEIGHTS_SIGMA:
            cells = [
                rate([h for h in hits if (h.kind, h.height_sigma, h.diameter_px) == (kind, sigmas, d)])
                for d in DIAMETERS_PX
            ]
            rows.append((f"{kind}, {sigmas} sigma", *(f"{one.hits}/{one.of}" for one in cells)))
    show(
        "Found of planted (residues are twice, scratches four times as long; chips as deep as the street)", header, rows
    )


def show_false(count: int, parts: int, area_mm2: float) -> None:
    """The false count with its limit, and what it would be on a wafer."""
    if area_mm2 == 0:
        return
    share, limit = count / area_mm2, false_limit_per_mm2(count, area_mm2)
    print(
        f"\nFalse: {count} on {area_mm2:.2f} mm2: {share:.3f} a mm2, at most {limit:.3f} (95 %); "
        f"goal {FALSE_PER_MM2} {met(share, FALSE_PER_MM2)}, shown {'yes' if limit <= FALSE_PER_MM2 else 'no'}. "
        f"{FALSE_PER_MM2} per mm2 are {FALSE_PER_MM2 * WAFER_MM2:.0f} on a wafer of 300 mm.\n"
        f"  Further pieces of planted defects that were found already: {parts}",
        flush=True,
    )


def show_classes(found: Sequence[Hit]) -> None:
    """Which class the planted ones were given."""
    given = sorted({hit.found_kind for hit in found})
    counts = Counter((hit.kind, hit.found_kind) for hit in found)
    rows = [(kind, *(counts[kind, name] or "" for name in given)) for kind in (*GEOMETRIC, "missing die", "tilted die")]
    geometric = [hit for hit in found if hit.kind in GEOMETRIC]
    right = Rate(sum(hit.kind == hit.found_kind for hit in geometric), len(geometric))
    show("Classes: planted (rows), given (columns)", ("", *given), rows)
    goal = f"goal {CLASS_RIGHT} {met(right.share, CLASS_RIGHT, True)}"
    print(f"  right: {percent(right.share)} % of {right.of} found, {goal}")
    plain = [hit for hit in geometric if hit.height_sigma >= 6 and hit.diameter_px >= 20]
    clear = Rate(sum(hit.kind == hit.found_kind for hit in plain), len(plain))
    print(f"  right of those of 6 sigma and 20 px and more: {percent(clear.share)} % of {clear.of}")


def show_sizes(found: Sequence[Hit]) -> None:
    """Heights and lengths against the truth, of those whose size is resolved."""
    rows: list[tuple[Cell, ...]] = []
    for kind in GEOMETRIC:
        some = [hit for hit in found if hit.kind == kind and hit.size_resolved]
        if some:
            rows.append((kind, len(some), *size_row(some)))
    header = ("class", "n", "height found / true", "U covers %", "length found / true", "U covers %")
    show("Sizes, of resolved ones (medians)", header, rows)


def size_row(hits: Sequence[Hit]) -> tuple[Cell, ...]:
    height = float(np.median([hit.found_height_um / hit.height_um for hit in hits]))
    length = float(np.median([hit.found_length_um / hit.length_um for hit in hits]))
    return height, covers(hits, "height"), length, covers(hits, "length")


def covers(hits: Sequence[Hit], what: str) -> str:
    """The share of U that hold the truth; a dash where there is no U."""
    told = [hit for hit in hits if getattr(hit, f"u_{what}_um") is not None]
    off = [abs(getattr(h, f"found_{what}_um") - getattr(h, f"{what}_um")) <= getattr(h, f"u_{what}_um") for h in told]
    return percent(float(np.mean(off))) if off else "-"


if __name__ == "__main__":
    main()
