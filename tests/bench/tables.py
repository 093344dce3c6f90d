"""Tables on the screen, for the benchmarks."""

from __future__ import annotations

import math
from collections.abc import Sequence

Cell = str | float | int | None


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
    """A titled table, the first column to the left and the others to the right."""
    lines = [list(header), *([told(cell) for cell in row] for row in rows)]
    widths = [max(len(line[n]) for line in lines) for n in range(len(header))]
    print(f"\n{title}")
    for line in lines:
        others = (cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))
        print("  " + "  ".join([line[0].ljust(widths[0]), *others]).rstrip(), flush=True)


def told(cell: Cell) -> str:
    """A cell as text: three figures of a number, what is missing as a dash."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, float):
        return f"{cell:.3g}" if abs(cell) < 100 else f"{cell:.0f}"
    return str(cell)


def percent(share: float, digits: int = 1) -> str:
    """A share as a percentage."""
    return "-" if math.isnan(share) else f"{100 * share:.{digits}f}"


def met(value: float, limit: float, at_least: bool = False) -> str:
    """Whether a goal is met."""
    return "met" if (value >= limit if at_least else value <= limit) else "MISSED"
