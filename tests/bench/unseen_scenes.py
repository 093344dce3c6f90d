"""How right the heights are on scenes drawn by seed, with the defaults of the measures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from tests.bench.harness import percent, show
from tests.bench.recipes import MEASURES, ungated
from tests.truth.path_traced import path_traced_scene
from tests.truth.unseen import Unseen, drawn_scene, use_of
from wafer_viewer.measure.truth_comparison import Quality, quality
from wafer_viewer.reconstruct.field_pipeline import reconstruct

RENDERERS = {"layers blurred by FFT": (0,), "rays past walls": (1,), "both": (0, 1)}
HEADER = (
    "renderer, measure | scenes | of them empty | kept % | of the known % | false % | median | worst tenth | worst | "
    "interior | of all kept | RMSE um"
)


@dataclass(frozen=True)
class Judged:
    """The heights of a scene against its truth: of the whole frame, of its interior, and of all peaks without gates.

    What the peaks without gates have right is what an observer could know who tells right peaks from false ones: a
    bound for the share kept, a little too high as some peaks are right by chance.
    """

    whole: Quality
    interior: Quality
    ungated: Quality

    @property
    def known_share(self) -> float:
        """Of the frame, the pixels whose peak is right."""
        return self.ungated.completeness_fraction * (1 - self.ungated.false_fraction)

    @property
    def right_share(self) -> float:
        """Of the frame, the pixels with a right height."""
        return self.kept_share - self.false_share

    @property
    def kept_share(self) -> float:
        """Of the frame, the pixels with a height."""
        return self.whole.completeness_fraction

    @property
    def false_share(self) -> float:
        """Of the frame, the pixels with a false height."""
        return self.kept_share * self.whole.false_fraction if self.kept_share > 0 else 0.0


@dataclass(frozen=True)
class JudgedScene:
    """What a scene is, and what each measure makes of it."""

    seed: int
    about: str
    found: dict[str, Judged]


def show_scenes(count: int, first_seed: int, measures: Sequence[str], one_by_one: bool) -> None:
    """Print kept and false shares over a range of seeds, the two renderers apart and together."""
    seeds = range(first_seed, first_seed + count)
    with ProcessPoolExecutor() as pool:
        scenes = list(pool.map(partial(judge_scene, measures=measures), seeds))
    if one_by_one:
        show_each(scenes)
    rows = []
    for renderer, parities in RENDERERS.items():
        chosen = [scene for scene in scenes if scene.seed % 2 in parities]
        rows += [(f"{renderer}, {m}", len(chosen), *summary([s.found[m] for s in chosen])) for m in measures if chosen]
    show(f"Scenes of seeds {seeds[0]} to {seeds[-1]} ({use_of(first_seed)})", HEADER, rows)


def show_each(scenes: Sequence[JudgedScene]) -> None:
    """Print a row for each scene and measure."""
    rows = [
        (f"{scene.seed} {scene.about}, {measure}", *one_row(found))
        for scene in scenes
        for measure, found in scene.found.items()
    ]
    show("Scene by scene", ("scene, measure", "kept %", "known %", "false %", "interior", "RMSE um"), rows)


def show_path_traced(count: int, first_seed: int, measures: Sequence[str], one_by_one: bool) -> None:
    """Print kept and false shares over a range of seeds of path-traced scenes; their paths use all cores already."""
    scenes = [judge_scene(seed, measures, path_traced_scene) for seed in range(first_seed, first_seed + count)]
    if one_by_one:
        show_each(scenes)
    rows = [(f"path tracer, {m}", count, *summary([s.found[m] for s in scenes])) for m in measures]
    show(f"Path-traced scenes of seeds {first_seed} to {first_seed + count - 1}", HEADER, rows)


def judge_scene(seed: int, measures: Sequence[str], draw: Callable[[int], Unseen] = drawn_scene) -> JudgedScene:
    """Reconstruct a scene by several measures."""
    scene = draw(seed)
    inside_um = np.where(scene.interior, scene.truth_um, np.float32(np.nan))
    found = {}
    for measure in measures:
        gated, searched = (reconstruct(scene.stack, r, threads=1) for r in (MEASURES[measure], ungated(measure)))
        found[measure] = Judged(
            quality(gated.to_measure(), scene.truth_um, scene.limit_um),
            quality(gated.to_measure(), inside_um, scene.limit_um),
            quality(searched.to_measure(), scene.truth_um, scene.limit_um),
        )
    return JudgedScene(seed, scene.about, found)


def one_row(found: Judged) -> tuple[str | float, ...]:
    """Shares of a scene; those of false heights, of what is kept, are empty where nothing is."""
    shares = (found.kept_share, found.known_share, found.whole.false_fraction, found.interior.false_fraction)
    return (*(percent(share, 2) for share in shares), found.whole.true_rmse_um)


def summary(found: Sequence[Judged]) -> tuple[str | float | int | None, ...]:
    """Means over scenes; false shares, of the scenes where anything is kept, also as median, worst tenth and worst."""
    kept, right, known, false_px = np.array(
        [(one.kept_share, one.right_share, one.known_share, one.false_share) for one in found]
    ).T
    false = np.sort([one.whole.false_fraction for one in found if one.kept_share > 0])
    of_known = right.sum() / known.sum() if known.sum() > 0 else np.nan
    head = (len(found) - len(false), percent(float(kept.mean()), 2), percent(float(of_known), 1))
    if not len(false):
        return (*head, *(None,) * 7)
    worst = false[-max(1, len(false) // 10) :]
    interior = np.array([one.interior.false_fraction for one in found])
    inner = float(np.mean(interior[np.isfinite(interior)])) if np.isfinite(interior).any() else np.nan
    shares = (false.mean(), np.median(false), worst.mean(), worst[-1], inner, false_px.sum() / kept.sum())
    rmse_um = float(np.nanmedian([one.whole.true_rmse_um for one in found]))
    return (*head, *(percent(float(share), 2) for share in shares), rmse_um)
