"""A stitched surface on disk: a pyramid of levels in Zarr 3, one OME-NGFF 0.5 multiscale group for each layer.

Level l has pixels of 2^l pixels of level 0. z_min_um and z_max_um are the span of what a pixel stands for; at level 0
they would equal z_um, so their groups begin with level 1. The work is cut into shards that no two writers share.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import decode, encode
from wafer_viewer.model.surface import HeightMap, Mosaic, Provenance, pixel_window
from wafer_viewer.numerics.pyramid import Layers, halve
from wafer_viewer.store.files import replacing, writing
from wafer_viewer.store.mosaic_layout import (
    CHUNK,
    FILLS,
    HEADER,
    SHARD,
    SPANS,
    SURFACE,
    MosaicHeader,
    Shard,
    dtype_of,
    header_of,
    levels_of,
    multiscale,
    shards,
)
from wafer_viewer.store.progress import Progress, ShouldStop, watched


def write_mosaic(
    path: Path, source: Mosaic, progress: Progress | None = None, should_stop: ShouldStop | None = None
) -> ZarrMosaic:
    """Write a surface and its pyramid beside `path` and move it into place; memory for a few shards is enough.

    Raises DatasetError when the place cannot be written to or the work is stopped; then the place is as it was.
    """
    with replacing(path) as beside:
        lay_out(beside, source)
        work = shards(source.shape)
        for shard in watched(work, len(work), "Writing the mosaic", progress, should_stop):
            write_shard(beside, source, shard)
    return ZarrMosaic.open(path)


def lay_out(path: Path, source: Mosaic) -> MosaicHeader:
    """Make the empty mosaic: its header and all arrays. Shards can be written to it in parallel from then on."""
    import zarr

    header = header_of(source)
    with writing(path):
        root = zarr.open_group(path, mode="w", zarr_format=3)
        for name, fill in FILLS.items():
            group = root.create_group(name, attributes={"ome": multiscale(header, name)})
            for level in levels_of(name, header):
                shape = header.shape_of(level)
                group.create_array(
                    str(level),
                    shape=shape,
                    dtype=dtype_of(name, header),
                    chunks=(CHUNK, CHUNK),
                    shards=(SHARD, SHARD),
                    fill_value=fill,
                    dimension_names=("y", "x"),
                )
        (path / HEADER).write_text(encode(header, "json"), encoding="utf-8")
    return header


def write_shard(path: Path, source: Mosaic, shard: Shard) -> None:
    """Write one shard: at level 0 from the source, above it from the level before, which must be there."""
    stored = ZarrMosaic.open(path)
    window = shard.window(stored.header.shape_of(shard.level))
    layers = _from_source(source, window) if shard.level == 0 else _from_below(stored, shard, window)
    with writing(path):
        for name, layer in layers.items():
            stored.array(name, shard.level)[window] = layer


class ZarrMosaic:
    """A mosaic on disk; a window is read when it is asked for. Cheap to send to another process."""

    def __init__(self, path: Path, header: MosaicHeader) -> None:
        self.path, self.header = path, header
        self._arrays: dict[tuple[str, int], Any] = {}

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a mosaic. Raises DatasetError when the folder holds none."""
        try:
            text = (path / HEADER).read_bytes()
        except OSError as fault:
            raise DatasetError(
                f"{path} is no mosaic of Wafer Viewer, it has no {HEADER}: stitch the fields."
            ) from fault
        return cls(path, decode(text, MosaicHeader, str(path / HEADER), "json"))

    def __reduce__(self) -> tuple[Callable[..., ZarrMosaic], tuple[Path, MosaicHeader]]:
        return type(self), (self.path, self.header)

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.header.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0) of level 0."""
        return self.header.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0) of level 0."""
        return self.header.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.header.shape_of(0)

    @property
    def levels(self) -> int:
        """Number of levels."""
        return self.header.levels

    @property
    def provenance(self) -> Provenance:
        """Where it comes from."""
        return self.header.provenance

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """The part of a level that holds a region, all of it without one.

        Raises MeasureError when the region lies outside, DatasetError when there is no such level.
        """
        rows, cols = self._window(region, level)
        pixel_um, shift_um = self.pixel_um * 2**level, (2**level - 1) / 2 * self.pixel_um
        return HeightMap(
            **{name: self.read(name, level, rows, cols) for name in SURFACE},
            pixel_um=pixel_um,
            x0_um=self.x0_um + shift_um + cols.start * pixel_um,
            y0_um=self.y0_um - shift_um - rows.start * pixel_um,
            provenance=self.provenance,
        )

    def span(self, region: Region | None, level: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(lowest, highest) height under each pixel of what `window` returns, NaN where unmeasured."""
        rows, cols = self._window(region, level)
        low, high = ("z_um", "z_um") if level == 0 else SPANS
        return self.read(low, level, rows, cols), self.read(high, level, rows, cols)

    def read(self, name: str, level: int, rows: slice, cols: slice) -> NDArray[Any]:
        """A part of one layer of a level."""
        return np.asarray(self.array(name, level)[rows, cols])

    def array(self, name: str, level: int) -> Any:
        """The Zarr array of a layer at a level. Raises DatasetError when it is not there."""
        import zarr

        place = self.path / name / str(level)
        if (name, level) not in self._arrays:
            try:
                self._arrays[name, level] = zarr.open_array(place, mode="r+")
            except (OSError, KeyError, ValueError) as fault:
                raise DatasetError(f"{place} is missing or damaged: stitch the fields again.") from fault
        return self._arrays[name, level]

    def _window(self, region: Region | None, level: int) -> tuple[slice, slice]:
        if not 0 <= level < self.levels:
            raise DatasetError(
                f"{self.path.name} has levels 0 to {self.levels - 1} and no level {level}: take one of them."
            )
        if region is not None:
            return pixel_window(self, region, level)
        rows, cols = self.header.shape_of(level)
        return slice(0, rows), slice(0, cols)


def _from_source(source: Mosaic, window: tuple[slice, slice]) -> Layers:
    rows, cols = window
    x, y = partial(_at, source.x0_um, source.pixel_um), partial(_at, source.y0_um, -source.pixel_um)
    part = source.window(Region.rectangle(x(cols.start), y(rows.start), x(cols.stop - 1), y(rows.stop - 1)))
    return {name: getattr(part, name) for name in SURFACE}


def _at(first_um: float, pixel_um: float, index: int) -> float:
    return first_um + index * pixel_um


def _from_below(stored: ZarrMosaic, shard: Shard, window: tuple[slice, slice]) -> Layers:
    """The four shards below it, one after the other, each halved into its quarter."""
    shape = (window[0].stop - window[0].start, window[1].stop - window[1].start)
    whole: Layers = {name: np.full(shape, fill, dtype_of(name, stored.header)) for name, fill in FILLS.items()}
    for row, col in ((0, 0), (0, 1), (1, 0), (1, 1)):
        below = Shard(shard.level - 1, 2 * shard.row + row, 2 * shard.col + col)
        rows, cols = below.window(stored.header.shape_of(below.level))
        if rows.start >= rows.stop or cols.start >= cols.stop:
            continue
        names = [name for name in FILLS if below.level in levels_of(name, stored.header)]
        for name, layer in halve({name: stored.read(name, below.level, rows, cols) for name in names}).items():
            top, left = row * SHARD // 2, col * SHARD // 2
            whole[name][top : top + layer.shape[0], left : left + layer.shape[1]] = layer
    return whole
