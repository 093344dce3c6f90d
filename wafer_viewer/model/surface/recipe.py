"""Recipes: all settings of the reconstruction from focus stack to surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import msgspec

from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.model.spec import Positive, Setting, Spec, Within, replace
from wafer_viewer.model.surface.focus_measures import focus_measures

Auto = Literal["auto"]
Window = Annotated[int, Within(3, 25, odd=True)]
if TYPE_CHECKING:
    FocusMeasureName = str
else:
    FocusMeasureName = Literal[tuple(focus_measures())]

_PRIOR = "Standard deviation, before the overlaps are compared"
_DEVIATION = "Deviation from the neighbourhood, in standard deviations of the noise"
_DRIFT = Setting("Drift", "Correction of lateral drift between frames", titles={"correct": "Correct", "none": "Leave"})
_FLICKER = Setting(
    "Flicker", "Correction of light that changes from frame to frame", titles={"correct": "Correct", "none": "Leave"}
)
_FOCUS = Setting(
    "Focus measure",
    "Measure of sharpness",
    titles={name: measure.title for name, measure in focus_measures().items()},
)
_WINDOW = Setting(
    "Window",
    "Pixels on a side over which focus is measured",
    titles={"auto": "From the data", **{n: f"{n}\u202fpx" for n in range(3, 27, 2)}},
)
_PEAK = Setting(
    "Peak",
    "Interpolation of the height between two frames",
    titles={
        "centred": "Centred",
        "blur_law": "Blur law",
        "tent": "Tent",
        "gaussian": "Gaussian",
        "argmax": "Highest frame",
    },
)
_SECOND_WINDOW = Setting(
    "Second window",
    "Whether a window twice as wide must give the same height",
    titles={True: "Must agree", False: "Not tested"},
)
_EDGES = Setting(
    "Beside walls",
    "Treatment of heights beside walls, where light bleeds",
    titles={"rims": "Measure the rims", "band": "Only what agrees", "none": "Not tested"},
)
_SMOOTHING = Setting(
    "Smoothing",
    "Filter of the heights shown; measurements use the measured heights",
    titles={
        "sigma_filter": "Sigma filter",
        "switching_median": "Switching median",
        "guided": "Levy, guided",
        "literal": "Levy, literal",
        "none": "None",
    },
)
_OUTLIERS = Setting(
    "Outliers", "Isolated heights to remove", titles={"lattice": "Lattice", "cloud": "Cloud", "none": "None"}
)
_FILL = Setting(
    "Fill",
    "Gaps to fill; filled pixels are marked",
    titles={"small_gaps": "Small gaps", "all": "All gaps", "none": "None"},
)
_POSES = Setting(
    "Positions of the fields", "How they are found", titles={"registered": "By their overlaps", "stage": "By the stage"}
)
_BLEND = Setting(
    "Blending of overlaps", "Weights of the fields", titles={"confidence": "By confidence", "ramp": "Linear ramps"}
)
_MEASURE_ON = Setting(
    "Measured on",
    "Heights that numbers are of",
    titles={"unsmoothed": "Measured heights", "smoothed": "Filtered heights"},
)


FLIGHTS = ("literal", "guided")
"""Modes of smoothing by Levy flights."""


class Levy(Spec, frozen=True, kw_only=True):
    """Smoothing: Levy flights, eq. 7-14 of the paper, which do not reduce noise (`literal`), or variants that do.

    n_sigma: deviation from the neighbourhood, in standard deviations of the field's noise, above which a height is an
    outlier; alpha: scale of the flights, in um (`literal`) or in distances to the guide (`guided`).
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Annotated[Literal["none", "literal", "guided", "switching_median", "sigma_filter"], _SMOOTHING] = (
        "sigma_filter"
    )
    n_sigma: Annotated[Positive | Auto, Setting("Smoothing takes for noise, up to", _DEVIATION, unit="σ")] = "auto"
    alpha: Annotated[
        Positive | Auto, Setting("Scale of the Lévy flights", "Of guided flights in distances", unit="µm")
    ] = "auto"
    beta: Annotated[float, Within(0, 2, open_low=True), Setting("Index of the Lévy flights", "2 is a normal walk")] = (
        1.5
    )
    iterations: Annotated[Annotated[int, Within(1, 1000)] | Auto, Setting("Rounds of smoothing", "Of the filter")] = (
        "auto"
    )
    seed: Annotated[int, Within(0), Setting("Seed of the Lévy flights", "Start of their random numbers")] = 1


class Outliers(Spec, frozen=True, kw_only=True):
    """Statistical outlier removal: a point further from its neighbours than mean + n_sigma deviations is removed.

    The threshold is at least `floor_um` (``auto``: from the step of the sweep), which protects the edges of steps.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Annotated[Literal["none", "lattice", "cloud"], _OUTLIERS] = "lattice"
    neighbours: Annotated[int, Within(4, 64), Setting("Neighbours of a point", "That it is compared with")] = 15
    n_sigma: Annotated[Positive, Setting("Outliers deviate by over", "From the mean distance", unit="σ")] = 3.0
    floor_um: Annotated[Positive | Auto, Setting("Outlier threshold", "Least distance of an outlier", unit="µm")] = (
        "auto"
    )


class Fill(Spec, frozen=True, kw_only=True):
    """Spline interpolation of gaps up to `max_gap_px` along rows and columns, never across a step.

    Filled pixels are marked. `all`: fills every gap, as in the paper.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    mode: Annotated[Literal["none", "small_gaps", "all"], _FILL] = "small_gaps"
    max_gap_px: Annotated[int, Within(1, 10000), Setting("Widest filled gap", "Along a row or column", unit="px")] = 9


