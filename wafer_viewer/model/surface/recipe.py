"""How a stack becomes a surface: every choice of the reconstruction, each of them settable."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import msgspec

from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.model.spec import Positive, Spec, Within, replace

Auto = Literal["auto"]
Window = Annotated[int, Within(3, 25, odd=True)]


class Levy(Spec, frozen=True, kw_only=True):
    """Smoothing: Levy flights, eq. 7-14 of the paper, which keep the noise (`literal`), or forms that remove it.

    n_sigma: what is further from its neighbourhood than so many deviations of the field's own noise stands out;
    alpha: the scale of the flights, in um (`literal`) or in distances to the guide (`guided`).
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Literal["none", "literal", "guided", "switching_median", "sigma_filter"] = "sigma_filter"
    n_sigma: Positive | Auto = "auto"
    alpha: Positive | Auto = "auto"
    beta: Annotated[float, Within(0, 2, open_low=True)] = 1.5
    iterations: Annotated[int, Within(1, 1000)] | Auto = "auto"
    seed: Annotated[int, Within(0)] = 1


class Outliers(Spec, frozen=True, kw_only=True):
    """Statistical outlier removal: a point further from its neighbours than mean + n_sigma deviations is dropped.

    The threshold is never under `floor_um` (``auto``: from the step of the sweep), so that it cannot eat step edges.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Literal["none", "lattice", "cloud"] = "lattice"
    neighbours: Annotated[int, Within(4, 64)] = 15
    n_sigma: Positive = 3.0
    floor_um: Positive | Auto = "auto"


class Fill(Spec, frozen=True, kw_only=True):
    """Spline fill of gaps up to `max_gap_px` along rows and columns, never across a step; `all`: as the paper does.

    Filled pixels are marked.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Literal["none", "small_gaps", "all"] = "small_gaps"
    max_gap_px: Annotated[int, Within(1, 10000)] = 9


class Noise(Spec, frozen=True, kw_only=True):
    """The camera's noise: the variance of a grey is gain_counts x grey + floor_counts2; ``auto`` asks the stack."""

    error: ClassVar[type[WaferViewerError]] = ComputeError
    gain_counts: Positive | Auto = "auto"
    floor_counts2: Positive | Auto = "auto"


class Stitching(Spec, frozen=True, kw_only=True):
    """How fields become one surface: where they are placed and how overlaps are blended.

    poses: found from the overlaps (`registered`), with the stage as prior, or those of the stage; blend: by confidence,
    fading out towards a field's border, or the paper's linear ramps along X and Y (eq. 15-16).
    stage_error_um, z_error_um, tilt_error: how far the stage is off as a rule, standard deviations (tilt in um per um);
    search_um: how far from the stage's word a neighbour is looked for. ``auto`` asks the overlaps.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    poses: Literal["registered", "stage"] = "registered"
    blend: Literal["confidence", "ramp"] = "confidence"
    search_um: Positive | Auto = "auto"
    stage_error_um: Positive | Auto = "auto"
    z_error_um: Positive | Auto = "auto"
    tilt_error: Positive | Auto = "auto"


class Recipe(Spec, frozen=True, kw_only=True):
    """Every choice from stack to surface. A result carries the recipe with the values that ``auto`` chose.

    focus_width_um: how wide a focus curve is at half its height; rivals, flanks and edges are judged by it;
    drift: whether frames that shifted or grew by more than half a pixel are put right, each field by what it shows;
    compare_windows: whether a height must be that of a window twice as wide; edges: beside walls between bright and
    dark heights are not looked into (`none`), must agree with the surface further from the wall (`band`), or are
    looked for once more along the wall as well (`rims`).
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    drift: Literal["none", "correct"] = "correct"
    focus_measure: Literal["log_laplacian", "tenengrad", "sml", "glv"] = "log_laplacian"
    window: Window | Auto = "auto"
    peak: Literal["argmax", "gaussian", "tent", "blur_law"] = "blur_law"
    focus_width_um: Positive | Auto = "auto"
    min_confidence: Annotated[float, Within(0, 1)] | Auto = "auto"
    clipped_fraction: Annotated[float, Within(0, 1)] = 0.3
    compare_windows: bool = True
    edges: Literal["none", "band", "rims"] = "rims"
    noise: Noise = Noise()
    levy: Levy = Levy()
    outliers: Outliers = Outliers()
    fill: Fill = Fill()
    stitching: Stitching = Stitching()
    measure_on: Literal["unsmoothed", "smoothed"] = "unsmoothed"

    @classmethod
    def paper(cls) -> Recipe:
        """The paper's method step by step: plain argmax, its filter as printed, outliers by the cloud, all filled.

        The paper leaves window, step size, iterations and thresholds open ("tuned by hand"): these are ours.
        """
        return cls(
            focus_measure="tenengrad",
            window=9,
            peak="argmax",
            drift="none",
            min_confidence=0.0,
            clipped_fraction=1.0,
            compare_windows=False,
            edges="none",
            levy=Levy(mode="literal", n_sigma=3.0, alpha=0.5, beta=1.5, iterations=30),
            outliers=Outliers(mode="cloud", n_sigma=1.0, floor_um=0.001),
            fill=Fill(mode="all"),
            stitching=Stitching(poses="stage", blend="ramp"),
            measure_on="smoothed",
        )

    @property
    def has_auto(self) -> bool:
        """Whether any choice is left to the data."""
        return "auto" in _values(msgspec.to_builtins(self))

    @property
    def heights_have_auto(self) -> bool:
        """Whether any choice is left to the data on the way to the heights of a field."""
        return replace(self, stitching=_STAGE_ONLY).has_auto

    def makes_heights_of(self, other: Recipe) -> bool:
        """Whether it makes the same heights of a field as another; they may be stitched differently."""
        return replace(self, stitching=_STAGE_ONLY) == replace(other, stitching=_STAGE_ONLY)


_STAGE_ONLY = Stitching(search_um=1.0, stage_error_um=1.0, z_error_um=1.0, tilt_error=1.0)
"""Nothing in it is left to the data."""


def _values(data: object) -> list[object]:
    return [v for item in data.values() for v in _values(item)] if isinstance(data, dict) else [data]


READY_RECIPES: dict[str, Recipe] = {"default": Recipe(), "paper": Recipe.paper()}
"""Recipes that go by a name."""
