"""Dies beside bright trenches: how much of them is measured, and how much of that is false."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from tests.bench.harness import met, percent, show
from tests.bench.recipes import ABLATION, CLASSIC, DEFAULT, MEASURES, ungated
from tests.truth.layouts import Taken
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct

FALSE_UM = 4.0
CLIPPED_GREY, CLIPPED_WINDOW = 250, 17


@dataclass(frozen=True, slots=True)
class Verdict:
    """Shares of one layout: kept of all, false of the kept ones at all places, and in parts of the frame."""

    kept: float
    false: float
    edge_kept: float
    edge_false: float
    interior_kept: float
    interior_false: float
    textured_kept: float
    rim_kept: float
    rim_false: float

    @property
    def row(self) -> tuple[str, ...]:
        """The figures as percentages."""
        return tuple(percent(getattr(self, name), 2 if "false" in name else 1) for name in self.__slots__)


BEYOND = ("rim",)
"""Polished rims, brighter than all else, are shown but no goal is set for them."""
HEADER = (
    "kept %", "false %", "edge: kept", "false", "interior: kept", "false", "textured interior: kept",
    "die rims: kept", "false",
)  # fmt: skip


def verdict(taken: Taken, z_um: NDArray[np.float32]) -> Verdict:
    """Edges are within 10 px of a wall; rims are the edges of dies where there is texture and nothing clips."""
    scene = taken.scene
    edge, everywhere = scene.edge, np.ones(z_um.shape, bool)
    clipped = maximum_filter((taken.stack.images >= CLIPPED_GREY).any(axis=0), CLIPPED_WINDOW)
    rim = edge & (scene.layer == 1) & scene.textured & ~clipped
    kept = np.isfinite(z_um)
    false = kept & (np.abs(z_um - scene.truth_um) > FALSE_UM)

    def shares(where: NDArray[np.bool_]) -> tuple[float, float]:
        n_kept = (kept & where).sum()
        return float(n_kept / max(1, where.sum())), float((false & where).sum() / max(1, n_kept))

    return Verdict(*shares(everywhere), *shares(edge), *shares(~edge), shares(~edge & scene.textured)[0], *shares(rim))


def show_dies(title: str, layouts: Sequence[Taken], ablate: bool) -> None:
    """Every measure at its own gate and at equal completeness, the ablation, and whether the goals are met."""
    header = ("dies beside a trench", *HEADER)
    defaults = [show_layout(title, taken, header) for taken in layouts]
    rows = [(taken.layout.name, *default.row) for taken, default in zip(layouts, defaults, strict=True)]
    show(f"The default on all {title}", header, [*rows, ("mean", *mean(defaults).row)])
    within = [default for taken, default in zip(layouts, defaults, strict=True) if taken.layout.name not in BEYOND]
    show_goals(title if len(within) == len(defaults) else f"{title} but {', '.join(BEYOND)}", within)
    if ablate:
        rows = [(name, *mean([verdict(t, kept_by(t, r)) for t in layouts]).row) for name, r in ABLATION.items()]
        show(f"Ablation, mean over the {title}", header, rows)


def show_layout(title: str, taken: Taken, header: tuple[str, ...]) -> Verdict:
    """One layout; the verdict on the default."""
    default = verdict(taken, kept_by(taken, DEFAULT))
    rows = [("default", *default.row)]
    rows += [(f"{name}, own gate", *verdict(taken, kept_by(taken, r)).row) for name, r in MEASURES.items()]
    others = {name: ranked(taken, name, default.kept) for name in MEASURES}
    rows += [(f"{name}, equally complete", *other.row) for name, other in others.items()]
    show(f"{taken.layout.name} ({title}): {taken.layout.about}", header, rows)
    rivals = [name for name in CLASSIC if default.false > 0 and others[name].false <= default.false]
    said = f"MISSED, {', '.join(rivals)}" if rivals else "met"
    print(f"  fewer false heights than each measure of the paper at equal completeness: {said}", flush=True)
    return default


def kept_by(taken: Taken, recipe: Recipe) -> NDArray[np.float32]:
    return reconstruct(taken.stack, recipe, threads=1).z_raw_um


def ranked(taken: Taken, measure: str, kept: float) -> Verdict:
    """The most confident pixels of a measure without a gate, as many as the default keeps."""
    height = reconstruct(taken.stack, ungated(measure), threads=1)
    confidence = np.where(np.isfinite(height.z_raw_um), height.confidence, -1.0)
    least = np.quantile(confidence, 1 - kept)
    return verdict(taken, np.where(confidence >= max(least, 0), height.z_raw_um, np.float32(np.nan)))


def mean(verdicts: Sequence[Verdict]) -> Verdict:
    """The mean of each share over layouts."""
    return Verdict(*(float(np.mean([getattr(v, name) for v in verdicts])) for name in Verdict.__slots__))


def show_goals(title: str, verdicts: Sequence[Verdict]) -> None:
    """The project's goals, which are for the optical settings, rolled-off rims, turned and curved walls."""
    worst, average = max(v.false for v in verdicts), mean(verdicts)
    interior = max(v.interior_false for v in verdicts)
    kept = met(average.kept, 0.6, True), met(average.textured_kept, 0.8, True), met(average.rim_kept, 0.8, True)
    print(
        f"Goals, {title}\n"
        f"  false: worst {percent(worst, 2)} % (goal 1.3 {met(worst, 0.013)}), "
        f"mean {percent(average.false, 2)} % (goal 0.5 {met(average.false, 0.005)}), "
        f"interior at most {percent(interior, 2)} % (goal 0.2 {met(interior, 0.002)})\n"
        f"  kept: mean {percent(average.kept)} % (goal 60 {kept[0]}), "
        f"textured interior {percent(average.textured_kept)} % (goal 80 {kept[1]}), "
        f"die rims {percent(average.rim_kept)} % (goal 80 {kept[2]}) "
        f"with {percent(average.rim_false, 2)} % false (goal 0.5 {met(average.rim_false, 0.005)})",
        flush=True,
    )
