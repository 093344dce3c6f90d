"""Numbers as people read them: a true minus, thin spaces in thousands and before units, U to two figures."""

from __future__ import annotations

import math

MINUS = "\u2212"
THIN = "\u202f"
"""Narrow no-break space: between thousands, and between a value and its unit."""
NOTHING = "–"
"""What stands where there is no number."""


def number(value: float | None, digits: int = 2, *, signed: bool = False) -> str:
    """`value` to `digits` decimals, thousands apart; NaN and None read as a dash, no zero has a sign."""
    if value is None or not math.isfinite(value):
        return NOTHING
    text = f"{abs(value):,.{digits}f}".replace(",", THIN)
    if float(f"{value:.{digits}f}") == 0:
        return text
    return f"{MINUS if value < 0 else '+' if signed else ''}{text}"


def with_unit(value: float | None, digits: int = 2, unit: str = "µm", *, signed: bool = False) -> str:
    """`number` and its unit, which never part at the end of a line."""
    return f"{number(value, digits, signed=signed)}{THIN}{unit}"


def digits_of_u(expanded: float) -> int:
    """Decimals that show an uncertainty to two figures: 0.31 -> 2, 4.2 -> 1, 17 -> 0."""
    if not math.isfinite(expanded) or expanded <= 0:
        return 2
    digits = 1 - math.floor(math.log10(expanded))
    rounded_up = round(expanded, digits) >= 10 ** (2 - digits)
    return max(0, digits - 1 if rounded_up else digits)


def value_and_u(value: float, expanded: float | None, digits: int = 2, *, signed: bool = False) -> tuple[str, str]:
    """A value and its uncertainty, U to two figures and the value to the same place; no U: `digits` and a dash."""
    if expanded is None:
        return number(value, digits, signed=signed), NOTHING
    digits = digits_of_u(expanded)
    return number(value, digits, signed=signed), number(expanded, digits)


def duration(seconds: float | None) -> str:
    """``0:23``, ``10:19``, ``1:02:03``; rounded up, so that a job with time left never reads 0:00."""
    if seconds is None or not math.isfinite(seconds):
        return NOTHING
    whole = math.ceil(max(0.0, seconds) - 1e-6)
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def size(n_bytes: float | None) -> str:
    """``870 kB``, ``3.4 GB``: decimal units, two figures under ten, else whole numbers."""
    if n_bytes is None:
        return NOTHING
    value, unit = float(n_bytes), "B"
    for larger in ("kB", "MB", "GB", "TB"):
        if value < 999.5:
            break
        value, unit = value / 1000, larger
    return with_unit(value, 1 if unit != "B" and value < 9.95 else 0, unit)


def share(fraction: float | None, digits: int = 1) -> str:
    """``0.6 %``; what is there but would read as zero is ``< 0.1 %``, what is not quite all never reads 100 %."""
    if fraction is None or not math.isfinite(fraction):
        return NOTHING
    percent, least = 100 * fraction, 10.0**-digits
    if 0 < percent < least / 2:
        return f"<{THIN}{with_unit(least, digits, '%')}"
    if 100 - least / 2 <= percent < 100:
        return with_unit(100 - least, digits, "%")
    return with_unit(percent, digits, "%")
