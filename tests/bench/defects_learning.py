"""How often classes are right that judged defects propose, beside those of the rules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.bench.harness import percent, show
from tests.truth.defects import Plan, make
from tests.truth.matching import match
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.defects.learned_classes import judged_defects, with_learned_classes
from wafer_viewer.measure.dies.die_lattice import find_dies
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.learned_classes import NUISANCE
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap

JUDGED, REPEATS = (20, 40, 80), 8
Name = tuple[int, int]
"""Wafer and number of a defect."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """An inspected wafer, and what its defects are."""

    surface: HeightMap
    found: Inspection
    truth: dict[int, str]


def inspected_wafer(plan: Plan) -> Judged:
    """Inspect a wafer; what lies on nothing planted is a nuisance, further pieces of a planted defect are left out."""
    made = make(plan)
    found = inspect(made.surface, find_dies(made.surface))
    matched = match(made.planted, found.found)
    truth = {defect.number: str(one.kind) for one, defect in matched.pairs}
    return Judged(made.surface, found, truth | {defect.number: NUISANCE for defect in matched.false})


def show_learning(plans: Sequence[Plan]) -> None:
    """Judge some defects of all wafers, at random and the least certain first, and look at the others."""
    wafers = [inspected_wafer(plan) for plan in plans]
    every = [(n, number) for n, wafer in enumerate(wafers) for number in wafer.truth]
    rules = np.mean([_class(wafers, name) == wafers[name[0]].truth[name[1]] for name in every])
    print(f"{len(every)} defects of {len(wafers)} wafers; right by the rules: {percent(float(rules))} %", flush=True)
    rows: list[tuple[str | int, ...]] = []
    for count in (n for n in JUDGED if n < len(every)):
        at_random, by_doubt = zip(*(_both(wafers, every, count, seed) for seed in range(REPEATS)), strict=True)
        rows.append((count, *(percent(float(part(of))) for of in (at_random, by_doubt) for part in (np.mean, np.min))))
    header = ("judged", "at random, right %", "worst", "half by doubt, right %", "worst")
    show(f"Classes proposed for the others, {REPEATS} orders", header, rows)


def _class(wafers: Sequence[Judged], name: Name) -> str:
    return next(defect.kind for defect in wafers[name[0]].found.found if defect.number == name[1])


def _both(wafers: Sequence[Judged], every: Sequence[Name], count: int, seed: int) -> tuple[float, float]:
    """Return the share of right proposals after judgements at random, and after the second half by doubt."""
    order = [every[k] for k in np.random.default_rng(seed).permutation(len(every))]
    half = _proposals(wafers, order[: count // 2])
    doubtful = sorted(half, key=lambda name: half[name][1])[: count - count // 2]
    chosen = (order[:count], [*order[: count // 2], *doubtful])
    at_random, by_doubt = (_right(wafers, _proposals(wafers, names)) for names in chosen)
    return at_random, by_doubt


def _proposals(wafers: Sequence[Judged], judged: Sequence[Name]) -> dict[Name, tuple[str, float]]:
    """Return the proposed class of every defect that is not judged, with its share of the votes."""
    states = [_state(wafer, {number for n, number in judged if n == k}) for k, wafer in enumerate(wafers)]
    learned = [
        judged_defects(state, wafer.surface, wafer=str(k))
        for k, (state, wafer) in enumerate(zip(states, wafers, strict=True))
    ]
    proposed: dict[Name, tuple[str, float]] = {}
    for k, (state, wafer) in enumerate(zip(states, wafers, strict=True)):
        others = [part for n, part in enumerate(learned) if n != k]
        for defect in with_learned_classes(state, wafer.surface, others).found:
            if defect.learned is not None and defect.number in wafer.truth:
                proposed[k, defect.number] = defect.learned.kind, defect.learned.share
    return proposed


def _state(wafer: Judged, judged: set[int]) -> Inspection:
    def says(defect: Defect) -> Defect:
        if defect.number not in judged:
            return defect
        kind = wafer.truth[defect.number]
        return replace(defect, **({"judgement": NUISANCE} if kind == NUISANCE else _real(kind)))

    return replace(wafer.found, defects=tuple(map(says, wafer.found.defects)))


def _real(kind: str) -> dict[str, str]:
    return {"judgement": "real", "judged_kind": kind}


def _right(wafers: Sequence[Judged], proposed: dict[Name, tuple[str, float]]) -> float:
    return float(np.mean([wafers[k].truth[number] == kind for (k, number), (kind, _) in proposed.items()]))
