"""Recipes: all settings of the reconstruction from focus stack to surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import msgspec

from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.model.spec import Positive, Spec, Within, replace
from wafer_viewer.model.surface.focus_measures import focus_measures

Auto = Literal["auto"]
Window = Annotated[int, Within(3, 25, odd=True)]
if TYPE_CHECKING:
    FocusMeasureName = str
else:
    FocusMeasureName = Literal[tuple(focus_measures())]


class Levy(Spec, frozen=True, kw_only=True):
    """Smoothing: Levy flights, eq. 7-14 of the paper, which do not reduce noise (`literal`), or variants that do.

    n_sigma: deviation from the neighbourhood, in standard deviations of the field's noise, above which a height is an
    outlier; alpha: scale of the flights, in um (`literal`) or in distances to the guide (`guided`).
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Literal["none", "literal", "guided", "switching_median", "sigma_filter"] = "sigma_filter"
    n_sigma: Positive | Auto = "auto"
    alpha: Positive | Auto = "auto"
    beta: Annotated[float, Within(0, 2, open_low=True)] = 1.5
    iterations: Annotated[int, Within(1, 1000)] | Auto = "auto"
    seed: Annotated[int, Within(0)] = 1


class Outliers(Spec, frozen=True, kw_only=True):
    """Statistical outlier removal: a point further from its neighbours than mean + n_sigma deviations is removed.

    The threshold is at least `floor_um` (``auto``: from the step of the sweep), which protects the edges of steps.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Literal["none", "lattice", "cloud"] = "lattice"
    neighbours: Annotated[int, Within(4, 64)] = 15
    n_sigma: Positive = 3.0
    floor_um: Positive | Auto = "auto"


class Fill(Spec, frozen=True, kw_only=True):
    """Spline interpolation of gaps up to `max_gap_px` along rows and columns, never across a step.

    Filled pixels are marked. `all`: fills every gap, as in the paper.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Literal["none", "small_gaps", "all"] = "small_gaps"
    max_gap_px: Annotated[int, Within(1, 10000)] = 9


class Noise(Spec, frozen=True, kw_only=True):
    """Camera noise: the variance of a grey value is gain_counts x grey + floor_counts2; ``auto`` estimates it."""

    error: ClassVar[type[WaferViewerError]] = ComputeError
    gain_counts: Positive | Auto = "auto"
    floor_counts2: Positive | Auto = "auto"


class Stitching(Spec, frozen=True, kw_only=True):
    """Stitching of fields into one surface: their poses, and blending in the overlaps.

    poses: estimated from the overlaps with the stage as prior (`registered`), or those of the stage; blend: by
    confidence, fading out towards the border of a field, or the paper's linear ramps along X and Y (eq. 15-16).
    stage_error_um, z_error_um, tilt_error: standard deviations of the stage's errors (tilt in um per um); search_um:
    search radius around the stage position of a neighbour. ``auto`` estimates them from the overlaps.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    poses: Literal["registered", "stage"] = "registered"
    blend: Literal["confidence", "ramp"] = "confidence"
    search_um: Positive | Auto = "auto"
    stage_error_um: Positive | Auto = "auto"
    z_error_um: Positive | Auto = "auto"
    tilt_error: Positive | Auto = "auto"


class Recipe(Spec, frozen=True, kw_only=True):
    """All settings from stack to surface. A result carries the recipe with the values chosen by ``auto``.

    focus_measure: a name in `focus_measures`; focus_width_um: full width at half maximum of a focus curve, which sets
    the scale for competing maxima, flanks and edges; drift: correct frames shifted or scaled by more than half a pixel,
    estimated per field; flicker: divide frames by their part of the light that
    changes from frame to frame; compare_windows: require agreement with the height from a window twice as wide; edges:
    treatment of walls between bright and dark heights: unchecked (`none`), required to agree with the surface further
    from the wall (`band`), or searched again along the wall as well (`rims`).
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    drift: Literal["none", "correct"] = "correct"
    flicker: Literal["none", "correct"] = "correct"
    focus_measure: FocusMeasureName = "log_laplacian"
    window: Window | Auto = "auto"
    peak: Literal["argmax", "gaussian", "tent", "blur_law", "centred"] = "centred"
    focus_width_um: Positive | Auto = "auto"
    min_confidence: Annotated[float, Within(0, 1)] | Auto = "auto"
    clipped_fraction: Annotated[float, Within(0, 1)] = 0.75
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
        """Return the paper's method: plain argmax, its filter as printed, outliers by the cloud, all gaps filled.

        The paper leaves window, step size, iterations and thresholds open ("tuned by hand"); the values here are ours.
        """
        return cls(
            focus_measure="tenengrad",
            window=9,
            peak="argmax",
            drift="none",
            flicker="none",
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
        """True if any setting is ``auto``."""
        return "auto" in _values(msgspec.to_builtins(self))

    @property
    def heights_have_auto(self) -> bool:
        """True if any setting that affects the heights of a field is ``auto``."""
        return replace(self, stitching=_STAGE_ONLY).has_auto

    def makes_heights_of(self, other: Recipe) -> bool:
        """Return whether both recipes give the same heights of a field, apart from stitching."""
        return replace(self, stitching=_STAGE_ONLY) == replace(other, stitching=_STAGE_ONLY)


_STAGE_ONLY = Stitching(search_um=1.0, stage_error_um=1.0, z_error_um=1.0, tilt_error=1.0)
"""Stitching without ``auto``."""


def _values(data: object) -> list[object]:
    return [v for item in data.values() for v in _values(item)] if isinstance(data, dict) else [data]


READY_RECIPES: dict[str, Recipe] = {"default": Recipe(), "paper": Recipe.paper()}
"""Named recipes."""
