"""Charts of a gauge R&R study as HTML: values by part, and means and ranges of each appraiser with control limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.charts.axes import ChartAxes, PlotLook, Tick, line_svg, plot_html, round_ticks
from wafer_viewer.model.gauge import K_OF_TRIALS

COLOURS = ("accent", "attention", "good", "fault", "ink2")
"""Colours of appraisers, in order."""
D3 = {2: 0.853, 3: 0.888, 4: 0.880, 5: 0.864}
"""Standard deviation of the range of so many normal values."""
_DOTS = Markup('stroke-dasharray="2 4"')
_ROOM = 0.08
_MOST_Y, _MOST_X = 4, 10


def study_charts_html(values: Sequence[Sequence[Sequence[float]]], unit: str = "") -> Markup:
    """Return the charts of values [part][appraiser][trial]: by part, X-bar and R.

    The parts should differ by more than the control limits of X-bar, which are those of repeats; a range beyond its
    limit is a trial to look at. Limits are for two to five trials.
    """
    x = np.asarray(values, float)
    means, ranges = x.mean(axis=2), np.ptp(x, axis=2)
    spread, n = float(ranges.mean()), x.shape[2]
    known = n in K_OF_TRIALS
    s = K_OF_TRIALS[n] * spread if known else 0.0
    half, beyond = 3 * s / n**0.5, 3 * s * D3.get(n, 0.0)
    middle = float(means.mean())
    of_means = (middle - half, middle, middle + half) if known else (middle,)
    of_ranges = (max(0.0, spread - beyond), spread, spread + beyond) if known else (spread,)
    suffix = f", {unit}" if unit else ""
    return Markup("").join(
        (
            _chart("Means by part", f"Mean{suffix}", means, ()),
            _chart("X\u0304 chart of each appraiser", f"Mean{suffix}", means, of_means, apart=True),
            _chart("R chart of each appraiser", f"Range{suffix}", ranges, of_ranges, apart=True),
        )
    )


def _chart(
    name: str, title: str, cells: NDArray[np.float64], levels: tuple[float, ...], *, apart: bool = False
) -> Markup:
    """Return a line of cells [part, appraiser] for each appraiser; apart: side by side, else over the same parts."""
    parts, appraisers = cells.shape
    low, high = min((float(cells.min()), *levels)), max((float(cells.max()), *levels))
    room = _ROOM * (high - low) or 0.1
    ends = low - room, high + room
    across = (-0.5, (parts * appraisers if apart else parts) - 0.5)
    axes = ChartAxes.stretched(across, ends, _parts(parts, appraisers if apart else 1), round_ticks(ends, _MOST_Y))
    lines = [line_svg(axes.level(level), "ink3", 1.1, _DOTS) for level in levels]
    for k, column in enumerate(cells.T):
        first = k * parts if apart else 0
        points = "L".join(f"{axes.x.at(first + i):.1f} {axes.y.at(value):.1f}" for i, value in enumerate(column))
        lines.append(line_svg(f"M{points}", COLOURS[k % len(COLOURS)], 1.6))
    look = PlotLook(name, title, left_px=58, foot_px=22, style="height:130px")
    return Markup('<div class="wv-lab">{}</div>{}').format(name, plot_html(axes, look, Markup("").join(lines)))


def _parts(parts: int, times: int) -> tuple[Tick, ...]:
    """Return the numbers of the parts, as many as there is space for."""
    each = -(-parts * times // _MOST_X)
    return tuple((k, str(k % parts + 1)) for k in range(0, parts * times, each))
