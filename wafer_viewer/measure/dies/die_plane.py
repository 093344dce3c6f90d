"""Height offset and tilt of a die relative to the others: plane through the residual heights. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wafer_viewer.measure.base.robust_plane import robust_fit
from wafer_viewer.measure.dies.die_cells import Plane

POINTS, LEAST_POINTS = 6_000, 50


@dataclass(frozen=True, slots=True)
class DiePlane:
    """Slopes in um per pixel down and right, and height in um at pixel (0, 0) of a cell."""

    down: float = 0.0
    right: float = 0.0
    zero_um: float = 0.0

    @classmethod
    def of(cls, z_um: Plane) -> DiePlane:
        """Fit a plane to the measured pixels with outlier rejection; zero with too few pixels."""
        step = max(1, round((z_um.size / POINTS) ** 0.5))
        some = z_um[::step, ::step]
        rows, cols = np.nonzero(np.isfinite(some))
        if len(rows) < LEAST_POINTS:
            return cls()
        design = np.stack([rows * float(step), cols * float(step), np.ones(len(rows))], axis=1).astype(np.float64)
        return cls(*robust_fit(design, some[rows, cols].astype(np.float64)).coefficients.tolist())

    def at(self, row: float, col: float) -> float:
        """Return the height at a pixel, um."""
        return self.down * row + self.right * col + self.zero_um

    def seen_from(self, row: float, col: float) -> DiePlane:
        """Return the same plane with another pixel as origin."""
        return replace(self, zero_um=self.at(row, col))

    def off(self, z_um: Plane) -> Plane:
        """Subtract the plane from heights."""
        rows, cols = z_um.shape
        plane = self.down * np.arange(rows)[:, None] + self.right * np.arange(cols)[None, :] + self.zero_um
        return z_um - plane.astype(np.float32)
