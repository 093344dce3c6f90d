"""Stitched surface on disk: a pyramid in Zarr 3, one OME-NGFF 0.5 multiscale for each layer.

A pixel of level l covers 2^l pixels of level 0 along each axis and is the mean of the measured ones. The layers n_*
hold the numbers of pixels that its means are of, z_min_um and z_max_um the range of measured heights below it; both
begin with level 1. The work is divided into patches that share no shard. Each shard is replaced by an atomic rename, so
that readers can continue while patches are rewritten.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import decode
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import (
    EXTREMES,
    AsArray,
    HeightLayer,
    HeightMap,
    Heights,
    Mosaic,
    Origin,
    Provenance,
    TexturedHeights,
    picture_of,
    pixel_window,
)
from wafer_viewer.store.io.atomic_files import atomic_write, os_errors_as_dataset_errors, write_text
from wafer_viewer.store.io.checksums import Checksum, damaged, remedy, sealed_node, text_state
from wafer_viewer.store.mosaic import zarr_shards
from wafer_viewer.store.mosaic.poses_file import POSES, read_poses
from wafer_viewer.store.mosaic.statistics import FACTS, MosaicStatistics, facts_array, load_statistics, save_statistics
from wafer_viewer.store.mosaic.zarr_shards import (
    CHUNK,
    FILLS,
    GROUP,
    OWN,
    SURFACE,
    MosaicHeader,
    ShardedArray,
    as_json,
    codecs,
    cut,
    header_of,
    levels_for,
    levels_of,
    ome_of_layer,
    ome_of_root,
    shards_of,
)

if TYPE_CHECKING:
    from wafer_viewer.numerics.grids.pyramid_level import Layers


Window = tuple[slice, slice]
"""Rows and columns."""


@dataclass(frozen=True, slots=True)
class Patch:
    """Chunks of one shard of a level from 1 on: rows top ... bottom - 1 and columns left ... right - 1.

    It is computed from the level below; a patch of level 1 also writes level 0.
    """

    level: int
    top: int
    bottom: int
    left: int
    right: int

    @property
    def rows(self) -> slice:
        """Rows in the level."""
        return slice(self.top, self.bottom)

    @property
    def cols(self) -> slice:
        """Columns in the level."""
        return slice(self.left, self.right)

    def below(self, shape: tuple[int, int]) -> list[Window]:
        """Return the source windows in the level below, one per shard; `shape` is that of the level below."""
        ends = min(2 * self.bottom, shape[0]), min(2 * self.right, shape[1])
        return [
            (rows, cols)
            for rows in cut(2 * self.top, ends[0], zarr_shards.SHARD)
            for cols in cut(2 * self.left, ends[1], zarr_shards.SHARD)
        ]


def patches(shape: tuple[int, int], windows: Iterable[Window] | None = None) -> list[Patch]:
    """Return the patches that cover some windows of level 0 (default: all of it) of a mosaic of a shape.

    They are ordered by level; patches of one level can be written in parallel.
    """
    windows = [(slice(0, shape[0]), slice(0, shape[1]))] if windows is None else windows
    of_level: list[Patch] = []
    found: list[Patch] = []
    for level in range(1, levels_for(shape)):
        of_level = _patches(level, _shape_of(shape, level), [(_halved(r), _halved(c)) for r, c in windows])
        windows = [(patch.rows, patch.cols) for patch in of_level]
        found += of_level
    return found


def _patches(level: int, shape: tuple[int, int], windows: Sequence[Window]) -> list[Patch]:
    """Return the patches of a level that cover some of its windows: one for each shard."""
    hulls: dict[tuple[int, int], tuple[int, int, int, int]] = {}
    for rows, cols in windows:
        for part_r in cut(rows.start, min(rows.stop, shape[0]), zarr_shards.SHARD):
            for part_c in cut(cols.start, min(cols.stop, shape[1]), zarr_shards.SHARD):
                shard = part_r.start // zarr_shards.SHARD, part_c.start // zarr_shards.SHARD
                here = part_r.start, part_r.stop, part_c.start, part_c.stop
                hulls[shard] = _hull(hulls.get(shard, here), here)
    return [_aligned(level, shape, hull) for _, hull in sorted(hulls.items())]


def _hull(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


def _aligned(level: int, shape: tuple[int, int], hull: tuple[int, int, int, int]) -> Patch:
    """Return the patch of all chunks in a bounding box."""
    top, bottom, left, right = hull
    chunk = zarr_shards.CHUNK
    bottom, right = (min(-(-end // chunk) * chunk, size) for end, size in zip((bottom, right), shape, strict=True))
    return Patch(level, top // chunk * chunk, bottom, left // chunk * chunk, right)


def _halved(run: slice) -> slice:
    return slice(run.start // 2, -(-run.stop // 2))


def _shape_of(shape: tuple[int, int], level: int) -> tuple[int, int]:
    return -(-shape[0] // 2**level), -(-shape[1] // 2**level)


__all__ = [
    "Patch",
    "ZarrMosaic",
    "lay_out",
    "patches",
    "rewrite_header",
    "write_mosaic",
    "write_patch",
]


def write_mosaic(
    path: Path,
    source: Mosaic,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    threads: int = 1,
) -> ZarrMosaic:
    """Write a surface and its pyramid to a temporary path and move it to `path`; a few shards fit in memory.

    Raises DatasetError when the path cannot be written to or the work is stopped; then `path` is unchanged.
    """
    with atomic_write(path) as temporary:
        lay_out(temporary, source)
        _write(temporary, source, patches(source.shape), progress, should_stop, threads)
    return ZarrMosaic.open(path)


def lay_out(path: Path, source: Mosaic) -> MosaicHeader:
    """Create the empty mosaic, header and arrays; patches can then be written in parallel."""
    import zarr

    header = header_of(source)
    with os_errors_as_dataset_errors(path):
        attributes = {OWN: as_json(header), "ome": ome_of_root(header)}
        root = zarr.create_group(path, overwrite=True, zarr_format=3, attributes=attributes)
        root.create_array(FACTS, **facts_array(header.shape_of(0)))
        for name, fill in FILLS.items():
            group = root.create_group(name, attributes={"ome": ome_of_layer(header, name)})
            for level in levels_of(name, header):
                group.create_array(
                    str(level),
                    shape=header.shape_of(level),
                    dtype=shards_of(name, header, level).dtype,
                    chunks=(zarr_shards.CHUNK, zarr_shards.CHUNK),
                    shards=(zarr_shards.SHARD, zarr_shards.SHARD),
                    compressors=codecs(),
                    fill_value=fill,
                    dimension_names=("y", "x"),
                )
        for node in path.rglob(GROUP):
            node.write_text(sealed_node(json.loads(node.read_bytes())), encoding="utf-8")
    return header


def rewrite_header(path: Path, source: Mosaic) -> None:
    """Update the provenance in the header from a source on the same lattice, after windows were rewritten.

    Raises DatasetError when the source has another lattice.
    """
    old, new = ZarrMosaic.open(path).header, header_of(source)
    if old.lattice != new.lattice:
        raise DatasetError(f"{path} lies on another lattice than what it is to show: stitch the fields again.")
    root = json.loads((path / GROUP).read_bytes())
    root["attributes"][OWN] = as_json(new)
    write_text(path / GROUP, sealed_node(root))


def write_patch(path: Path, source: Mosaic, patch: Patch) -> None:
    """Write one patch from the level below; a patch of level 1 first writes level 0 from the source.

    Idempotent. Raises DatasetError when the path cannot be written to.
    """
    from wafer_viewer.numerics.grids.pyramid_level import halve

    stored = ZarrMosaic.open(path)
    shape = patch.bottom - patch.top, patch.right - patch.left
    layers: Layers = {
        name: np.full(shape, FILLS[name], shards_of(name, stored.header, patch.level).dtype) for name in FILLS
    }
    below = partial(_drawn, stored, source) if patch.level == 1 else partial(stored.layers, patch.level - 1)
    for rows, cols in patch.below(stored.header.shape_of(patch.level - 1)):
        top, left = rows.start // 2 - patch.top, cols.start // 2 - patch.left
        for name, half in halve(below(rows, cols)).items():
            if name in layers:
                layers[name][top : top + half.shape[0], left : left + half.shape[1]] = half
    _write_layers(stored, patch.level, patch.top, patch.left, layers)


def _write(
    path: Path,
    source: Mosaic,
    work: Sequence[Patch],
    progress: Progress | None,
    should_stop: ShouldStop | None,
    threads: int,
) -> None:
    """Write all patches, those of one level in parallel."""
    with ThreadPoolExecutor(threads) as pool:
        each: Iterable[None] = (
            done
            for _, of_level in groupby(work, lambda patch: patch.level)
            for done in pool.map(partial(write_patch, path, source), of_level)
        )
        try:
            for _ in with_progress(each, len(work), "Writing the mosaic", progress, should_stop):
                pass
        finally:
            pool.shutdown(cancel_futures=True)


def _drawn(stored: ZarrMosaic, source: Mosaic, rows: slice, cols: slice) -> Layers:
    """Write a window of level 0 from the source, and return its layers."""
    x, y = partial(_at, source.x0_um, source.pixel_um), partial(_at, source.y0_um, -source.pixel_um)
    part = source.window(Region.rectangle(x(cols.start), y(rows.start), x(cols.stop - 1), y(rows.stop - 1)))
    unknown = np.full(part.shape, np.nan, np.float32)
    held = ((name, getattr(part, name)) for name in SURFACE)
    layers: Layers = {name: unknown if layer is None else layer for name, layer in held}
    _write_layers(stored, 0, rows.start, cols.start, layers)
    with os_errors_as_dataset_errors(stored.path):
        save_statistics(stored.path, stored.shape, rows.start, cols.start, layers)
    return layers


def _write_layers(stored: ZarrMosaic, level: int, top: int, left: int, layers: Layers) -> None:
    for name, layer in layers.items():
        with os_errors_as_dataset_errors(stored.path):
            stored.array(name, level).write(layer, top, left)


def _at(first_um: float, pixel_um: float, index: int) -> float:
    return first_um + index * pixel_um


class ZarrMosaic(AsArray):
    """Mosaic on disk with lazy windows; cheap to pickle."""

    def __init__(self, path: Path, header: MosaicHeader) -> None:
        self.path, self.header = path, header

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a mosaic. Raises DatasetError when the folder holds none, or its header is damaged."""
        foreign = DatasetError(f"{path} is not a mosaic of Wafer Viewer, or is damaged: {remedy(path)}.")
        with parser_errors_as(lambda _: foreign):
            text = (path / GROUP).read_bytes()
            if text_state(text) is Checksum.DAMAGED:
                raise damaged(path / GROUP)
            root = json.loads(text)
            own = json.dumps(root["attributes"][OWN]).encode()
        return cls(path, decode(own, MosaicHeader, str(path / GROUP), "json"))

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
        """Provenance of the surface."""
        return self.header.provenance

    @cached_property
    def poses(self) -> Poses | None:
        """Field poses from the enclosing result; None if it has none."""
        file = self.path.parent / POSES
        return read_poses(file) if file.exists() else None

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that contains a region, by default all of it.

        Raises MeasureError when the region is outside, DatasetError when there is no such level.
        """
        rows, cols = self._window(region, level)
        layers = {name: self.read(name, level, rows, cols) for name in SURFACE}
        pixel_um, x0_um, y0_um = self._lattice(level, rows, cols)
        return HeightMap(
            **layers, refused=None, pixel_um=pixel_um, x0_um=x0_um, y0_um=y0_um, provenance=self.provenance
        )

    def one_layer(self, layer: HeightLayer, region: Region, level: int = 0) -> Heights:
        """Return a single height layer of `window`; raises as `window` does."""
        rows, cols = self._window(region, level)
        z_um = self.read("z_raw_um" if layer == "unsmoothed" else "z_um", level, rows, cols)
        if layer == "smoothed":
            z_um[self.read("origin", level, rows, cols) != Origin.MEASURED] = np.nan
        return Heights(z_um, *self._lattice(level, rows, cols))

    def pictured(self, layer: HeightLayer, region: Region, level: int = 0) -> TexturedHeights:
        """Return a single height layer with the image of `window`; raises as `window` does."""
        rows, cols = self._window(region, level)
        picture = picture_of(*(self.read(name, level, rows, cols) for name in ("all_in_focus", "origin")))
        alone = self.one_layer(layer, region, level)
        return TexturedHeights(alone.z_um, alone.pixel_um, alone.x0_um, alone.y0_um, picture)

    def span(self, region: Region | None, level: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return (lowest, highest) measured height under each pixel of `window`, NaN where there is none."""
        rows, cols = self._window(region, level)
        if level > 0:
            low, high = (self.read(name, level, rows, cols) for name in EXTREMES)
            return low, high
        z_um = self.read("z_um", 0, rows, cols)
        z_um[self.read("origin", 0, rows, cols) != Origin.MEASURED] = np.nan
        return z_um, z_um

    def facts(self) -> MosaicStatistics:
        """Return the statistics. Raises DatasetError when they are missing or damaged."""
        return load_statistics(self.path, self.shape)

    def covered(self) -> tuple[slice, slice]:
        """Return the rows and columns of level 0 from the first to the last that a field covers; all without any."""
        n_rows, n_cols = self.shape
        every_row, every_col = slice(0, n_rows), slice(0, n_cols)
        rows = _extent(n_rows, lambda rows: (self.read("origin", 0, rows, every_col) != Origin.NOT_COVERED).any(axis=1))
        cols = _extent(n_cols, lambda cols: (self.read("origin", 0, every_row, cols) != Origin.NOT_COVERED).any(axis=0))
        return rows or every_row, cols or every_col

    def layers(self, level: int, rows: slice, cols: slice) -> Layers:
        """Return a part of all layers of a level."""
        names = [name for name in FILLS if level in levels_of(name, self.header)]
        return {name: self.read(name, level, rows, cols) for name in names}

    def read(self, name: str, level: int, rows: slice, cols: slice) -> NDArray[Any]:
        """Return a part of one layer of a level. Raises DatasetError when it is missing or a shard is damaged."""
        return self.array(name, level).read(rows, cols)

    def array(self, name: str, level: int) -> ShardedArray:
        """Return the array of a layer at a level. Raises DatasetError when it does not exist."""
        return ShardedArray.open(
            self.path / name / str(level), shards_of(name, self.header, level), self.header.shape_of(level)
        )

    def _lattice(self, level: int, rows: slice, cols: slice) -> tuple[float, float, float]:
        """Return the pixel size of a part of a level, and stage x, y of its pixel (0, 0)."""
        pixel_um, shift_um = self.pixel_um * 2**level, (2**level - 1) / 2 * self.pixel_um
        x0_um, y0_um = self.x0_um + shift_um + cols.start * pixel_um, self.y0_um - shift_um - rows.start * pixel_um
        return pixel_um, x0_um, y0_um

    def _window(self, region: Region | None, level: int) -> tuple[slice, slice]:
        if not 0 <= level < self.levels:
            raise DatasetError(
                f"{self.path.name} has levels 0 to {self.levels - 1} and no level {level}: take one of them."
            )
        if region is not None:
            return pixel_window(self, region, level)
        rows, cols = self.header.shape_of(level)
        return slice(0, rows), slice(0, cols)


def _extent(n: int, is_covered: Callable[[slice], NDArray[np.bool_]]) -> slice | None:
    """Return the range of the lines that are covered, searched from both ends; None without any."""
    parts = [slice(start, min(start + CHUNK, n)) for start in range(0, n, CHUNK)]
    first = next((part.start + int(found.argmax()) for part in parts if (found := is_covered(part)).any()), None)
    if first is None:
        return None
    ends = (part.stop - int(found[::-1].argmax()) for part in parts[::-1] if (found := is_covered(part)).any())
    return slice(first, next(ends))
