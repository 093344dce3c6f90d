"""State of the profile plot in one browser: cursors, zoom and comparisons with the active line."""

from __future__ import annotations

from dataclasses import dataclass, replace

from wafer_viewer.model.measurement.sections import OtherSurface


@dataclass(frozen=True, slots=True)
class PlotView:
    """Settings of the profile plot.

    cursors: fractions of the active line's length.
    span_um: displayed part of the lines; None for all.
    cleaned: True if the other of measured and filtered heights is drawn too.
    of: another surface drawn along the same line; None for none.
    """

    cursors: tuple[float, float] = (0.0, 1.0)
    span_um: tuple[float, float] | None = None
    cleaned: bool = False
    of: OtherSurface | None = None


def with_cursor(plot: PlotView, number: int, share: float) -> PlotView:
    """Return the plot with one cursor moved to another fraction of the line, clamped to it."""
    share, (first, second) = min(max(share, 0.0), 1.0), plot.cursors
    return replace(plot, cursors=(share, second) if number == 0 else (first, share))
