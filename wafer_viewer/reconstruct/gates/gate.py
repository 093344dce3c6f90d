"""Gates that accept or reject the peak of each pixel, with a reason for rejection.

Each gate compares a score of every pixel with a limit. Where several gates fail, the first one gives the reason: the
other scores of a clipped pixel are meaningless, and so on down the table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.numerics.filters.sliding_filters import mean
from wafer_viewer.reconstruct.focus.peak import Peaks, confidence_of, lead_of
from wafer_viewer.reconstruct.focus.peak_search import NoiseScores, Search, largest_gap, noise_scores

LEAD_OVER_NOISE = 1.5
"""Required lead over the rival, relative to the noise lead; noise that varies along z exceeds steady noise."""

MIN_FALL_SHARE, MIN_FALL_SHARE_PER_POWER = 0.3, 0.35 / 3
"""Required fall two focus widths from the peak, as a share of its contrast, and that of a measure of power 1.

Tuned on tests/truth/unseen.py. A curve of power p falls by p octaves where that of power 1 falls by one. One that falls
less than required is more than twice as wide as the optics make it: light of two surfaces, or an aperture that walls or
a glossy surface narrow. On 70 scenes for tuning 0.021, 0.016 and 0.015 % of the pixels have a false height with limits
of 0.3, 0.35 and 0.4 for a log-Laplacian; of the pixels of tests/truth/layouts.py 70, 67 and 63 % are measured.
"""

MAX_DIP_PER_POWER = 0.2 / 3
"""Deepest dip between two tops of a focus curve, in powers of two, for a measure of power 1.

Curved grains that shine are sharpest above and below their focus, each on its own: the peak is on either top, a focus
width or more apart, and the surface between them. Tuned on tests/truth/unseen.py, seeds from 5 000 000 on.
"""

CLIPPED_FRAMES_FRACTION = 0.02
"""Smallest fraction of frames in which a pixel must be clipped to count as clipped."""

LEAST_FRAMES = 12
"""In a shorter stack a wider window adds nothing, and a wall cannot be distinguished from a pattern in focus."""

WINDOW_STEPS = 1.5
"""Tolerance between the heights of two windows, in steps of the resolution."""

POWERS = "powers of two"
"""Unit of scores that are ratios of the focus measure."""


@dataclass(frozen=True, slots=True)
class Gate:
    """Limits that a peak must pass to count as a measurement; scores in powers of two of the focus measure.

    min_fall_share: smallest fall as a share of the contrast; window_tolerance_um: largest accepted difference between
    the height of a window twice as wide and that of the window; max_dip: deepest dip to another top nearby.
    """

    min_confidence: float
    min_fall: float
    min_contrast: float
    clipped_fraction: float
    window: int
    window_tolerance_um: float = np.inf
    min_fall_share: float = -np.inf
    max_dip: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class GateTest:
    """A test applied to every pixel, and the origin code of the pixels that fail it.

    score: float32 [row, col]; a pixel passes when its score is above the limit or, if `at_most`, not above it. A limit
    of -inf, or of inf if `at_most`, disables the gate.
    """

    name: str
    question: str
    origin: Origin
    score: NDArray[np.float32]
    limit: float
    unit: str
    at_most: bool = False

    @property
    def passed(self) -> NDArray[np.bool_]:
        """Mask of the pixels that pass, bool [row, col]."""
        return self.score <= self.limit if self.at_most else self.score > self.limit


def gate_for(recipe: Recipe, search: Search, n_frames: int, resolution_um: float, gap_share: float = 1.0) -> Gate:
    """Return the gate of a recipe for a search in `n_frames` frames, with the automatic confidence where it is `auto`.

    gap_share: the gap of the search, whole frames, in units of two focus widths. Nearer to the peak a curve has fallen
    less, about as the square of the distance. Windows are compared only in stacks that are long enough, and flanks are
    judged only where the sweep reaches them.
    """
    noise = noise_scores(search, n_frames)
    confidence = auto_min_confidence(noise) if recipe.min_confidence == "auto" else recipe.min_confidence
    compare = recipe.compare_windows and n_frames >= LEAST_FRAMES
    tolerance_um = WINDOW_STEPS * resolution_um if compare else np.inf
    power = focus_measures()[search.measure].power
    by_power, max_dip = MIN_FALL_SHARE_PER_POWER * power, MAX_DIP_PER_POWER * power
    there = min(1.0, gap_share) ** 2
    min_fall_share = there * max(MIN_FALL_SHARE, by_power) if search.gap < largest_gap(n_frames) else -np.inf
    return gate_of(noise, confidence, recipe.clipped_fraction, search.window, tolerance_um, min_fall_share, max_dip)


def auto_min_confidence(noise: NoiseScores) -> float:
    """Return the confidence that separates a peak from noise, for this number of frames and this window."""
    return confidence_of(LEAD_OVER_NOISE * noise.lead)


def gate_of(
    noise: NoiseScores,
    min_confidence: float,
    clipped_fraction: float,
    window: int,
    window_tolerance_um: float = np.inf,
    min_fall_share: float = -np.inf,
    max_dip: float = np.inf,
) -> Gate:
    """Return the gate for a recipe's confidence; without a minimum only clipping and the range ends are tested."""
    wanted = min_confidence > 0
    return Gate(
        min_confidence=min_confidence,
        min_fall=noise.fall if wanted else -np.inf,
        min_contrast=noise.contrast if wanted else -np.inf,
        clipped_fraction=clipped_fraction,
        window=window,
        min_fall_share=min_fall_share if wanted else -np.inf,
        window_tolerance_um=window_tolerance_um if wanted else np.inf,
        max_dip=max_dip if wanted else np.inf,
    )


