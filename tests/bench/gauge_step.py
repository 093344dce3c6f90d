"""The certified step of the paper's gauge blocks, 399.88 um, from 4 um steps through the whole chain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.bench import paper
from tests.bench.recipes import DEFAULT
from tests.bench.seen import seen
from tests.bench.tables import met, show
from tests.truth.layouts import PILLBOX, Layout
from tests.truth.scenes import BLOCKS_STEP_UM, STEP_SWEEP_UM
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.region import Region
from wafer_viewer.reconstruct.field_pipeline import reconstruct

GOAL_UM = 0.05


def show_step(quick: bool) -> None:
    """The paper's Table 4, and the mean error and its spread over samples."""
    seeds, side = (range(2), 72) if quick else (range(20), 96)
    header = ("paper", *paper.METHODS)
    show("Height of the gauge blocks' step, certified 399.88 um: Table 4", header, paper.rows(paper.BLOCKS_HEIGHT))
    errors_um = {
        where: np.array([step_error_um(stack_of(seed, side)) for seed in seeds]) for where, stack_of in STEPS.items()
    }
    rows = [
        (where, f"{BLOCKS_STEP_UM + e.mean():.3f}", *(f"{v:+.4f}" for v in (e.mean(), e.std(ddof=1), np.abs(e).max())))
        for where, e in errors_um.items()
    ]
    header = ("where", "height", "mean error", "spread", "largest error")
    show(f"Ours, default recipe, {len(seeds)} samples, um", header, rows)
    mean_um = abs(float(errors_um["faces alone"].mean()))
    print(f"mean error of the faces alone: {mean_um:.4f} um, goal {GOAL_UM} um {met(mean_um, GOAL_UM)}")


def faces(seed: int, side: int) -> FieldStack:
    """Both faces farther from the wall than its shadow reaches, 117 um, side by side in one field."""
    lower_um = lower_face_um(seed)
    parts = [
        seen(
            Layout(f"face-{n}", PILLBOX, 700 + 2 * seed + n, scene="plane", settings={"tilt": 0.0, "middle_um": z}),
            side,
            STEP_SWEEP_UM,
        ).stack
        for n, z in enumerate((lower_um, lower_um + BLOCKS_STEP_UM))
    ]
    images = np.concatenate([part.images for part in parts], axis=2)
    return replace(parts[0], images=images)


def beside_the_wall(seed: int, side: int) -> FieldStack:
    """Where the wall hides up to half of the aperture from the lower face, and the upper face's light falls on it."""
    settings = {"step_um": BLOCKS_STEP_UM, "lower_um": lower_face_um(seed)}
    return seen(Layout("blocks", PILLBOX, 500 + seed, scene="step", settings=settings), side, STEP_SWEEP_UM).stack


STEPS: dict[str, Callable[[int, int], FieldStack]] = {
    "faces alone": faces,
    "within 22 um of the wall": beside_the_wall,
}


def lower_face_um(seed: int) -> float:
    """Another place between two frames for every seed."""
    return 50.0 + 4.0 * ((0.618 * seed) % 1)


def step_error_um(stack: FieldStack) -> float:
    height = reconstruct(stack, DEFAULT)
    x0, y0, x1, y1 = height.bounds_um
    gap_um = 10.0
    lower = Region.rectangle(x0 + 2, y0 + 2, -gap_um, y1 - 2)
    upper = Region.rectangle(gap_um, y0 + 2, x1 - 2, y1 - 2)
    return step_height(height, upper, lower).height.value_um - BLOCKS_STEP_UM
