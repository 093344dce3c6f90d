"""How right the heights are on scenes drawn by seed, with the defaults of every measure."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from tests.bench.recipes import MEASURES
from tests.bench.tables import percent, show
from tests.truth.unseen import FIRST_REPORTED_SEED, drawn_scene
from wafer_viewer.reconstruct.field_pipeline import reconstruct

Judged = tuple[float, float, float, float]
"""Kept share, false share, false share of the interior, and RMSE in um of what is not false."""
RENDERERS = {"layers blurred by FFT": 0, "rays past walls": 1}
HEADER = ("renderer, measure", "scenes", "kept %", "false %", "median", "worst tenth", "worst", "interior", "RMSE um")


def show_scenes(count: int, first_seed: int, measures: list[str], one_by_one: bool) -> None:
    """Print kept and false shares over a range of seeds, the two renderers apart."""
    seeds = range(first_seed, first_seed + count)
    with ProcessPoolExecutor() as pool:
        judged = list(pool.map(partial(judge_scene, measures=measures), seeds))
    if one_by_one:
        rows = [
            (f"{seed} {about}, {measure}", *percents(found[:3]), found[3])
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
    found = {}
    for measure in measures:
        z_um = reconstruct(scene.stack, MEASURES[measure], threads=1).to_measure()
        kept, off_um = np.isfinite(z_um), np.abs(z_um - scene.truth_um)
        false = kept & (off_um > scene.limit_um)
        interior = kept & scene.interior
        true_um = off_um[kept & ~false]
        rmse_um = float(np.sqrt(np.mean(true_um**2))) if true_um.size else np.nan
        shares = (part.sum() / max(1, whole.sum()) for part, whole in ((false, kept), (false & interior, interior)))
        found[measure] = (float(kept.mean()), *map(float, shares), rmse_um)
    return scene.about, found


def summary(found: list[Judged]) -> tuple[str | float, ...]:
    """Means over scenes; false shares also as median, mean of the worst tenth, and worst."""
    kept, false, interior, rmse_um = np.array(found).T
    worst = np.sort(false)[-max(1, len(false) // 10) :]
    shares = (kept.mean(), false.mean(), np.median(false), worst.mean(), worst[-1], interior.mean())
    return (*percents(shares), float(np.nanmedian(rmse_um)) if np.isfinite(rmse_um).any() else np.nan)


def percents(shares: tuple[float, ...]) -> tuple[str, ...]:
    """Return shares as percentages."""
    return tuple(percent(float(share), 2) for share in shares)
