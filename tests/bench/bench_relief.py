"""Smooth steep relief without walls: what is kept, and its error, beside plain weighted least squares.

    python tests/bench/bench_relief.py [--quick] [--scenes N] [--from SEED] [--each]

Planes, waves, bumps, saddles and rough ground drawn by seed (`tests/truth/relief.py`), default recipe. Errors are in
steps of the sweep, over the measured pixels; the least squares (`least_squares_focus.py`) are taken at the same pixels,
once with the window that is best without smoothing and once with the best smoothing. Tuning sees seeds below 1000.
--quick: ten scenes, at most a minute.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from tests.bench.harness import percent, read_options, show
from tests.bench.least_squares_focus import PLAIN, SMOOTHED
from tests.truth.relief import RELIEFS, drawn_relief
from tests.truth.unseen import FIRST_REPORTED_SEED
from wafer_viewer.measure.truth_comparison import rmse
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct

KEPT_GOAL, CLEANED_GOAL = 0.95, 1.02
QUICK_SCENES, SCENES = 10, 100


@dataclass(frozen=True)
class Judged:
    """A scene: share of the frame that is measured, and errors there in steps; refused: share by reason."""

    about: str
    name: str
    kept: float
    raw: float
    cleaned: float
    plain: float
    smoothed: float
    false: float
    refused: dict[str, float]


GOALS: dict[str, Callable[[Judged], bool]] = {
    f"at least {100 * KEPT_GOAL:.0f} % kept": lambda one: one.kept >= KEPT_GOAL,
    "measured heights no worse than plain least squares": lambda one: one.raw <= one.plain,
    "measured heights no worse than smoothed least squares": lambda one: one.raw <= one.smoothed,
    "cleaned heights no worse than smoothed least squares": lambda one: one.cleaned <= one.smoothed,
    f"cleaned heights at most {100 * (CLEANED_GOAL - 1):.0f} % worse than measured ones": (
        lambda one: one.cleaned <= CLEANED_GOAL * one.raw
    ),
}


def main() -> None:
    wanted = read_options(__doc__, scenes=SCENES, first_seed=FIRST_REPORTED_SEED, each=False)
    count = QUICK_SCENES if wanted.quick else wanted.scenes
    with ProcessPoolExecutor() as pool:
        scenes = list(pool.map(judge, range(wanted.first_seed, wanted.first_seed + count)))
    if wanted.each:
        header = ("scene", "kept %", "false %", "measured", "plain LSQ", "cleaned", "smoothed LSQ", "refused")
        show("Scene by scene, RMSE in steps", header, [each_row(one) for one in scenes])
    show_kinds(scenes)
    show_goals(scenes)


def judge(seed: int) -> Judged:
    """Reconstruct a scene with the defaults, and by least squares."""
    relief = drawn_relief(seed)
    height = reconstruct(relief.stack, Recipe(), threads=1)
    raw_um = height.to_measure()
    kept = np.isfinite(raw_um)
    errors = {
        name: (z_um - relief.truth_um)[kept] / relief.step_um
        for name, z_um in {
            "raw": raw_um,
            "cleaned": height.z_um,
            "plain": PLAIN.heights_um(relief.stack),
            "smoothed": SMOOTHED.heights_um(relief.stack),
        }.items()
    }
    counts = Counter(Origin(code).name for code in height.origin[height.origin != Origin.MEASURED].tolist())
    return Judged(
        about=relief.about,
        name=relief.name,
        kept=float(kept.mean()),
        false=float(np.mean(np.abs(errors["raw"]) > 1)) if kept.any() else np.nan,
        refused={name: n / kept.size for name, n in counts.most_common()},
        **{name: rmse(error) for name, error in errors.items()},
    )


def each_row(one: Judged) -> tuple[str | float, ...]:
    reasons = ", ".join(f"{name} {percent(share)}" for name, share in one.refused.items() if share >= 0.005)
    errors = (one.raw, one.plain, one.cleaned, one.smoothed)
    return (one.about, percent(one.kept), percent(one.false, 2), *errors, reasons)


def show_kinds(scenes: Sequence[Judged]) -> None:
    """Means of the kept share, medians of the errors, by kind of relief."""
    rows = []
    for name in (*RELIEFS, "all"):
        some = [one for one in scenes if name in (one.name, "all")]
        if some:
            worst = max(one.cleaned / one.raw for one in some)
            errors = np.nanmedian([(one.raw, one.plain, one.cleaned, one.smoothed) for one in some], axis=0)
            kept = np.array([one.kept for one in some])
            rows.append((name, len(some), percent(kept.mean()), percent(kept.min()), *map(float, errors), worst))
    header = (
        "relief", "scenes", "kept %, mean", "least", "measured", "plain LSQ", "cleaned", "smoothed LSQ",
        "cleaned / measured, worst",
    )  # fmt: skip
    show("Smooth steep relief, medians of the RMSE in steps", header, rows)
    reasons = Counter[str]()
    for one in scenes:
        reasons.update(one.refused)
    refused = [(name, percent(total / len(scenes), 2)) for name, total in reasons.most_common()]
    show("Not measured, mean share of the frame", ("reason", "%"), refused)


def show_goals(scenes: Sequence[Judged]) -> None:
    rows = [
        (goal, sum(map(met, scenes)), percent(np.mean([met(one) for one in scenes]))) for goal, met in GOALS.items()
    ]
    show(f"Goals, of {len(scenes)} scenes", ("goal", "met", "%"), rows)


if __name__ == "__main__":
    main()
