"""Which pixels have a height that can be believed, and why the others have none.

Each gate asks one question of every pixel: a score, and the limit it is held to. Where several fail, the first of them
explains most: nothing else that a clipped pixel says means anything, and so on down the table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.numerics.filters.sliding_filters import mean
from wafer_viewer.reconstruct.focus.noise_thresholds import NoiseScores
from wafer_viewer.reconstruct.focus.peak import Peaks, confidence_of, lead_of

LEAD_OVER_NOISE = 2.0
"""A peak must lead its rival by twice what noise reaches: noise that varies along z reaches more than steady noise."""

CLIPPED_FRAMES_FRACTION = 0.02

LEAST_FRAMES = 12
"""In a shorter stack a wider window sees no more, and a wall cannot be told from a pattern in focus."""

POWERS = "powers of two"
"""The unit of scores that are ratios of the focus measure."""


@dataclass(frozen=True, slots=True)
class Gate:
    """What a peak must show to count as a measurement; scores in powers of two of the focus measure.

    window_tolerance_um: how far the height of a window twice as wide may be from that of the window.
    """

    min_confidence: float
    min_fall: float
    min_contrast: float
    clipped_fraction: float
    window: int
    window_tolerance_um: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class GateTest:
    """A question that is put to every pixel, and what a pixel that fails it is.

    score: float32 [row, col]; a pixel passes when its score is over the limit, or, where `at_most`, no more than it.
    A limit of -inf, or of inf where `at_most`, lets everything pass: the gate is off.
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
        """Which pixels pass, bool [row, col]."""
        return self.score <= self.limit if self.at_most else self.score > self.limit


def auto_min_confidence(noise: NoiseScores) -> float:
    """The confidence that tells a peak from noise, for this number of frames and this window."""
    return confidence_of(LEAD_OVER_NOISE * noise.lead)


def gate_of(
    noise: NoiseScores,
    min_confidence: float,
    clipped_fraction: float,
    window: int,
    window_tolerance_um: float = np.inf,
) -> Gate:
    """The gate for a recipe's confidence; without a least confidence only clipping and the ends of the range count."""
    wanted = min_confidence > 0
    return Gate(
        min_confidence=min_confidence,
        min_fall=noise.fall if wanted else -np.inf,
        min_contrast=noise.contrast if wanted else -np.inf,
        clipped_fraction=clipped_fraction,
        window=window,
        window_tolerance_um=window_tolerance_um if wanted else np.inf,
    )


def origins(peaks: Peaks, gate: Gate, n_frames: int, wide_um: NDArray[np.float32] | None = None) -> NDArray[np.uint8]:
    """The code of `Origin` of each pixel, uint8 [row, col].

    wide_um: the heights that a wider window sees, where they are to be compared.
    """
    return first_failed(checks(peaks, gate, n_frames, wide_um))


def first_failed(asked: tuple[GateTest, ...]) -> NDArray[np.uint8]:
    """The origin that the first failed check of each pixel stands for, measured where none failed; uint8 [row, col]."""
    origin = np.full(asked[0].score.shape, Origin.MEASURED, np.uint8)
    for check in reversed(asked):
        origin[~check.passed] = check.origin
    return origin


def checks(peaks: Peaks, gate: Gate, n_frames: int, wide_um: NDArray[np.float32] | None = None) -> tuple[GateTest, ...]:
    """Every gate with the scores of all pixels, the one that explains most first."""
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
        GateTest("rival", "Does the peak stand over its rivals?", Origin.AMBIGUOUS, peaks.lead, lead, POWERS),
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
    """How much of the window was too bright, in more frames than a lucky noise peak is."""
    too_bright = peaks.clipped >= max(1, round(CLIPPED_FRAMES_FRACTION * n_frames))
    if not too_bright.any():
        return np.zeros(too_bright.shape, np.float32)
    return mean(too_bright, gate.window)
