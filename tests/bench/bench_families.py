"""Kept heights of what is right, and false ones, by families of samples none of which alone is tuned to.

    python tests/bench/bench_families.py [--quick] [--families NAME ...] [--scenes N] [--from SEED] [--each]

Scenes are drawn by seed (`tests/truth/families.py`), N of each family, default recipe. *Kept* are the pixels with a
measured height. *Of right*: the right heights among them, as a share of what is right when all gates are off; right is
within a step, or half a depth of field if that is more. *False*: of the kept heights, those off by more than a step;
mean of the scenes with any, mean of their worst tenth, and the worst one. Tuning sees seeds below 1000; from 1000 on
figures are reported. --quick: one scene of each family, the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np

from tests.bench.harness import percent, read_options, show, some_of
from tests.bench.recipes import DEFAULT, ungated
from tests.truth.families import FAMILIES, FamilyScene, family_scene
from tests.truth.unseen import FIRST_REPORTED_SEED, use_of
from wafer_viewer.reconstruct.field_pipeline import reconstruct

SCENES = 12
HEADER = "family | scenes | kept % | least | of right % | false % | worst tenth | worst scene | curve in steps"


@dataclass(frozen=True)
class Judged:
    """Shares of a scene's pixels, and the focus width in steps.

    kept, right, known: with a height, with a right one, and right without any gate; false: off by more than a step.
    """

    family: str
    seed: int
    about: str
    kept: float
    right: float
    known: float
    false: float
    width_steps: float

    @property
    def false_of_kept(self) -> float:
        """NaN where nothing is kept."""
        return self.false / self.kept if self.kept > 0 else np.nan


def main() -> None:
    wanted = read_options(
        __doc__, families=some_of(FAMILIES), scenes=SCENES, first_seed=FIRST_REPORTED_SEED, each=False
    )
    seeds = range(wanted.first_seed, wanted.first_seed + (1 if wanted.quick else wanted.scenes))
    with ProcessPoolExecutor() as pool:
        judged = list(pool.map(judge_seed, *zip(*product(wanted.families, seeds), strict=True)))
    if wanted.each:
        show("Scene by scene", HEADER_EACH, [each_row(one) for one in judged])
    groups = {name: [one for one in judged if one.family == name] for name in wanted.families}
    rows = [(name, *summary(some)) for name, some in {**groups, "all": judged}.items()]
    show(f"Families, scenes of seeds {seeds[0]} to {seeds[-1]} ({use_of(seeds[0])})", HEADER, rows)


def judge_seed(family: str, seed: int) -> Judged:
    """Draw the scene of a family and judge it."""
    return judge(family, seed, family_scene(family, seed))


def judge(family: str, seed: int, scene: FamilyScene) -> Judged:
    """Reconstruct a scene by the default, and without gates."""
    gated, searched = (reconstruct(scene.stack, r, threads=1) for r in (DEFAULT, ungated(DEFAULT.focus_measure)))
    error_um, searched_error_um = (np.abs(one.to_measure() - scene.truth_um) for one in (gated, searched))
    return Judged(
        family,
        seed,
        scene.about,
        kept=float(np.isfinite(error_um).mean()),
        right=float((error_um <= scene.right_um).mean()),
        known=float((searched_error_um <= scene.right_um).mean()),
        false=float((error_um > scene.step_um).mean()),
        width_steps=float(gated.provenance.recipe.focus_width_um) / scene.step_um,
    )


HEADER_EACH = ("scene", "kept %", "right without gates %", "of right %", "false %", "curve in steps")


def each_row(one: Judged) -> tuple[str | float, ...]:
    of_right = one.right / one.known if one.known > 0 else np.nan
    shares = (percent(one.kept), percent(one.known), percent(of_right), percent(one.false_of_kept, 2))
    return (f"{one.family} {one.seed} {one.about}", *shares, one.width_steps)


def summary(some: Sequence[Judged]) -> tuple[str | float | int | None, ...]:
    """Means over scenes; false shares of the scenes where anything is kept."""
    kept, right, known = np.array([(one.kept, one.right, one.known) for one in some]).T
    head = (len(some), percent(float(kept.mean())), percent(float(kept.min())), percent(right.sum() / known.sum()))
    found = sorted((one for one in some if one.kept > 0), key=lambda one: one.false_of_kept)
    width = float(np.median([one.width_steps for one in some]))
    if not found:
        return (*head, None, None, None, width)
    false = np.array([one.false_of_kept for one in found])
    tenth = false[-max(1, len(false) // 10) :]
    worst = f"{percent(float(false[-1]), 1)} ({found[-1].family} {found[-1].seed})"
    return (*head, percent(float(false.mean()), 2), percent(float(tenth.mean()), 1), worst, width)


if __name__ == "__main__":
    main()
