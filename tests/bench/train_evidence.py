"""Train the probability that a height is right, on scenes of all families, and judge how it carries over.

    python tests/bench/train_evidence.py [--quick] [--write] [--least P]

Scenes are those of `TRAINING`, all with seeds for tuning; their scores are kept, so that a run that was stopped goes
on where it was. Prints, of scenes left out of the training: kept and false heights by family, with other scenes of the
family in the training (three folds) and with none of it; and the reliability of the probability. A family left out is
harder than any sample whose kind is known. --write: trains on all scenes and writes `evidence.json` of the package.
--quick: every eighth scene, a tenth of the trees. Hours of one core; minutes once the scores are kept.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.bench.boosted_trees import Boosted, Boosting, fit, probability
from tests.bench.harness import HOME, percent, read_options, show
from tests.truth.families import family_scene
from wafer_viewer.model.spec import replace as changed
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import LEAST_PROBABILITY, Recipe
from wafer_viewer.reconstruct.field_pipeline import (
    correct_edges,
    evidence_scores,
    gate_peaks,
    mirror_of,
    prepare_field,
    search_peaks,
    vetoed,
)
from wafer_viewer.reconstruct.gates import evidence
from wafer_viewer.reconstruct.gates.evidence import LEAST_FAR
from wafer_viewer.reconstruct.gates.evidence_scores import CELL_SCORES, PIXEL_SCORES

SCORES = (*PIXEL_SCORES, *CELL_SCORES)
RAISES = ("contrast", "lead", "fall", "fall share", "range", "border", "accepted", "accepted around")
RAISES += ("agree", "agree around", "agree far", "size", "accepted size")
LOWERS = ("windows", "clipped", "clipped around", "off plane", "off wide plane", "off cell", "rough far")
"""Scores that may only raise, or only lower the probability."""

POINTS, FITTED = 2500, 600
"""Points of a scene that are kept, and of these, drawn anew, that a model sees."""
FOLDS = 3
KEPT = HOME / "evidence"
RECORD = Path(evidence.__file__).with_name("evidence.json")

Training = dict[str, tuple[Sequence[int], Sequence[tuple[int, float]]]]
TRAINING: Training = {
    "trenches": (
        [*range(300, 420), *range(500, 620, 2), *range(501, 541, 2)],
        [*((n, 1.7) for n in range(300, 340, 2)), *((n, 0.6) for n in range(340, 380, 2))],
    ),
    "print": (range(300, 332), [(300, 1.7), (301, 1.7), (302, 1.7), (303, 1.7), (304, 1.7)]),
    "textbook": (range(300, 332), [(300, 0.6), (301, 0.6), (302, 0.6), (303, 0.6), (304, 0.6)]),
    "bumps": (range(300, 332), []),
    "metal": (range(300, 332), [(300, 1.7), (301, 1.7), (302, 1.7), (303, 1.7), (304, 1.7)]),
    "boards": (range(300, 332), []),
    "bare": (range(300, 332), [(300, 0.6), (301, 0.6), (302, 0.6), (303, 0.6), (304, 0.6)]),
    "holes": (range(300, 348), [(300, 1.7), (301, 1.7), (302, 0.6), (303, 0.6)]),
    "particles": (range(300, 348), [(300, 1.7), (301, 1.7), (302, 0.6), (303, 0.6)]),
}
"""Seeds of each family, and those reconstructed once more with so many times the focus width, which may be misread."""


@dataclass(frozen=True)
class Sampled:
    """Points of a scene: their scores [n, score], and whether their height is right, or off by more than a step.

    today: whether the gates keep them; covered: share of the frame that the points stand for; known: right share of the
    frame without any gate.
    """

    family: str
    seed: int
    factor: float
    scores: NDArray[np.float32]
    right: NDArray[np.bool_]
    false: NDArray[np.bool_]
    accepted: NDArray[np.bool_]
    covered: float
    known: float


def main() -> None:
    asked = read_options(__doc__, write=False, least=LEAST_PROBABILITY)
    wanted = drawn(TRAINING)[:: 8 if asked.quick else 1]
    with ProcessPoolExecutor() as pool:
        scenes = list(pool.map(sampled, *zip(*wanted, strict=True)))
    how = Boosting(trees=12) if asked.quick else Boosting()
    inside = out_of_fold(scenes, [n % FOLDS for n in range(len(scenes))], how)
    families = list(TRAINING)
    apart = out_of_fold(scenes, [families.index(scene.family) for scene in scenes], how)
    header = "family | scenes | gates: of right % | false % | family known: of right % | false % | unknown | false %"
    by_gates = [scene.accepted for scene in scenes]
    by_trees = [[counted(*one, asked.least) for one in zip(scenes, told, strict=True)] for told in (inside, apart)]
    rows = []
    for name in families:
        some = [n for n, scene in enumerate(scenes) if scene.family == name and scene.factor == 1]
        rows.append((name, len(some), *(one for kept in (by_gates, *by_trees) for one in judged(scenes, some, kept))))
    show(f"Heights at least {100 * asked.least:g} % probable, of scenes not trained on", header, rows)
    show(
        "Reliability",
        ("told %", "right %, known family", "points", "right %, unknown", "points"),
        reliability(scenes, inside, apart),
    )
    if asked.write:
        write(fitted(scenes, how))


def drawn(training: Training) -> list[tuple[str, int, float]]:
    """Family, seed, and factor of the focus width of every scene."""
    return [
        (family, seed, factor)
        for family, (seeds, others) in training.items()
        for seed, factor in (*((seed, 1.0) for seed in seeds), *others)
    ]


def listed(training: Training) -> list[str]:
    """The scenes in words, for the record."""
    return [f"{family} {seed}" + (f" x {factor:g}" if factor != 1 else "") for family, seed, factor in drawn(training)]


def sampled(family: str, seed: int, factor: float = 1.0) -> Sampled:
    """The scores of some points of a scene, computed once."""
    version = zlib.crc32("|".join(SCORES).encode())
    kept = KEPT / f"{version:08x}-{family}-{seed}-{factor:g}.npz"
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part.npz")
        np.savez(part, **_sampled(family, seed, factor))
        part.rename(kept)
    with np.load(kept) as found:
        values = {name: found[name] for name in found.files}
    return Sampled(family, seed, factor, **{**values, **{name: float(values[name]) for name in ("covered", "known")}})


def _sampled(family: str, seed: int, factor: float) -> dict[str, NDArray]:
    scene = family_scene(family, seed)
    field = prepare_field(scene.stack)
    if factor != 1:
        width_um = factor * float(field.tuned.recipe.focus_width_um)
        field = prepare_field(scene.stack, changed(Recipe(), focus_width_um=width_um))
    peaks = search_peaks(field, threads=1)
    corrected = correct_edges(field, gate_peaks(field, peaks), threads=1)
    error_um, searched_um = (np.abs(z_um - scene.truth_um) for z_um in (corrected.z_um, peaks.z_um))
    open_ = ~vetoed(field, corrected)
    at = np.flatnonzero(open_)
    at = np.random.default_rng(1).choice(at, min(POINTS, at.size), replace=False)
    scores = evidence_scores(field, corrected, mirror_of(field, corrected.gated, threads=1))
    return {
        "scores": scores.planes(open_.shape).reshape(len(SCORES), -1).T[at],
        "right": (error_um <= scene.right_um).ravel()[at],
        "false": (error_um > scene.step_um).ravel()[at],
        "accepted": (corrected.origin == Origin.MEASURED).ravel()[at],
        "covered": np.float64(open_.mean()),
        "known": np.float64((searched_um <= scene.right_um).mean()),
    }


# ------------------------------------------------------------------------------------------------------------ training


def fitted(scenes: Sequence[Sampled], how: Boosting) -> Boosted:
    """Trees of these scenes; every scene counts by its covered share, and a family by the root of its scenes."""
    rng = np.random.default_rng(how.seed)
    count = {family: sum(scene.family == family for scene in scenes) for family in TRAINING}
    scores, right, weight = [], [], []
    for scene in scenes:
        at = rng.permutation(len(scene.right))[:FITTED]
        scores.append(scene.scores[at])
        right.append(scene.right[at])
        weight.append(np.full(len(at), scene.covered / max(1, len(at)) / np.sqrt(count[scene.family])))
    direction = np.array([(name in RAISES) - (name in LOWERS) for name in SCORES])
    cheap = np.array([name in CELL_SCORES for name in SCORES])
    return fit(*(np.concatenate(each) for each in (scores, right, weight)), direction, cheap, how)


def out_of_fold(scenes: Sequence[Sampled], folds: Sequence[int], how: Boosting) -> list[NDArray[np.float64]]:
    """The probabilities of every scene by trees of the scenes of the other folds."""
    found: dict[int, NDArray[np.float64]] = {}
    for fold in sorted(set(folds)):
        trees = fitted([scene for scene, k in zip(scenes, folds, strict=True) if k != fold], how)
        for n, k in enumerate(folds):
            if k == fold:
                found[n] = probability(trees, scenes[n].scores)
    return [found[n] for n in range(len(scenes))]


def write(trees: Boosted) -> None:
    """Write the record of the package: the trees, and the scenes that made them."""
    record = {
        "command": "python tests/bench/train_evidence.py --write",
        "scenes": listed(TRAINING),
        "bias": round(trees.bias, 4),
        "scores": [[SCORES[n] for n in asked] for asked in trees.scores],
        "limits": [[float(f"{limit:.5g}") for limit in limits] for limits in trees.limits],
        "leaves": [[round(float(leaf), 4) for leaf in leaves] for leaves in trees.leaves],
    }
    lines = [f' "{name}": {json.dumps(value)}' for name, value in record.items()]
    RECORD.write_text("{\n" + ",\n".join(lines) + "\n}\n")


# ------------------------------------------------------------------------------------------------------------- figures


def counted(scene: Sampled, told: NDArray[np.float64], least: float) -> NDArray[np.bool_]:
    """Which points count: none in a scene of which hardly anything is probable."""
    probable = told >= least
    return probable & (scene.covered * probable.mean() >= LEAST_FAR)


def judged(scenes: Sequence[Sampled], some: Sequence[int], kept: Sequence[NDArray[np.bool_]]) -> tuple[str, str]:
    """Share kept of what is right, and the mean false share of the scenes with any kept height, in percent."""
    right = sum(scenes[n].covered * np.mean(kept[n] & scenes[n].right) for n in some)
    false = [np.mean(scenes[n].false[kept[n]]) for n in some if kept[n].any()]
    return percent(right / sum(scenes[n].known for n in some)), percent(float(np.mean(false)) if false else np.nan, 2)


def reliability(
    scenes: Sequence[Sampled], *probabilities: Sequence[NDArray[np.float64]]
) -> list[tuple[str | int, ...]]:
    """Right share of the points in ranges of the probability."""
    edges = (0.0, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 1.0)
    right = np.concatenate([scene.right for scene in scenes])
    rows = []
    for low, high in pairwise(edges):
        row: list[str | int] = [f"{100 * low:g} to {100 * high:g}"]
        for each in probabilities:
            told = np.concatenate(each)
            inside = (told >= low) & ((told < high) | (high == 1))
            row += [percent(float(right[inside].mean()) if inside.any() else np.nan), int(inside.sum())]
        rows.append(tuple(row))
    return rows


if __name__ == "__main__":
    main()
