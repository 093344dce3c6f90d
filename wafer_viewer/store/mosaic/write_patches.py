"""The work of writing a mosaic, cut into patches of which no two share a shard; and what of it is to be made again."""

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
    """Some chunks of one shard of a level from 1 on, rows top ... bottom - 1 and columns left ... right - 1 of it.

    It is made of what lies below it in the level before; a patch of level 1 makes that as well.
    """

    level: int
    top: int
    bottom: int
    left: int
    right: int

    @property
    def rows(self) -> slice:
        """Its rows in the level."""
        return slice(self.top, self.bottom)

    @property
    def cols(self) -> slice:
        """Its columns in the level."""
        return slice(self.left, self.right)

    def below(self, shape: tuple[int, int]) -> list[Window]:
        """What it is made of, cut into parts of one shard each; the level before has a shape."""
        ends = min(2 * self.bottom, shape[0]), min(2 * self.right, shape[1])
        return [
            (rows, cols)
            for rows in cut(2 * self.top, ends[0], layout.SHARD)
            for cols in cut(2 * self.left, ends[1], layout.SHARD)
        ]


def patches(shape: tuple[int, int], windows: Iterable[Window] | None = None) -> list[Patch]:
    """The patches that make some windows (of pixels of level 0; all without) of a mosaic of a shape.

    They are in the order of their levels: those of one level can be made side by side.
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
    """The patches of a level that hold some windows of it: one for each shard that they touch."""
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
    """The chunks under a hull."""
    top, bottom, left, right = hull
    chunk = layout.CHUNK
    bottom, right = (min(-(-end // chunk) * chunk, size) for end, size in zip((bottom, right), shape, strict=True))
    return Patch(level, top // chunk * chunk, bottom, left // chunk * chunk, right)


def _halved(run: slice) -> slice:
    return slice(run.start // 2, -(-run.stop // 2))


def _shape_of(shape: tuple[int, int], level: int) -> tuple[int, int]:
    return -(-shape[0] // 2**level), -(-shape[1] // 2**level)
