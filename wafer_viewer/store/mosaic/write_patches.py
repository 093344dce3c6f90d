"""Partition of mosaic writes into patches that share no shard, and selection of those to be rewritten."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from wafer_viewer.store.mosaic import layout
from wafer_viewer.store.mosaic.layout import levels_for
from wafer_viewer.store.mosaic.zarr_shards import cut

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
            for rows in cut(2 * self.top, ends[0], layout.SHARD)
            for cols in cut(2 * self.left, ends[1], layout.SHARD)
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
        for part_r in cut(rows.start, min(rows.stop, shape[0]), layout.SHARD):
            for part_c in cut(cols.start, min(cols.stop, shape[1]), layout.SHARD):
                shard = part_r.start // layout.SHARD, part_c.start // layout.SHARD
                here = part_r.start, part_r.stop, part_c.start, part_c.stop
                hulls[shard] = _hull(hulls.get(shard, here), here)
    return [_aligned(level, shape, hull) for _, hull in sorted(hulls.items())]


def _hull(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


def _aligned(level: int, shape: tuple[int, int], hull: tuple[int, int, int, int]) -> Patch:
    """Return the patch of all chunks in a bounding box."""
    top, bottom, left, right = hull
    chunk = layout.CHUNK
    bottom, right = (min(-(-end // chunk) * chunk, size) for end, size in zip((bottom, right), shape, strict=True))
    return Patch(level, top // chunk * chunk, bottom, left // chunk * chunk, right)


def _halved(run: slice) -> slice:
    return slice(run.start // 2, -(-run.stop // 2))


def _shape_of(shape: tuple[int, int], level: int) -> tuple[int, int]:
    return -(-shape[0] // 2**level), -(-shape[1] // 2**level)
