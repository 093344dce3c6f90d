"""Round numbers for scales: 1, 2 or 5 times a power of ten."""

from __future__ import annotations

import math

import numpy as np

_STEPS = (1.0, 2.0, 5.0, 10.0)


def round_step(at_least: float) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that is not under `at_least` (> 0)."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return next(s * power for s in _STEPS if s * power >= at_least * (1 - 1e-9))


def round_length(at_most: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten not over `at_most` (> 0): the length of a scale bar."""
    power = 10.0 ** math.floor(math.log10(at_most) + 1e-12)
    return max(s * power for s in _STEPS if s * power <= at_most * (1 + 1e-9))


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Return round values in low ... high, at most about `most` of them; one value if low equals high."""
    if not high > low:
        return [low]
    step = round_step((high - low) / most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(np.round(k * step, 12)) for k in range(first, last + 1)]


def tick_digits(values: list[float]) -> int:
    """Return the number of decimals that distinguishes neighbouring ticks."""
    if len(values) < 2:
        return 1
    return max(0, -math.floor(math.log10(abs(values[1] - values[0])) + 1e-9))


def length_text(length_um: float) -> str:
    """Return the label of a scale bar: ``500 µm``, ``2 mm``, ``0.5 µm``."""
    return f"{length_um / 1000:g}\u202fmm" if length_um >= 1000 else f"{length_um:g}\u202fµm"
