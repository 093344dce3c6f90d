"""How often the uncertainty of a single pixel covers the truth: errors of heights over their u, scene by scene.

    python tests/bench/bench_pixel_u.py [--quick] [--seed N] [--count N] [--measure NAME] [--each]

Scenes with a known truth: tilted planes with noise (`tests.truth.phase`), by the step in depths of field, contrast and
full well; and scenes drawn by seed (`tests.truth.unseen`), where interior pixels count that are not false. Of each
scene: rms of error / u, the share within 2 u, and the median of |error| / u over that of a normal distribution. The
goal: 93 to 97 % within 2 u, median 0.8 to 1.2. Seeds below 1000 are for tuning.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tests.bench.harness import percent, read_options, show
from tests.truth.phase import Tilted, stairs
from tests.truth.unseen import FIRST_REPORTED_SEED, drawn_scene, use_of
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct

STEPS_DOF, CONTRASTS, FULL_WELLS = (0.2, 0.45, 0.75, 0.9), (0.25, 0.12, 0.04), (6e3, 15e3, 40e3)
QUICK_STEPS_DOF, QUICK_CONTRASTS, QUICK_FULL_WELLS = (0.45, 0.9), (0.12,), (6e3,)
SCENES, QUICK_SCENES = 40, 2
MARGIN_PX = 24
"""Border of a plane in stairs that does not count."""
NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal variable."""
LEAST_PIXELS = 200
"""Smallest number of pixels of a scene that is judged."""
SOUND, FAULTY = "frames without faults", "frames with jitter, drift or flicker"
"""Faults of the frames that a scene of level faces may hide: what they add to u is known only as far as it shows."""
WITHIN, MEDIAN = (0.93, 0.97), (0.8, 1.2)


@dataclass(frozen=True, slots=True)
class Honesty:
    """Errors over u of the pixels of a scene: rms, share within 2, median over that of a normal variable; pixels."""

    rms: float
    within: float
    median: float
    pixels: int
    u_um: float

    @classmethod
    def of(cls, surface: HeightMap, truth_um: NDArray[np.floating], counts: NDArray[np.bool_]) -> Honesty | None:
        """Judge the pixels that count; None where too few have an uncertainty."""
        error_um, u_um = surface.z_raw_um - truth_um, surface.u_um
        if u_um is None:
            return None
        known = counts & np.isfinite(error_um) & np.isfinite(u_um)
        if np.count_nonzero(known) < LEAST_PIXELS:
            return None
        over = np.abs(error_um[known] / u_um[known])
        median = float(np.median(over)) / NORMAL_MEDIAN
        rms, within = float(np.sqrt(np.mean(over**2))), float(np.mean(over <= 2))
        return cls(rms, within, median, len(over), float(np.median(u_um[known])))


