"""The methods that the benchmarks compare, and the default with its gates taken off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.recipe import Fill, Outliers, Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.focus.sml_tenengrad_glv import focus_image

WINDOW = 9


@dataclass(frozen=True, eq=False)
class Found:
    """What a method says: heights that it vouches for, heights with all its smoothing and filling, its picture."""

    raw_um: NDArray[np.float32]
    z_um: NDArray[np.float32]
    all_in_focus: NDArray


Method = Callable[[FieldStack], Found]


def by_recipe(recipe: Recipe, stack: FieldStack) -> Found:
    height = reconstruct(stack, recipe, threads=1)
    return Found(height.to_measure(), height.z_um, height.all_in_focus)


def plain(measure: str, stack: FieldStack) -> Found:
    """Eq. 6: every pixel has a height, that of its sharpest frame."""
    best = np.full(stack.images.shape[1:], -np.inf, np.float32)
    z_um, picture = np.zeros(best.shape, np.float32), np.zeros(best.shape, stack.images.dtype)
    for z, image in zip(stack.z_um, stack.images, strict=True):
        sharp = focus_image(image, measure, WINDOW)
        better = sharp > best
        best[better], z_um[better], picture[better] = sharp[better], z, image[better]
    return Found(z_um, z_um, picture)


DEFAULT = Recipe()

CLASSIC = ("glv", "sml", "tenengrad")
"""The measures of the paper."""
BASELINE = "plain tenengrad argmax"
METHODS: dict[str, Method] = {
    **{f"plain {m} argmax": partial(plain, m) for m in CLASSIC},
    "paper's recipe": partial(by_recipe, Recipe.paper()),
    "default": partial(by_recipe, DEFAULT),
    "default, every gap filled": partial(by_recipe, replace(DEFAULT, fill=Fill(mode="all"))),
}


def ungated(measure: str) -> Recipe:
    """A height and a confidence for every pixel but those whose peak is at an end of the range."""
    return replace(
        DEFAULT,
        focus_measure=measure,
        min_confidence=0.0,
        clipped_fraction=1.0,
        compare_windows=False,
        edges="none",
        outliers=Outliers(mode="none"),
    )


MEASURES: dict[str, Recipe] = {measure: replace(DEFAULT, focus_measure=measure) for measure in focus_measures()}

GATES: dict[str, dict[str, object]] = {
    "less rims that are seen from above": {"edges": "band"},
    "less the band beside edges": {"edges": "none"},
    "less the second window": {"compare_windows": False},
    "less outlier removal": {"outliers": Outliers(mode="none")},
    "less clipping": {"clipped_fraction": 1.0},
    "less confidence: no gate": {"min_confidence": 0.0},
}


def less_and_less() -> dict[str, Recipe]:
    """The default with its gates taken off, one more in each recipe."""
    recipes, recipe = {"default": DEFAULT}, DEFAULT
    for name, change in GATES.items():
        recipe = recipes[name] = replace(recipe, **change)
    return recipes


ABLATION: dict[str, Recipe] = less_and_less()
