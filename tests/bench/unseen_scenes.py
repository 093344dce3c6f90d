"""How right the heights are on scenes drawn by seed, with the defaults of the measures."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from tests.bench.recipes import MEASURES
from tests.bench.tables import percent, show
from tests.truth.unseen import FIRST_REPORTED_SEED, drawn_scene
from wafer_viewer.measure.truth_comparison import Quality, quality
from wafer_viewer.reconstruct.field_pipeline import reconstruct

Judged = tuple[Quality, Quality]
"""Of the whole frame, and of its interior."""
RENDERERS = {"layers blurred by FFT": 0, "rays past walls": 1}
HEADER = (
    "renderer, measure", "scenes", "of them empty", "kept %", "false %", "median", "worst tenth", "worst", "interior",
    "RMSE um",
)  # fmt: skip


def show_scenes(count: int, first_seed: int, measures: list[str], one_by_one: bool) -> None:
    """Print kept and false shares over a range of seeds, the two renderers apart."""
    seeds = range(first_seed, first_seed + count)
    with ProcessPoolExecutor() as pool:
        judged = list(pool.map(partial(judge_scene, measures=measures), seeds))
    if one_by_one:
        rows = [
            (f"{seed} {about}, {measure}", *percents(figures(found)), found[0].true_rmse_um)
            for seed, (about, of_measures) in zip(seeds, judged, strict=True)
            for measure, found in of_measures.items()
        ]
        show("Scene by scene", ("scene, measure", "kept %", "false %", "interior", "RMSE um"), rows)
    rows = []
    for renderer, parity in RENDERERS.items():
        chosen = [found for seed, (_, found) in zip(seeds, judged, strict=True) if seed % 2 == parity]
        if chosen:
            rows += [(f"{renderer}, {m}", len(chosen), *summary([found[m] for found in chosen])) for m in measures]
    kind = "reported" if first_seed >= FIRST_REPORTED_SEED else "for tuning"
    show(f"Scenes of seeds {seeds[0]} to {seeds[-1]} ({kind})", HEADER, rows)


def judge_scene(seed: int, measures: list[str]) -> tuple[str, dict[str, Judged]]:
    """Return what the scene is, and what each measure makes of it."""
    scene = drawn_scene(seed)
    inside_um = np.where(scene.interior, scene.truth_um, np.float32(np.nan))
    found = {}
    for measure in measures:
        z_um = reconstruct(scene.stack, MEASURES[measure], threads=1).to_measure()
        whole, interior = (quality(z_um, truth_um, scene.limit_um) for truth_um in (scene.truth_um, inside_um))
        found[measure] = whole, interior
    return scene.about, found


def figures(found: Judged) -> tuple[float, ...]:
    """Kept share, false share of what is kept, and false share of the interior; NaN where nothing is kept."""
    whole, interior = found
    return whole.completeness_fraction, whole.false_fraction, interior.false_fraction


def summary(found: list[Judged]) -> tuple[str | float | int, ...]:
    """Means over scenes; false shares, of the scenes where anything is kept, also as median, worst tenth and worst."""
    kept, false, interior = np.array([figures(one) for one in found]).T
    empty = int(np.isnan(false).sum())
    false = np.sort(false[np.isfinite(false)])
    if not false.size:
        return (empty, percent(float(kept.mean()), 2), *(None,) * 6)
    worst = false[-max(1, len(false) // 10) :]
    shares = (kept.mean(), false.mean(), np.median(false), worst.mean(), worst[-1], np.nanmean(interior))
    return (empty, *percents(shares), float(np.nanmedian([whole.true_rmse_um for whole, _ in found])))


def percents(shares: Iterable[float]) -> tuple[str, ...]:
    """Return shares as percentages."""
    return tuple(percent(float(share), 2) for share in shares)
