"""What one browser chose of the plot of its profiles: cursors, zoom, and what the active line is compared with."""

from __future__ import annotations

from dataclasses import dataclass, replace

from wafer_viewer.model.measurement.sections import OtherSurface


@dataclass(frozen=True, slots=True)
class PlotView:
    """cursors: shares of the active line's length; span_um: the part of the lines shown, None all of them.

    cleaned: the other of measured and filtered heights is drawn too; of: so is another surface along the same line.
    """

    cursors: tuple[float, float] = (0.0, 1.0)
    span_um: tuple[float, float] | None = None
    cleaned: bool = False
    of: OtherSurface | None = None


def with_cursor(plot: PlotView, number: int, share: float) -> PlotView:
    """The same with one cursor at another share of the line, kept on it."""
    share, (first, second) = min(max(share, 0.0), 1.0), plot.cursors
    return replace(plot, cursors=(share, second) if number == 0 else (first, share))
