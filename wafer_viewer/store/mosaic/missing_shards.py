"""Detection of deleted mosaic files, as opposed to unmeasured areas, for which no file is written.

A shard without heights has no file, so a deleted one would read as an unmeasured area. The pyramid levels and the
statistics record which shards were written. They are checked by file name, and the index of a coarser shard is read
only if a finer shard is missing.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.height_map import EXTREMES, N_COVERED, N_ORIGIN, N_OVERLAP, OVERLAP
from wafer_viewer.store.io.checksums import KnownGood, file_mark, remedy
from wafer_viewer.store.mosaic import zarr_shards
from wafer_viewer.store.mosaic.statistics import FACTS, blocks_with_heights
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic
from wafer_viewer.store.mosaic.zarr_shards import FILLS, GROUP, levels_of

HEIGHTS = ("z_um", "z_raw_um", "origin")
"""Layers that measurements depend on."""
VANISHES = ("all_in_focus", "confidence")
"""Layers that may hold only fill values in a coarser level where the finer one has no file."""
IMPLIED = {
    "origin": "z_um",
    N_ORIGIN: "z_um",
    N_OVERLAP: OVERLAP,
    N_COVERED: "origin",
    **dict(zip(EXTREMES, EXTREMES[::-1], strict=True)),
}
"""Layers that have a shard wherever another one has: of measured heights there is a lowest and a highest."""
Place = tuple[int, int]
_complete = KnownGood()
"""Complete mosaics, by the state of their header."""


def missing_files(mosaic: ZarrMosaic, *, heights_only: bool = False) -> Iterator[Path]:
    """Yield the files of a mosaic that were written and no longer exist.

    Parameters
    ----------
    mosaic : ZarrMosaic
        A mosaic that no process is writing to.
    heights_only : bool
        Check only the layers that measurements depend on, by file name: fast, for opening a surface. Otherwise all
        layers and the statistics are checked.

    Raises
    ------
    DatasetError
        When a file that the check needs is damaged.
    """
    shards_of = cache(_shards)
    for name in HEIGHTS if heights_only else FILLS:
        levels = levels_of(name, mosaic.header)
        shards = {level: shards_of(mosaic.path / name / str(level)) for level in levels}
        for level in levels[1:]:
            yield from _missing_finer_shards(mosaic, name, level, shards[level - 1], shards[level])
            if name not in VANISHES:
                wanted = {(row // 2, col // 2) for row, col in shards[level - 1]}
                yield from (_path(mosaic, name, level, place) for place in sorted(wanted - shards[level]))
    for name, implying in IMPLIED.items():
        if not heights_only or name == "origin":
            for level in levels_of(name, mosaic.header):
                lacks = shards_of(mosaic.path / implying / str(level)) - shards_of(mosaic.path / name / str(level))
                yield from (_path(mosaic, name, level, place) for place in sorted(lacks))
    written, described = shards_of(mosaic.path / "origin" / "0"), shards_of(mosaic.path / FACTS)
    expected = {(row // 2, col // 2) for row, col in written}
    yield from (mosaic.path / FACTS / "c" / f"{row}" / f"{col}" / "0" for row, col in sorted(expected - described))
    if not heights_only:
        yield from _missing_by_statistics(mosaic)


def require_complete(mosaic: ZarrMosaic) -> None:
    """Raise DatasetError, with the remedy, when a file needed for heights was deleted."""
    for path in missing_files(mosaic, heights_only=True):
        raise missing(path)


def require_complete_once(mosaic: ZarrMosaic) -> None:
    """Raise as `require_complete` does; an unchanged mosaic is checked once per process."""
    key = file_mark(mosaic.path / GROUP)
    if key not in _complete:
        require_complete(mosaic)
        _complete.add(key)


def missing(path: Path) -> DatasetError:
    """Return the error for a missing mosaic file, with its path and the remedy."""
    return DatasetError(f"{path} is missing, though it was written: {remedy(path)}.")


def _missing_finer_shards(
    mosaic: ZarrMosaic, name: str, level: int, finer: set[Place], coarser: set[Place]
) -> Iterator[Path]:
    """Yield missing shards of the finer level that are not empty according to a shard of this level."""
    for row, col in sorted(coarser):
        children = {(2 * row + r, 2 * col + c) for r in (0, 1) for c in (0, 1)} - finer
        if children:
            array = mosaic.array(name, level)
            half = zarr_shards.SHARD // zarr_shards.CHUNK // 2
            chunks = array.shards.places(_path(mosaic, name, level, (row, col)))
            occupied = {(2 * row + r // half, 2 * col + c // half) for r, c in chunks}
            yield from (_path(mosaic, name, level - 1, place) for place in sorted(children & occupied))


def _missing_by_statistics(mosaic: ZarrMosaic) -> Iterator[Path]:
    """Yield missing height shards of level 0 that contain heights according to the statistics."""
    per_shard = zarr_shards.SHARD // (2 * zarr_shards.CHUNK)
    wanted = {(row // per_shard, col // per_shard) for row, col in blocks_with_heights(mosaic.path, mosaic.shape)}
    for name in ("z_um", "origin"):
        shards = _shards(mosaic.path / name / "0")
        yield from (_path(mosaic, name, 0, place) for place in sorted(wanted - shards))


def _shards(array: Path) -> set[Place]:
    """Return rows and columns of the shards of an array that exist as a file or a folder."""
    found: set[Place] = set()
    with suppress(FileNotFoundError, NotADirectoryError), os.scandir(array / "c") as rows:
        for row in rows:
            if row.name.isdecimal() and row.is_dir():
                with os.scandir(row) as files:
                    there = (f for f in files if f.name.isdecimal() and (f.is_file() or Path(f.path, "0").is_file()))
                    found |= {(int(row.name), int(file.name)) for file in there}
    return found


def _path(mosaic: ZarrMosaic, name: str, level: int, place: Place) -> Path:
    return mosaic.path / name / str(level) / "c" / f"{place[0]}" / f"{place[1]}"
