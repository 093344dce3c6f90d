"""Side-by-side view of two surfaces on one lattice, with the second to the right of the first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance
from wafer_viewer.reconstruct.comparison.resampled_surface import ResampledMosaic, SampleGrid

GAP = 0.06
"""Gap between the surfaces, as a fraction of the width of one."""


@dataclass(frozen=True, eq=False)
class SideBySideMosaic:
    """A `Mosaic` of the first surface and the one aligned to it, which is `offset` columns further right."""

    laid: ResampledMosaic

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.laid.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0) of level 0, of the first."""
        return self.laid.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0) of level 0."""
        return self.laid.y0_um

    @property
    def offset(self) -> int:
        """Columns of level 0 between a position on the first and on the second; a multiple of every level's pixel."""
        whole = 2 ** (self.levels - 1)
        return -(-round((1 + GAP) * self.laid.shape[1]) // whole) * whole

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.laid.shape[0], self.offset + self.laid.shape[1]

    @property
    def levels(self) -> int:
        """Number of levels available in both."""
        return self.laid.levels

    @property
    def provenance(self) -> Provenance:
        """Provenance of the first surface."""
        return self.laid.first.provenance

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that holds a region, which may span both surfaces."""
        lattice = SampleGrid.of(self, region, level)
        parts = [self._part(k, lattice, level) for k in (0, 1)]
        known = [part for part in parts if part is not None]
        grey = known[0].all_in_focus.dtype if known else np.dtype(np.uint8)
        layers: dict[str, Any] = {
            "z_um": np.full(lattice.shape, np.nan, np.float32),
            "z_raw_um": np.full(lattice.shape, np.nan, np.float32),
            "confidence": np.zeros(lattice.shape, np.float32),
            "all_in_focus": np.zeros(lattice.shape, grey),
            "origin": np.full(lattice.shape, Origin.NOT_COVERED, np.uint8),
        }
        for k, part in enumerate(parts):
            if part is not None:
                _paste(layers, part, round((part.x0_um + k * self._off_um - lattice.x0_um) / lattice.pixel_um))
        return HeightMap(
            **layers,
            pixel_um=lattice.pixel_um,
            x0_um=lattice.x0_um,
            y0_um=lattice.y0_um,
            provenance=self.provenance,
        )

    @property
    def _off_um(self) -> float:
        return self.offset * self.pixel_um

    def _part(self, k: int, lattice: SampleGrid, level: int) -> HeightMap | None:
        """Return the part of the first (0) or second (1) surface in a window; None if there is none."""
        xa, ya, xb, yb = lattice.bounds_um
        off = k * self._off_um
        try:
            part = (self.laid.first, self.laid)[k].window(Region.rectangle(xa - off, ya, xb - off, yb), level)
        except MeasureError:
            return None
        return part


def _paste(layers: dict[str, Any], part: HeightMap, col: int) -> None:
    """Copy a part to its columns of a window of equal height, with its image converted to the window's depth."""
    left, right = max(col, 0), min(col + part.shape[1], layers["z_um"].shape[1])
    for name, layer in layers.items():
        values = getattr(part, name)[: layer.shape[0], left - col : right - col]
        shift = 8 * (values.dtype.itemsize - layer.dtype.itemsize) if name == "all_in_focus" else 0
        layer[: values.shape[0], left:right] = values >> shift if shift > 0 else values
