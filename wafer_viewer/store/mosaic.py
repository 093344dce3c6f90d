"""A stitched surface on disk: a pyramid of levels in Zarr 3, one OME-NGFF 0.5 multiscale group for each layer.

Level l has pixels of 2^l pixels of level 0. z_min_um and z_max_um are the span of what a pixel stands for; at level 0
they would equal z_um, so their groups begin with level 1. The work is cut into shards that no two writers share.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Count, Positive, Spec, decode, encode
from wafer_viewer.model.surface import HeightMap, Mosaic, Origin, Provenance, pixel_window
from wafer_viewer.numerics.pyramid import Layers, halve
from wafer_viewer.store.files import replacing, writing
from wafer_viewer.store.progress import Progress, ShouldStop, watched

CHUNK, SHARD = 256, 2048
COARSEST_PX = 512
"""The pyramid ends with the first level that fits into this square: one picture of the whole surface."""
HEADER = "wafer_viewer.json"
FILLS: dict[str, float] = {
    "z_um": math.nan,
    "z_raw_um": math.nan,
    "z_min_um": math.nan,
    "z_max_um": math.nan,
    "confidence": 0.0,
    "all_in_focus": 0,
    "origin": Origin.NOT_COVERED,
}
_SPANS = ("z_min_um", "z_max_um")
_SURFACE = tuple(name for name in FILLS if name not in _SPANS)


class MosaicHeader(Spec, frozen=True, kw_only=True):
    """Where the lattice of a mosaic lies, how large it is, and where it comes from."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    pixel_um: Positive
    x0_um: float
    y0_um: float
    rows: Count
    cols: Count
    grey_bits: int
    provenance: Provenance

    @property
    def levels(self) -> int:
        """Levels of the pyramid, at least 2."""
        return _levels_for((self.rows, self.cols))

    def shape_of(self, level: int) -> tuple[int, int]:
        """(rows, cols) of a level."""
        return -(-self.rows // 2**level), -(-self.cols // 2**level)


@dataclass(frozen=True, slots=True)
class Shard:
    """A square of 2048 pixels of one level: the unit of work of one writer."""

    level: int
    row: int
    col: int

    def window(self, shape: tuple[int, int]) -> tuple[slice, slice]:
        """Its rows and columns in a level of a shape."""
        top, left = self.row * SHARD, self.col * SHARD
        return slice(top, min(top + SHARD, shape[0])), slice(left, min(left + SHARD, shape[1]))


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

    header = _header(source)
    with writing(path):
        root = zarr.open_group(path, mode="w", zarr_format=3)
        for name, fill in FILLS.items():
            group = root.create_group(name, attributes={"ome": _multiscale(header, name)})
            for level in _levels_of(name, header):
                shape = header.shape_of(level)
                group.create_array(
                    str(level),
                    shape=shape,
                    dtype=_dtype(name, header),
                    chunks=(CHUNK, CHUNK),
                    shards=(SHARD, SHARD),
                    fill_value=fill,
                    dimension_names=("y", "x"),
                )
        (path / HEADER).write_text(encode(header, "json"), encoding="utf-8")
    return header


def shards(shape: tuple[int, int]) -> list[Shard]:
    """All shards of a mosaic of a shape; those of a level need all those below them of the level before."""
    rows, cols = shape
    return [
        Shard(level, row, col)
        for level in range(_levels_for(shape))
        for row in range(math.ceil(rows / 2**level / SHARD))
        for col in range(math.ceil(cols / 2**level / SHARD))
    ]


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
            **{name: self.read(name, level, rows, cols) for name in _SURFACE},
            pixel_um=pixel_um,
            x0_um=self.x0_um + shift_um + cols.start * pixel_um,
            y0_um=self.y0_um - shift_um - rows.start * pixel_um,
            provenance=self.provenance,
        )

    def span(self, region: Region | None, level: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(lowest, highest) height under each pixel of what `window` returns, NaN where unmeasured."""
        rows, cols = self._window(region, level)
        low, high = ("z_um", "z_um") if level == 0 else _SPANS
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


def _levels_for(shape: tuple[int, int]) -> int:
    return 1 + max(1, math.ceil(math.log2(max(shape) / COARSEST_PX)))


def _header(source: Mosaic) -> MosaicHeader:
    rows, cols = source.shape
    corner = source.window(Region.rectangle(source.x0_um, source.y0_um, source.x0_um, source.y0_um))
    return MosaicHeader(
        pixel_um=source.pixel_um,
        x0_um=source.x0_um,
        y0_um=source.y0_um,
        rows=rows,
        cols=cols,
        grey_bits=corner.all_in_focus.dtype.itemsize * 8,
        provenance=source.provenance,
    )


def _dtype(name: str, header: MosaicHeader) -> str:
    return {"origin": "uint8", "all_in_focus": f"uint{header.grey_bits}"}.get(name, "float32")


def _levels_of(name: str, header: MosaicHeader) -> range:
    return range(1 if name in _SPANS else 0, header.levels)


def _multiscale(header: MosaicHeader, name: str) -> dict[str, Any]:
    """OME-NGFF 0.5: scale and place of each level in um, from the first pixel of level 0, y downward."""

    def dataset(level: int) -> dict[str, Any]:
        scale, shift = header.pixel_um * 2**level, header.pixel_um * (2**level - 1) / 2
        place = [{"type": "scale", "scale": [scale, scale]}, {"type": "translation", "translation": [shift, shift]}]
        return {"path": str(level), "coordinateTransformations": place}

    axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "yx"]
    datasets = [dataset(level) for level in _levels_of(name, header)]
    return {"version": "0.5", "multiscales": [{"name": name, "axes": axes, "datasets": datasets}]}


def _from_source(source: Mosaic, window: tuple[slice, slice]) -> Layers:
    rows, cols = window
    x, y = partial(_at, source.x0_um, source.pixel_um), partial(_at, source.y0_um, -source.pixel_um)
    part = source.window(Region.rectangle(x(cols.start), y(rows.start), x(cols.stop - 1), y(rows.stop - 1)))
    return {name: getattr(part, name) for name in _SURFACE}


def _at(first_um: float, pixel_um: float, index: int) -> float:
    return first_um + index * pixel_um


def _from_below(stored: ZarrMosaic, shard: Shard, window: tuple[slice, slice]) -> Layers:
    """The four shards below it, one after the other, each halved into its quarter."""
    shape = (window[0].stop - window[0].start, window[1].stop - window[1].start)
    whole: Layers = {name: np.full(shape, fill, _dtype(name, stored.header)) for name, fill in FILLS.items()}
    for row, col in ((0, 0), (0, 1), (1, 0), (1, 1)):
        below = Shard(shard.level - 1, 2 * shard.row + row, 2 * shard.col + col)
        rows, cols = below.window(stored.header.shape_of(below.level))
        if rows.start >= rows.stop or cols.start >= cols.stop:
            continue
        names = [name for name in FILLS if below.level in _levels_of(name, stored.header)]
        for name, layer in halve({name: stored.read(name, below.level, rows, cols) for name in names}).items():
            top, left = row * SHARD // 2, col * SHARD // 2
            whole[name][top : top + layer.shape[0], left : left + layer.shape[1]] = layer
    return whole
