"""Lines and labels draped over a surface at its true heights; the scene nodes apply the exaggeration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.session.rendering.render_request import CoarseHeightField

Floats = NDArray[np.float64]
_FINE = 4
"""Height samples between two vertices of a line, so that the line passes over the heights between them."""
_MOST_SEGMENTS = 60_000


class DrapedLines:
    """Draping of lines on heights relative to `z0_um`, in mm; flat if there is no relief.

    span_um: length of a straight piece. Lines pass straight over narrower structures.
    """

    def __init__(self, relief: CoarseHeightField | None, z0_um: float, span_um: float) -> None:
        self._relief, self._z0_um, self._span_um = relief, z0_um, span_um
        if relief is not None:
            self._z_um = np.frombuffer(relief.z_um, "<f4").reshape(relief.rows, relief.cols)

    def z_mm(self, x_um: Floats, y_um: Floats) -> Floats:
        """Return the height of the nearest pixel at each position; outside of the surface that of the edge."""
        relief = self._relief
        if relief is None:
            return np.zeros(np.shape(x_um))
        col = np.clip(np.rint((x_um - relief.x0_um) / relief.pixel_um), 0, relief.cols - 1).astype(np.intp)
        row = np.clip(np.rint((relief.y0_um - y_um) / relief.pixel_um), 0, relief.rows - 1).astype(np.intp)
        return (self._z_um[row, col].astype(np.float64) - self._z0_um) * 1e-3

    def highest_mm(self, boxes_um: Floats) -> Floats:
        """Return a robust maximum height (97th percentile) within each box [n, 4]."""
        share = np.linspace(0, 1, 12)
        x = boxes_um[:, 0, None] + (boxes_um[:, 2] - boxes_um[:, 0])[:, None] * share
        y = boxes_um[:, 1, None] + (boxes_um[:, 3] - boxes_um[:, 1])[:, None] * share
        z = self.z_mm(*np.broadcast_arrays(x[:, None, :], y[:, :, None]))
        return np.percentile(z.reshape(len(boxes_um), -1), 97, axis=1) if len(boxes_um) else np.zeros(0)

    def segments(self, pieces_um: Floats) -> NDArray[np.float32]:
        """Return straight pieces [n, 2, 2] as segments that follow the surface, float32 [m, 2, 3] in mm."""
        if not len(pieces_um):
            return np.zeros((0, 2, 3), np.float32)
        m = self._corners(pieces_um)
        share = np.linspace(0, 1, m * _FINE + 1)[:, None]
        places = pieces_um[:, None, 0] + (pieces_um[:, 1] - pieces_um[:, 0])[:, None] * share
        z = self.z_mm(places[..., 0], places[..., 1])
        around = np.pad(z, ((0, 0), (_FINE, _FINE)), mode="edge")
        highest = np.lib.stride_tricks.sliding_window_view(around, 2 * _FINE + 1, axis=1).max(axis=2)
        points = np.concatenate([places * 1e-3, highest[..., None]], axis=2)[:, ::_FINE]
        return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3).astype(np.float32)

    def level(self, figures_um: Floats) -> NDArray[np.float32]:
        """Return figures of straight pieces [n, m, 2, 2] as segments, each figure level above the heights it covers."""
        if not len(figures_um):
            return np.zeros((0, 2, 3), np.float32)
        share = np.linspace(0, 1, 4 * _FINE)[:, None]
        shafts = figures_um[:, :, None, 0] + (figures_um[:, :, 1] - figures_um[:, :, 0])[:, :, None] * share
        highest = self.z_mm(shafts[..., 0], shafts[..., 1]).max(axis=(1, 2))
        z = np.broadcast_to(highest[:, None, None, None], (*figures_um.shape[:3], 1))
        return np.concatenate([figures_um * 1e-3, z], axis=3).reshape(-1, 2, 3).astype(np.float32)

    def _corners(self, pieces_um: Floats) -> int:
        """Return the number of parts per piece: one per span, limited by `_MOST_SEGMENTS`."""
        if self._relief is None:
            return 1
        longest = float(np.hypot(*(pieces_um[:, 1] - pieces_um[:, 0]).T).max())
        wanted = round(longest / self._span_um)
        return int(np.clip(wanted, 1, max(1, _MOST_SEGMENTS // len(pieces_um))))
