"""Hysteresis of the display parameters of a growing surface: kept as long as they approximately fit.

Lighting, the height drawn at 0 and the colour range are derived from the entire surface. If they were recomputed with
every added field, every tile would have to be rendered again and measured parts would change colour.
"""

from __future__ import annotations

from collections.abc import Hashable

import msgspec
import numpy as np

from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.session.rendering.render_request import ColourScale, SurfaceKey, SurfaceStatistics

_HEIGHTS, _RANGE, _DEEPER = 0.12, 0.04, 0.02
"""Tolerances as fractions of the span: heights, colour range, and depth below the lowest displayed height."""
_GAIN = 1.25


class DisplayRangeHysteresis:
    """Retained display statistics and colour scale of one scene."""

    def __init__(self) -> None:
        self._facts: tuple[Hashable, SurfaceStatistics] | None = None
        self._scale: tuple[Hashable, ColourScale] | None = None

    def facts(self, source: SurfaceKey, view: View, now: SurfaceStatistics) -> SurfaceStatistics:
        """Return the statistics of a surface with the previous heights and lighting, if they still fit."""
        of = (_place(source), view.colour_by in ("deviation", "form"))
        if self._facts is None or self._facts[0] != of or not _fits(self._facts[1], now, of[1]):
            self._facts = of, now
        held = self._facts[1]
        return msgspec.structs.replace(
            now,
            lowest_um=held.lowest_um,
            low_um=held.low_um,
            high_um=held.high_um,
            gain=held.gain,
            plane=held.plane,
            form=held.form,
        )

    def scale(self, source: SurfaceKey, view: View, now: ColourScale) -> ColourScale:
        """Return the scale with the previous colour range if it still fits; a manual range is unchanged."""
        if view.range_um is not None:
            return now
        of, spare = (_place(source), now.quantity), _RANGE * (now.high - now.low)
        held = self._scale[1] if self._scale is not None and self._scale[0] == of else None
        if held is None or max(abs(held.low - now.low), abs(held.high - now.high)) > spare:
            self._scale = of, now
            return now
        return msgspec.structs.replace(now, low=held.low, high=held.high)


def _place(source: SurfaceKey) -> Hashable:
    return source.dataset, source.result, source.show


def _fits(held: SurfaceStatistics, now: SurfaceStatistics, with_plane: bool) -> bool:
    span = max(held.high_um - held.low_um, 1e-6)
    moved = max(abs(held.low_um - now.low_um), abs(held.high_um - now.high_um), now.lowest_um - held.lowest_um)
    deeper = held.lowest_um - now.lowest_um > _DEEPER * span
    relit = not 1 / _GAIN < now.gain / held.gain < _GAIN
    return (
        moved <= _HEIGHTS * span and not deeper and not relit and not (with_plane and _plane_changed(held, now, span))
    )


def _plane_changed(held: SurfaceStatistics, now: SurfaceStatistics, span: float) -> bool:
    """Return whether the reference plane of deviations differs noticeably at the corners of the surface."""
    x = now.x0_um + np.array([now.first_col, now.end_col]) * now.pixel_um
    y = now.y0_um - np.array([now.first_row, now.end_row]) * now.pixel_um
    (a, b, c), (a0, b0, c0) = now.plane, held.plane
    off = np.abs((a - a0) * x[:, None] + (b - b0) * y[None, :] + (c - c0))
    return bool(off.max() > _DEEPER * span)


def as_planned(facts: SurfaceStatistics, plan: ScanPlan) -> SurfaceStatistics:
    """Return the statistics with a window that covers all planned fields, so that it stays constant during a scan."""
    half_x, half_y = plan.cols * plan.pixel_um / 2, plan.rows * plan.pixel_um / 2
    x, y = [f.x_um for f in plan.fields], [f.y_um for f in plan.fields]
    cols = _indices((min(x) - half_x - facts.x0_um, max(x) + half_x - facts.x0_um), facts.pixel_um, facts.cols)
    rows = _indices((facts.y0_um - max(y) - half_y, facts.y0_um - min(y) + half_y), facts.pixel_um, facts.rows)
    return msgspec.structs.replace(
        facts,
        first_row=min(rows[0], facts.first_row),
        end_row=max(rows[1], facts.end_row),
        first_col=min(cols[0], facts.first_col),
        end_col=max(cols[1], facts.end_col),
    )


def _indices(ends_um: tuple[float, float], pixel_um: float, n: int) -> tuple[int, int]:
    first, end = round(ends_um[0] / pixel_um), round(ends_um[1] / pixel_um)
    return min(max(0, first), n - 1), min(max(1, end), n)
