"""The certified step of the paper's gauge blocks, 399.88 um, from 4 um steps through the whole chain."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

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
    """The mean error and its spread over samples."""
    seeds, side = (range(2), 72) if quick else (range(20), 96)
    errors_um = {where: measured(height_of(seed, side) for seed in seeds) for where, height_of in STEPS.items()}
    rows = [
        (where, f"{len(e)} of {len(seeds)}", f"{BLOCKS_STEP_UM + e.mean():.3f}", *signed(e))
        for where, e in errors_um.items()
    ]
    header = ("where", "measured", "height", "mean error", "spread", "largest error")
    show(f"Step of 399.88 um, default recipe, {len(seeds)} samples, um", header, rows)
    mean_um = abs(float(errors_um["faces alone"].mean()))
    print(f"mean error of the faces alone: {mean_um:.4f} um, goal {GOAL_UM} um {met(mean_um, GOAL_UM)}")


def measured(heights: Iterable[HeightMap]) -> NDArray[np.float64]:
    """Errors of the step, of the samples where half of each face or more is measured."""
    errors_um = []
    for height in heights:
        with suppress(MeasureError):
            errors_um.append(step_error_um(height))
    return np.array(errors_um)


def signed(errors_um: NDArray[np.float64]) -> tuple[str, ...]:
    """Mean, spread and largest amount, as far as there are enough."""
    if len(errors_um) < 2:
        return ("",) * 3
    return tuple(f"{v:+.4f}" for v in (errors_um.mean(), errors_um.std(ddof=1), np.abs(errors_um).max()))


def faces(seed: int, side: int) -> HeightMap:
    """A field on each face, farther from the wall than its shadow reaches, 117 um."""
    lower_um = lower_face_um(seed)
    settings = [{"tilt": 0.0, "middle_um": z} for z in (lower_um, lower_um + BLOCKS_STEP_UM)]
    layouts = [
        Layout(f"face-{n}", PILLBOX, 700 + 2 * seed + n, scene="plane", settings=at) for n, at in enumerate(settings)
    ]
    return beside(*(reconstruct(seen(layout, side, STEP_SWEEP_UM).stack, DEFAULT) for layout in layouts))


def beside(left: HeightMap, right: HeightMap) -> HeightMap:
    """Two fields as one map."""
    layers = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin", "u_um")
    both = {name: np.concatenate([getattr(left, name), getattr(right, name)], axis=1) for name in layers}
    return replace(left, refused=None, x0_um=-left.shape[1] * left.pixel_um, **both)


def beside_the_wall(seed: int, side: int) -> HeightMap:
    """Where the wall hides up to half of the aperture from the lower face, and the upper face's light falls on it."""
    settings = {"step_um": BLOCKS_STEP_UM, "lower_um": lower_face_um(seed)}
    layout = Layout("blocks", PILLBOX, 500 + seed, scene="step", settings=settings)
    return reconstruct(seen(layout, side, STEP_SWEEP_UM).stack, DEFAULT)


STEPS: dict[str, Callable[[int, int], HeightMap]] = {
    "faces alone": faces,
    "within 22 um of the wall": beside_the_wall,
}


def lower_face_um(seed: int) -> float:
    """Another place between two frames for every seed."""
    return 50.0 + 4.0 * ((0.618 * seed) % 1)


def step_error_um(height: HeightMap) -> float:
    """Height of the step less the certified one; a MeasureError where less than half of a face is measured."""
    x0, y0, x1, y1 = height.bounds_um
    gap_um = 10.0
    lower = Region.rectangle(x0 + 2, y0 + 2, -gap_um, y1 - 2)
    upper = Region.rectangle(gap_um, y0 + 2, x1 - 2, y1 - 2)
    return step_height(height, upper, lower).height.value_um - BLOCKS_STEP_UM