def origins(peaks: Peaks, gate: Gate, n_frames: int, wide_um: NDArray[np.float32] | None = None) -> NDArray[np.uint8]:
    """Return the code of `Origin` of each pixel, uint8 [row, col].

    wide_um: heights from a wider window, if they are to be compared.
    """
    return first_failed(checks(peaks, gate, n_frames, wide_um))


def first_failed(tests: tuple[GateTest, ...]) -> NDArray[np.uint8]:
    """Return the origin of the first failed test of each pixel, measured where none failed; uint8 [row, col]."""
    origin = np.full(tests[0].score.shape, Origin.MEASURED, np.uint8)
    for test in reversed(tests):
        np.copyto(origin, np.uint8(test.origin), where=~test.passed)
    return origin


def checks(peaks: Peaks, gate: Gate, n_frames: int, wide_um: NDArray[np.float32] | None = None) -> tuple[GateTest, ...]:
    """Return every gate with the scores of all pixels, the most explanatory first."""
    lead = lead_of(gate.min_confidence) if gate.min_confidence > 0 else -np.inf
    found = (
        GateTest(
            "clipped",
            "Is the window free of pixels that are too bright?",
            Origin.CLIPPED,
            _clipped_share(peaks, gate, n_frames),
            gate.clipped_fraction,
            "share of the window",
            at_most=True,
        ),
        GateTest(
            "texture",
            "Is there texture to focus on?",
            Origin.NO_TEXTURE,
            peaks.contrast,
            gate.min_contrast,
            POWERS,
        ),
        GateTest(
            "range",
            "Does the peak lie within the sweep?",
            Origin.END_OF_RANGE,
            peaks.at_end.astype(np.float32),
            0.0,
            "1 at an end",
            at_most=True,
        ),
        GateTest(
            "flanks",
            "Does the focus fall on both sides of the peak?",
            Origin.AMBIGUOUS,
            peaks.fall,
            gate.min_fall,
            POWERS,
        ),
        GateTest(
            "width",
            "Is the peak as narrow as the optics make it?",
            Origin.AMBIGUOUS,
            np.asarray(peaks.fall / np.maximum(peaks.contrast, np.float32(1e-6)), np.float32),
            gate.min_fall_share,
            "share of the contrast",
        ),
        GateTest("rival", "Does the peak stand over its rivals?", Origin.AMBIGUOUS, peaks.lead, lead, POWERS),
        GateTest(
            "tops",
            "Does the focus curve have a single top there?",
            Origin.AMBIGUOUS,
            peaks.dip,
            gate.max_dip,
            POWERS,
            at_most=True,
        ),
    )
    return found if wide_um is None else (*found, _windows(peaks, gate, wide_um))


def _windows(peaks: Peaks, gate: Gate, wide_um: NDArray[np.float32]) -> GateTest:
    return GateTest(
        "windows",
        "Does a window twice as wide see the same height?",
        Origin.WINDOWS_DISAGREE,
        np.abs(peaks.z_um - wide_um),
        gate.window_tolerance_um,
        "um",
        at_most=True,
    )


def _clipped_share(peaks: Peaks, gate: Gate, n_frames: int) -> NDArray[np.float32]:
    """Return the clipped fraction of the window, counting pixels clipped in at least 2 % of the frames."""
    too_bright = peaks.clipped >= max(1, round(CLIPPED_FRAMES_FRACTION * n_frames))
    if not too_bright.any():
        return np.zeros(too_bright.shape, np.float32)
    return mean(too_bright, gate.window)
