"""Classes proposed from judged defects: a random forest on the numbers of a defect and of the surface around it.

It proposes and never overrules: the class of the rules and the judgement of people stay as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Defect, Inspection, crop
from wafer_viewer.model.inspection.defect_classes import RULES
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.learned_classes import (
    LEAST_JUDGED,
    NUISANCE,
    ClassesLearned,
    JudgedDefect,
    JudgedDefects,
    LearnedClass,
)
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic

TREES = 300
"""Number of trees of the forest; shares of votes are steps of a third of a percent."""
INSTALL = "pip install 'wafer-viewer[learning]'"
_TINY = 1e-6
"""Added to what may be 0 before a ratio or a logarithm."""
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ClassForest:
    """Trees that were grown on judged defects, and what they stand on."""

    trees: Any
    learned: ClassesLearned

    def propose(self, numbers: Sequence[Sequence[float]]) -> list[LearnedClass]:
        """Return the class with most votes for each defect."""
        if not numbers:
            return []
        votes: Floats = self.trees.predict_proba(np.asarray(numbers, np.float64))
        best = votes.argmax(axis=1)
        return [
            LearnedClass(kind=str(self.trees.classes_[k]), share=min(1.0, float(row[k])))
            for k, row in zip(best, votes, strict=True)
        ]


def judged_defects(inspection: Inspection, surface: Mosaic, *, wafer: str = "") -> JudgedDefects:
    """Collect the judged defects of an inspection, with the numbers that classes are learned from.

    Parameters
    ----------
    inspection : Inspection
        Inspected defects, of which those judged real or a nuisance count.
    surface : Mosaic
        Inspected surface.
    wafer : str, optional
        Name of the inspection.

    Returns
    -------
    JudgedDefects
        The judged defects. The class of a real one is the operator's, else that of the rules.

    Raises
    ------
    MeasureError
        When a defect lies outside the surface.
    """
    judged = [defect for defect in inspection.found if defect.judgement != "open"]
    rows = [
        JudgedDefect(
            wafer=wafer,
            number=defect.number,
            kind=NUISANCE if defect.judgement == "nuisance" else defect.seen_as,
            by_rules=defect.kind,
            numbers=_features(defect, surface, inspection.grid),
        )
        for defect in judged
    ]
    return JudgedDefects(product=inspection.product, features=FEATURES, defects=tuple(rows))


def with_learned_classes(inspection: Inspection, surface: Mosaic, judged: Iterable[JudgedDefects] = ()) -> Inspection:
    """Propose classes for the open defects of an inspection from judged ones.

    Parameters
    ----------
    inspection : Inspection
        Inspection, whose own judged defects count too.
    surface : Mosaic
        Inspected surface.
    judged : iterable of JudgedDefects, optional
        Judged defects of other inspections of the product, from `judged_defects`.

    Returns
    -------
    Inspection
        The inspection, its open defects with a proposal (`Defect.learned`), and with what the proposals stand on
        (`Inspection.learned`). Classes and judgements are those of before.

    Raises
    ------
    MeasureError
        When fewer than 8 defects are judged, or all of them alike, or scikit-learn is not installed, or a defect lies
        outside the surface.

    Notes
    -----
    A random forest [1]_ of 300 trees. Each judged defect is held against the trees that did not see it, which gives
    `ClassesLearned.right_fraction`. Classes count alike, however many defects of them were judged.

    References
    ----------
    .. [1] L. Breiman, Random forests, Machine Learning 45 (2001) 5-32.
    """
    return with_proposals(inspection, surface, grown((judged_defects(inspection, surface), *judged)))


def with_proposals(inspection: Inspection, surface: Mosaic, forest: ClassForest) -> Inspection:
    """Return an inspection with the proposals of a forest for its open defects."""
    open_ones = [defect for defect in inspection.found if defect.judgement == "open"]
    proposed = forest.propose([_features(defect, surface, inspection.grid) for defect in open_ones])
    by_number = {defect.number: learned for defect, learned in zip(open_ones, proposed, strict=True)}
    defects = tuple(replace(defect, learned=by_number.get(defect.number)) for defect in inspection.defects)
    return replace(inspection, defects=defects, learned=forest.learned)


def of_others(judged: JudgedDefects, wafer: str) -> JudgedDefects:
    """Return the judged defects of other inspections than one; none if they were kept with other numbers."""
    kept = tuple(defect for defect in judged.defects if defect.wafer != wafer) if judged.features == FEATURES else ()
    return replace(judged, features=FEATURES, defects=kept)


def grown(judged: Iterable[JudgedDefects]) -> ClassForest:
    """Return the forest of all judged defects. Raises MeasureError as `with_learned_classes`."""
    parts = [part for part in judged if part.features == FEATURES]
    known = [defect for part in parts for defect in part.defects]
    kinds = [defect.kind for defect in known]
    if len(known) < LEAST_JUDGED or len(set(kinds)) < 2:
        raise MeasureError(
            f"Classes are proposed from at least {LEAST_JUDGED} judged defects, not all of one class: "
            f"judge more first ({len(known)} judged)."
        )
    trees = _forest()
    numbers = np.array([defect.numbers for defect in known])
    trees.fit(numbers, np.array(kinds))
    votes: Floats = np.nan_to_num(trees.oob_decision_function_)
    unseen = trees.classes_[votes.argmax(axis=1)]
    learned = ClassesLearned(
        judged=len(known),
        wafers=len({(n, defect.wafer) for n, part in enumerate(parts) for defect in part.defects}),
        right_fraction=float(np.mean(unseen == kinds)),
        rules_right_fraction=float(np.mean([defect.by_rules == defect.kind for defect in known])),
    )
    return ClassForest(trees, learned)


def _forest() -> Any:
    try:
        from sklearn.ensemble import RandomForestClassifier
    except ImportError as fault:
        raise MeasureError(f"Classes are learned by scikit-learn: {INSTALL}.") from fault
    return RandomForestClassifier(
        TREES, class_weight="balanced_subsample", bootstrap=True, oob_score=True, random_state=0, n_jobs=1
    )


# ------------------------------------------------------------------------------------------------------------- features


_OWN = ("height", "sign", "mean height", "length", "width", "ratio", "steepness", "fill")
_FOUND = ("score", "confidence", "scale")
_SEEN = ("in heights", "in picture", "unmeasured")
_BY_RULES = {kind: f"rules: {kind}" for kind in (*RULES, "particle")}
_ON_DIE = ("on die", "share of die", "from border")
_CONTRAST = ("level", "relative level", "spread", "slope")
FEATURES = (
    *(*_OWN, *_FOUND, *_SEEN, *_BY_RULES.values(), *_ON_DIE),
    *(f"{layer}: {name}" for layer in ("picture", "heights") for name in _CONTRAST),
)
"""Names of the numbers that classes are learned from; those that were kept with others do not count."""


def _features(defect: Defect, surface: Mosaic, grid: DieGrid | None) -> tuple[float, ...]:
    """Return the numbers of a defect in the order of FEATURES; lengths in um as logarithms."""
    height, px = defect.height.value_um, surface.pixel_um
    major, minor = max(defect.major.value_um, px), max(defect.minor.value_um, px)
    cut = crop(surface, defect)
    inside = _inside(defect, cut)
    grey = cut.all_in_focus / float(np.iinfo(cut.all_in_focus.dtype).max)
    heights = np.asarray(cut.z_raw_um, np.float64)
    return (
        math.log(abs(height) + _TINY),
        float(np.sign(height)),
        defect.mean_height_um / height if height else 0.0,
        math.log(major),
        math.log(minor),
        math.log(major / minor),
        math.log((abs(height) + _TINY) / minor),
        defect.area.value / (math.pi / 4 * major * minor),
        math.log(defect.score + 1),
        defect.confidence,
        defect.scale_px,
        float(defect.evidence != "picture"),
        float(defect.evidence != "height"),
        float(np.mean(~np.isfinite(heights[inside]))),
        *(float(defect.kind == kind) for kind in _BY_RULES),
        *_on_die(defect, grid),
        *_contrast(grey, inside),
        *_contrast(heights, inside),
    )


def _on_die(defect: Defect, grid: DieGrid | None) -> tuple[float, float, float]:
    if grid is None or defect.in_die is None or not defect.die:
        return 0.0, 0.0, 0.0
    u, v = defect.in_die.x_um, defect.in_die.y_um
    near = min(u, v, grid.width_um - u, grid.height_um - v)
    share = defect.area.value / (grid.width_um * grid.height_um)
    return 1.0, share, near / max(defect.minor.value_um, _TINY)


def _inside(defect: Defect, cut: HeightMap) -> NDArray[np.bool_]:
    """Return the pixels within the outline, at least the one in its centre."""
    x, y = np.meshgrid(cut.x_um, cut.y_um)
    inside = defect.outline.contains(x, y)
    if not inside.any():
        nearest = np.hypot(x - defect.center.x_um, y - defect.center.y_um).argmin()
        inside[np.unravel_index(nearest, x.shape)] = True
    return inside


def _contrast(values: Floats, inside: NDArray[np.bool_]) -> tuple[float, float, float, float]:
    """Return level, relative level, spread and slope inside an outline, against those around it."""
    steep = (
        np.hypot(np.gradient(values, axis=0), np.gradient(values, axis=1))
        if min(values.shape) > 1
        else np.zeros_like(values)
    )
    own, other = (_known(values[part]) for part in (inside, ~inside))
    if not own.size or not other.size or min(values.shape) < 2:
        return 0.0, 0.0, 0.0, 0.0
    steep = np.hypot(np.gradient(values, axis=0), np.gradient(values, axis=1))
    level = float(np.median(own) - np.median(other))
    own_slope, slope = (_median(_known(steep[part])) for part in (inside, ~inside))
    spread = _spread(other) + _TINY
    return (
        level,
        level / spread,
        math.log((_spread(own) + _TINY) / spread),
        math.log((own_slope + _TINY) / (slope + _TINY)),
    )


def _known(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _median(values: Floats) -> float:
    return float(np.median(values)) if values.size else 0.0


def _spread(values: Floats) -> float:
    low, high = np.quantile(values, (0.16, 0.84))
    return float(high - low) / 2
