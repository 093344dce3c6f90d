"""Number formatting and round numbers for scales."""

from __future__ import annotations

import math
from datetime import datetime, timedelta

import numpy as np

from wafer_viewer.model.quantity import digits_of_u

MINUS = "\u2212"
THIN = "\u202f"
"""Narrow no-break space: between thousands, and between a value and its unit."""
NOTHING = "–"
"""Placeholder for a missing number."""


def number(value: float | None, digits: int = 2, *, signed: bool = False) -> str:
    """Format `value` with `digits` decimals and grouped thousands; NaN and None give a dash, zero has no sign."""
    if value is None or not math.isfinite(value):
        return NOTHING
    text = f"{abs(value):,.{digits}f}".replace(",", THIN)
    if float(f"{value:.{digits}f}") == 0:
        return text
    return f"{MINUS if value < 0 else '+' if signed else ''}{text}"


def with_unit(value: float | None, digits: int = 2, unit: str = "µm", *, signed: bool = False) -> str:
    """Format a number with its unit, joined by a no-break space."""
    return f"{number(value, digits, signed=signed)}{THIN}{unit}"


def plural(n: int, what: str) -> str:
    """Format a number of things, ``1 field``, ``12 fields``."""
    return f"{number(n, 0)} {what}{'' if n == 1 else 's'}"


def value_and_u(value: float, expanded: float | None, digits: int = 2, *, signed: bool = False) -> tuple[str, str]:
    """Format a value and its U, U to two significant digits, both with the same decimals; no U: `digits`, dash."""
    if expanded is None:
        return number(value, digits, signed=signed), NOTHING
    digits = digits_of_u(expanded)
    return number(value, digits, signed=signed), number(expanded, digits)


def duration(seconds: float | None) -> str:
    """Format a duration as ``0:23``, ``10:19``, ``1:02:03``; rounded up, so that time left never reads 0:00."""
    if seconds is None or not math.isfinite(seconds):
        return NOTHING
    rounded = math.ceil(max(0.0, seconds) - 1e-6)
    minutes, rest = divmod(rounded, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def format_time(taken: str, now: datetime) -> str:
    """Format an ISO 8601 time: today 08:41, yesterday 17:02, 12 Nov, 3 Feb 2025; return other text unchanged."""
    try:
        moment = datetime.fromisoformat(taken).astimezone(now.tzinfo)
    except ValueError:
        return taken
    if moment.date() == now.date():
        return f"today {moment:%H:%M}"
    if moment.date() == (now - timedelta(days=1)).date():
        return f"yesterday {moment:%H:%M}"
    return f"{moment.day} {moment:%b}" + (f" {moment.year}" if moment.year != now.year else "")


def size(n_bytes: float | None) -> str:
    """Format a size as ``870 kB``, ``3.4 GB``: decimal units, two significant digits below ten, else integers."""
    if n_bytes is None:
        return NOTHING
    value, unit = float(n_bytes), "B"
    for larger in ("kB", "MB", "GB", "TB"):
        if value < 999.5:
            break
        value, unit = value / 1000, larger
    return with_unit(value, 1 if unit != "B" and value < 9.95 else 0, unit)


def share(fraction: float | None, digits: int = 1) -> str:
    """Format a percentage as ``0.6 %``; nonzero values never read as zero, and values below 1 never as 100 %."""
    if fraction is None or not math.isfinite(fraction):
        return NOTHING
    percent, least = 100 * fraction, 10.0**-digits
    if 0 < percent < least / 2:
        return f"<{THIN}{with_unit(least, digits, '%')}"
    if 100 - least / 2 <= percent < 100:
        return with_unit(100 - least, digits, "%")
    return with_unit(percent, digits, "%")


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