def plane_honesty(scene: Tilted, measure: str = "log_laplacian") -> Honesty | None:
    """Judge a tilted plane, apart from heights that are a step and half a depth of field off.

    Its stairs of four pixels are finer than a focus window: the truth is the line through them.
    """
    seen = stairs(scene)
    surface = reconstruct(seen.stack, Recipe(focus_measure=measure), threads=1)
    cols = np.arange(surface.shape[1])
    truth_um = np.broadcast_to(np.polyval(np.polyfit(cols, seen.truth_um, 1), cols), surface.shape)
    limit_um = max(scene.step_um, scene.depth_of_field_um / 2)
    counts = np.zeros(surface.shape, bool)
    counts[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = True
    return Honesty.of(surface, truth_um, counts & (np.abs(surface.z_raw_um - truth_um) < limit_um))


def drawn_honesty(seed: int, measure: str = "log_laplacian") -> tuple[str, Honesty | None]:
    """Judge a drawn scene: its interior without false heights; with what it is."""
    scene = drawn_scene(seed)
    surface = reconstruct(scene.stack, Recipe(focus_measure=measure), threads=1)
    right = np.abs(surface.z_raw_um - scene.truth_um) < scene.limit_um
    instrument = scene.instrument
    faulty = instrument.jitter_dof > 0 or instrument.flicker > 0 or any(instrument.drift_px)
    return (
        f"{seed} {scene.about}, {FAULTY if faulty else SOUND}",
        Honesty.of(surface, scene.truth_um, scene.interior & right),
    )


def planes(seed: int, quick: bool) -> Iterator[tuple[str, Tilted]]:
    """Planes by step, contrast and full well, with an aperture and a texture of their own each."""
    steps, contrasts, wells = (
        (QUICK_STEPS_DOF, QUICK_CONTRASTS, QUICK_FULL_WELLS) if quick else (STEPS_DOF, CONTRASTS, FULL_WELLS)
    )
    for n, (step, contrast, well) in enumerate(product(steps, contrasts, wells)):
        scene = Tilted(na=(0.2, 0.28, 0.38, 0.45)[n % 4], step_dof=step, contrast=contrast, full_well_e=well)
        name = f"step {step:g} DOF, contrast {100 * contrast:g} %, {well / 1000:g} ke"
        yield name, replace(scene, seed=seed + n)


def row(found: Honesty) -> tuple[str | float, ...]:
    """Figures of a scene."""
    return f"{found.rms:.2f}", percent(found.within), f"{found.median:.2f}", f"{found.u_um:.3f}", found.pixels


def summary(found: list[Honesty]) -> tuple[str | float, ...]:
    """Figures of several scenes: medians over the scenes, and how many of them reach the goal."""
    within, median, rms = (np.array([getattr(one, name) for one in found]) for name in ("within", "median", "rms"))
    tenth = percent(float(np.percentile(within, 10)))
    low, high = WITHIN
    right = int(np.count_nonzero((median >= MEDIAN[0]) & (median <= MEDIAN[1])))
    return (
        len(found),
        f"{np.median(rms):.2f}",
        percent(float(np.median(within))),
        tenth,
        f"{np.count_nonzero(within < low)} / {np.count_nonzero(within > high)}",
        f"{np.median(median):.2f}",
        f"{right} of {len(found)}",
    )


SUMMARY = "scenes | number | rms error / u | within 2 u % | worst tenth | below / above goal | median | 0.8..1.2"
EACH = "scene | rms error / u | within 2 u % | median | u um | pixels"


def main() -> None:
    asked = read_options(
        __doc__,
        seed=FIRST_REPORTED_SEED,
        count={"type": int, "help": "drawn scenes"},
        measure={"choices": tuple(focus_measures()), "default": "log_laplacian"},
        each=False,
    )
    count = (QUICK_SCENES if asked.quick else SCENES) if asked.count is None else asked.count
    names, tilted = zip(*planes(asked.seed, asked.quick), strict=True)
    with ProcessPoolExecutor() as pool:
        flat = list(zip(names, pool.map(partial(plane_honesty, measure=asked.measure), tilted), strict=True))
        seeds = range(asked.seed, asked.seed + count)
        drawn = list(pool.map(partial(drawn_honesty, measure=asked.measure), seeds))
    if asked.each:
        show("Scene by scene", EACH, [(name, *row(one)) for name, one in (*flat, *drawn) if one is not None])
    by_step = {f"planes, step {step:g} DOF": f"step {step:g} DOF" for step in STEPS_DOF}
    by_contrast = {f"planes, contrast {100 * contrast:g} %": f"contrast {100 * contrast:g} %" for contrast in CONTRASTS}
    by_frames = {f"drawn, {frames}": frames for frames in (SOUND, FAULTY)}
    scenes = (*flat, *drawn)
    groups = {
        title: [one for name, one in scenes if word in name]
        for title, word in {**by_step, **by_contrast, **by_frames}.items()
    }
    judged = {name: [one for one in group if one is not None] for name, group in groups.items()}
    rows = [(name, *summary(group)) for name, group in judged.items() if group]
    show(f"{asked.measure}, SIMULATED scenes, seeds from {asked.seed} ({use_of(asked.seed)})", SUMMARY, rows)


if __name__ == "__main__":
    main()