class Noise(Spec, frozen=True, kw_only=True):
    """Camera noise: the variance of a grey value is gain_counts x grey + floor_counts2; ``auto`` estimates it."""

    error: ClassVar[type[WaferViewerError]] = ComputeError
    gain_counts: Annotated[Positive | Auto, Setting("Camera noise, gain", "Variance per grey value", unit="counts")] = (
        "auto"
    )
    floor_counts2: Annotated[
        Positive | Auto, Setting("Camera noise, floor", "Variance in the dark", unit="counts²")
    ] = "auto"


class Stitching(Spec, frozen=True, kw_only=True):
    """Stitching of fields into one surface: their poses, and blending in the overlaps.

    poses: estimated from the overlaps with the stage as prior (`registered`), or those of the stage; blend: by
    confidence, fading out towards the border of a field, or the paper's linear ramps along X and Y (eq. 15-16).
    stage_error_um, z_error_um, tilt_error: standard deviations of the stage's errors (tilt in um per um); search_um:
    search radius around the stage position of a neighbour. ``auto`` estimates them from the overlaps.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    poses: Annotated[Literal["registered", "stage"], _POSES] = "registered"
    blend: Annotated[Literal["confidence", "ramp"], _BLEND] = "confidence"
    search_um: Annotated[
        Positive | Auto, Setting("Search radius of a neighbour", "Round its stage position", unit="µm")
    ] = "auto"
    stage_error_um: Annotated[Positive | Auto, Setting("Error of the stage in x and y", _PRIOR, unit="µm")] = "auto"
    z_error_um: Annotated[Positive | Auto, Setting("Error of the stage along z", _PRIOR, unit="µm")] = "auto"
    tilt_error: Annotated[Positive | Auto, Setting("Error of the stage in tilt", _PRIOR, unit="µm/µm")] = "auto"


LEAST_PROBABILITY, LEAST_IN_SHORT_STACKS = 0.96, 0.8
"""Least probability of `auto`, and that in stacks of fewer than 12 frames: tests/bench/bench_families.py.

In short stacks neither walls nor a wider window are looked at, and hardly a height is as sure.
"""


class Recipe(Spec, frozen=True, kw_only=True):
    """All settings from stack to surface. A result carries the recipe with the values chosen by ``auto``.

    focus_measure: a name in `focus_measures`; focus_width_um: full width at half maximum of a focus curve, which sets
    the scale for competing maxima, flanks and edges; min_confidence: of the peaks that the gates accept, 0 for every
    peak; least_probability: of a height that counts, by all its evidence, 0 for all that the gates accept; drift:
    correct frames shifted or scaled by more than half a pixel, estimated per field; flicker: divide frames by their
    part of the light that changes from frame to frame; compare_windows: require agreement with the height from a
    window twice as wide; edges: treatment of walls between bright and dark heights: unchecked (`none`), required to
    agree with the surface further from the wall (`band`), or searched again along the wall as well (`rims`).
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    drift: Annotated[Literal["none", "correct"], _DRIFT] = "correct"
    flicker: Annotated[Literal["none", "correct"], _FLICKER] = "correct"
    focus_measure: Annotated[FocusMeasureName, _FOCUS] = "log_laplacian"
    window: Annotated[Window | Auto, _WINDOW] = "auto"
    peak: Annotated[Literal["argmax", "gaussian", "tent", "blur_law", "centred"], _PEAK] = "centred"
    focus_width_um: Annotated[Positive | Auto, Setting("Width of a focus curve", "At half its maximum", unit="µm")] = (
        "auto"
    )
    min_confidence: Annotated[
        Annotated[float, Within(0, 1)] | Auto, Setting("Confidence from", "Least confidence of a height")
    ] = "auto"
    least_probability: Annotated[
        Annotated[float, Within(0, 1)] | Auto, Setting("Probability from", "Least probability of a height that counts")
    ] = "auto"
    clipped_fraction: Annotated[
        float,
        Within(0, 1),
        Setting("Overexposed frames up to", "Share of a pixel's frames, beyond which it is refused"),
    ] = 0.75
    compare_windows: Annotated[bool, _SECOND_WINDOW] = True
    edges: Annotated[Literal["none", "band", "rims"], _EDGES] = "rims"
    noise: Noise = Noise()
    levy: Levy = Levy()
    outliers: Outliers = Outliers()
    fill: Fill = Fill()
    stitching: Stitching = Stitching()
    measure_on: Annotated[Literal["unsmoothed", "smoothed"], _MEASURE_ON] = "unsmoothed"

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
    def unused(self) -> frozenset[str]:
        """Paths of the settings that have no effect beside the others."""
        unused: set[str] = set()
        if self.levy.mode not in FLIGHTS:
            unused |= {"levy.alpha", "levy.beta", "levy.seed"}
        if self.levy.mode == "none":
            unused |= {"levy.n_sigma", "levy.iterations"}
        if self.outliers.mode == "none":
            unused |= {"outliers.neighbours", "outliers.n_sigma", "outliers.floor_um"}
        if self.fill.mode != "small_gaps":
            unused.add("fill.max_gap_px")
        return frozenset(unused)

    @property
    def weighs_evidence(self) -> bool:
        """True if heights count by their probability, which is then their confidence; else the gates alone decide."""
        return self.least_probability != 0 and self.min_confidence != 0

    @property
    def has_auto(self) -> bool:
        """True if any setting is chosen from the data; the least probability depends on the number of frames."""
        return "auto" in _values(msgspec.to_builtins(replace(self, least_probability=0.0)))

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
