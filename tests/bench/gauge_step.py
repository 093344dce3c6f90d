"""The certified step of the paper's gauge blocks, 399.88 um, from 4 um steps through the whole chain."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tests.bench.bench_step import EXACT
from tests.bench.harness import met, show
from tests.bench.recipes import DEFAULT
from tests.bench.seen import seen
from tests.truth.layouts import PILLBOX, Layout
from tests.truth.scenes import BLOCKS_STEP_UM, STEP_SWEEP_UM
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.field_pipeline import reconstruct

GOAL_UM = 0.05


def show_step(quick: bool) -> None:
    """The mean error, its spread and U over samples: 399.88 um are 99.97 frames, 401.88 um half a frame more."""
    seeds, side = (range(2), 72) if quick else (range(20), 96)
    found = {where: measured(height_of(seed, side) for seed in seeds) for where, height_of in STEPS.items()}
    rows = [(where, f"{len(f)} of {len(seeds)}", *told(f)) for where, f in found.items()]
    header = ("where", "measured", "mean error", "spread", "largest error", "mean U", "within U")
    show(f"Step of 399.88 um, default recipe, {len(seeds)} samples, um", header, rows)
    mean_um = abs(float(found["faces alone"][:, 0].mean()))
    print(f"mean error of the faces alone: {mean_um:.4f} um, goal {GOAL_UM} um {met(mean_um, GOAL_UM)}")


def measured(heights: Iterable[tuple[HeightMap, float]]) -> NDArray[np.float64]:
    """Errors of the step and their U, [n, 2], of the samples where half of each face or more is measured."""
    found = []
    for height, step_um in heights:
        with suppress(MeasureError):
            found.append(step_of(height, step_um))
    return np.array(found).reshape(-1, 2)


def told(found: NDArray[np.float64]) -> tuple[str, ...]:
    """Mean, spread and largest amount of the errors, mean U and how many it covers, as far as there are enough."""
    if len(found) < 2:
        return ("",) * 5
    error, expanded = found.T
    within = np.count_nonzero(np.abs(error) <= expanded)
    numbers = (error.mean(), error.std(ddof=1), np.abs(error).max())
    return (*(f"{v:+.4f}" for v in numbers), f"{expanded.mean():.3f}", f"{within} of {len(found)}")


def faces(seed: int, side: int, more_um: float = 0.0) -> tuple[HeightMap, float]:
    """A field on each face, farther from the wall than its shadow reaches, 117 um."""
    lower_um, step_um = lower_face_um(seed), BLOCKS_STEP_UM + more_um
    levels_um = lower_um, lower_um + step_um
    layouts = [
        Layout(
            f"face-{n}-{more_um:g}", PILLBOX, 700 + 2 * seed + n, scene="plane", settings={"tilt": 0.0, "middle_um": z}
        )
        for n, z in enumerate(levels_um)
    ]
    return beside(*(height_map(layout, side) for layout in layouts)), step_um


def height_map(layout: Layout, side: int) -> HeightMap:
    """The heights of a layout, by an exact z scale."""
    return reconstruct(replace(seen(layout, side, STEP_SWEEP_UM).stack, calibration=EXACT), DEFAULT)


def beside(left: HeightMap, right: HeightMap) -> HeightMap:
    """Two fields as one map."""
    layers = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin", "u_um")
    both = {name: np.concatenate([getattr(left, name), getattr(right, name)], axis=1) for name in layers}
    return replace(left, refused=None, x0_um=-left.shape[1] * left.pixel_um, **both)


def beside_the_wall(seed: int, side: int, wider: float = 1.0) -> tuple[HeightMap, float]:
    """Where the wall hides up to half of the aperture from the lower face, and the upper face's light falls on it."""
    settings = {"step_um": BLOCKS_STEP_UM, "lower_um": lower_face_um(seed)}
    layout = Layout("blocks", PILLBOX, 500 + seed, scene="step", settings=settings)
    return height_map(layout, round(wider * side)), BLOCKS_STEP_UM


STEPS: dict[str, Callable[[int, int], tuple[HeightMap, float]]] = {
    "faces alone": faces,
    "faces alone, 401.88 um": partial(faces, more_um=2.0),
    "within 22 um of the wall, field of 45 um": beside_the_wall,
    "within 52 um of the wall, field of 105 um": partial(beside_the_wall, wider=7 / 3),
}


def lower_face_um(seed: int) -> float:
    """Another place between two frames for every seed."""
    return 50.0 + 4.0 * ((0.618 * seed) % 1)


def step_of(height: HeightMap, step_um: float) -> tuple[float, float]:
    """Error of the step and its U; a MeasureError where less than half of a face is measured."""
    x0, y0, x1, y1 = height.bounds_um
    gap_um = 10.0
    lower = Region.rectangle(x0 + 2, y0 + 2, -gap_um, y1 - 2)
    upper = Region.rectangle(gap_um, y0 + 2, x1 - 2, y1 - 2)
    found = step_height(height, upper, lower).height
    return found.value_um - step_um, float(found.expanded_um or np.nan)
