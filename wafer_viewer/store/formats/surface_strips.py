"""Strip-wise access to a surface, at full or lower density, for surfaces larger than memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, PartOfMosaic
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic

STRIP_ROWS = 256
"""Rows of full density in memory at a time, as many as in a mosaic chunk."""


@dataclasses.dataclass(frozen=True, slots=True)
class Strips:
    """Every n-th row and column of a surface, from the top edge down.

    For progress reports, a writer with several passes gives the index and the number of passes.
    """

    surface: HeightMap | Mosaic
    every: int = 1
    progress: Progress | None = None
    should_stop: ShouldStop | None = None

    def __post_init__(self) -> None:
        if self.every < 1:
            raise DatasetError(f"Every {self.every}th pixel cannot be written: take 1 for all, 2 for every other, ….")

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the written surface."""
        rows, cols = self.surface.shape
        return -(-rows // self.every), -(-cols // self.every)

    @property
    def pixel_um(self) -> float:
        """Distance between written pixels in um."""
        return self.surface.pixel_um * self.every

    @property
    def has_uncertainty(self) -> bool:
        """True if the surface has the layer of uncertainties."""
        return self.surface.window(Region.point(self.surface.x0_um, self.surface.y0_um)).u_um is not None

    def layer(self, name: str, part: int = 0, of: int = 1) -> Iterator[NDArray[Any]]:
        """Yield a layer strip by strip."""
        for rows in self._watched(part, of):
            yield self._read(name, rows)

    def maps(self, part: int = 0, of: int = 1) -> Iterator[HeightMap]:
        """Yield all layers strip by strip."""
        for rows in self._watched(part, of):
            strip = _window(self.surface, rows)
            yield strip if self.every == 1 else thinned(strip, self.every)

    def _watched(self, part: int, of: int) -> Iterator[slice]:
        rows, step = self.surface.shape[0], max(1, STRIP_ROWS // self.every) * self.every
        runs = [slice(top, min(top + step, rows)) for top in range(0, rows, step)]
        tell, total = self.progress, len(runs)

        def report(done: float) -> None:
            if tell is not None:
                tell((part + done) / of)

        yield from with_progress(runs, total, "Writing the surface", report, self.should_stop)

    def _read(self, name: str, rows: slice) -> NDArray[Any]:
        surface, top, left = self.surface, 0, 0
        if isinstance(surface, PartOfMosaic):
            surface, top, left = surface.surface, surface.rows.start, surface.cols.start
        if isinstance(surface, ZarrMosaic):
            cols = slice(left, left + self.surface.shape[1])
            strip = surface.read(name, 0, slice(top + rows.start, top + rows.stop), cols)
        else:
            strip = getattr(_window(self.surface, rows), name)
        return strip[:: self.every, :: self.every]


def thinned(surface: HeightMap, every: int) -> HeightMap:
    """Return every n-th row and column of a map: measured heights, not means."""
    sparse = slice(None, None, every)
    names = (
        "z_um",
        "z_raw_um",
        "confidence",
        "all_in_focus",
        "origin",
        *(("u_um",) if surface.u_um is not None else ()),
    )
    layers = {
        name: getattr(surface, name)[sparse, sparse].copy() for name in names
    }  # a view would keep the full array in memory
    return dataclasses.replace(surface, **layers, overlap_um=None, pixel_um=surface.pixel_um * every)


def _window(surface: HeightMap | Mosaic, rows: slice) -> HeightMap:
    if isinstance(surface, HeightMap):
        return surface.crop(rows, slice(0, surface.shape[1]))
    last_x_um = surface.x0_um + (surface.shape[1] - 1) * surface.pixel_um
    top_um, bottom_um = (surface.y0_um - row * surface.pixel_um for row in (rows.start, rows.stop - 1))
    return surface.window(Region.rectangle(surface.x0_um, bottom_um, last_x_um, top_um))
