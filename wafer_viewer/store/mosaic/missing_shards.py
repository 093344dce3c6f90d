"""Files that a mosaic lacks: told from ground without heights, for which no file is written.

A shard without heights has no file, so that a deleted one would read as ground that was never measured. The levels of
the pyramid and the facts say which shards were written: they are looked at by name, and the index of a coarser shard
only where a finer one is not there.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.checksums import KnownGood, file_mark, mend_of
from wafer_viewer.store.mosaic import layout
from wafer_viewer.store.mosaic.layout import FILLS, GROUP, SPANS, levels_of
from wafer_viewer.store.mosaic.statistics import FACTS, blocks_with_heights
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic

HEIGHTS = ("z_um", "z_raw_um", "origin")
"""Layers that numbers are made of."""
VANISHES = ("all_in_focus",)
"""Layers that may be nothing but fill in a coarser level where they are not in a finer one."""
Place = tuple[int, int]
_whole = KnownGood()
"""Mosaics of which no file is missing, by the state of their header."""


def missing_files(mosaic: ZarrMosaic, *, heights_only: bool = False) -> Iterator[Path]:
    """Yield the files of a mosaic that were written and are not there.

    Parameters
    ----------
    mosaic : ZarrMosaic
        One that nobody is writing to.
    heights_only : bool
        Look at the layers alone that numbers are made of, by the names of their files: quick, for a surface that is
        opened. Without it all layers are looked at, and what the facts say.

    Raises
    ------
    DatasetError
        When a file that is needed for it is damaged.
    """
    for name in HEIGHTS if heights_only else FILLS:
        levels = levels_of(name, mosaic.header)
        there = {level: _shards(mosaic.path / name / str(level)) for level in levels}
        for level in levels[1:]:
            yield from _finer(mosaic, name, level, there[level - 1], there[level])
            if name not in VANISHES:
                wanted = {(row // 2, col // 2) for row, col in there[level - 1]}
                yield from (_path(mosaic, name, level, place) for place in sorted(wanted - there[level]))
    for name in ("origin",) if heights_only else ("origin", *SPANS):
        for level in levels_of(name, mosaic.header):
            lacks = _shards(mosaic.path / "z_um" / str(level)) - _shards(mosaic.path / name / str(level))
            yield from (_path(mosaic, name, level, place) for place in sorted(lacks))
    written, told = _shards(mosaic.path / "origin" / "0"), _shards(mosaic.path / FACTS)
    of_facts = {(row // 2, col // 2) for row, col in written}
    yield from (mosaic.path / FACTS / "c" / f"{row}" / f"{col}" / "0" for row, col in sorted(of_facts - told))
    if not heights_only:
        yield from _by_facts(mosaic)


def require_whole(mosaic: ZarrMosaic) -> None:
    """Raise DatasetError, with the mend, when a file that heights are read from was deleted."""
    for path in missing_files(mosaic, heights_only=True):
        raise missing(path)


def require_whole_once(mosaic: ZarrMosaic) -> None:
    """Raise as `require_whole` does; a mosaic that did not change is looked at once by this process."""
    key = file_mark(mosaic.path / GROUP)
    if key not in _whole:
        require_whole(mosaic)
        _whole.add(key)


def missing(path: Path) -> DatasetError:
    """The error of a file of a mosaic that is gone: its place, and the mend."""
    return DatasetError(f"{path} is missing, though it was written: {mend_of(path)}.")


def _finer(mosaic: ZarrMosaic, name: str, level: int, finer: set[Place], there: set[Place]) -> Iterator[Path]:
    """Shards of the level before of which a shard of this one says that they hold something."""
    for row, col in sorted(there):
        children = {(2 * row + r, 2 * col + c) for r in (0, 1) for c in (0, 1)} - finer
        if children:
            array = mosaic.array(name, level)
            half = layout.SHARD // layout.CHUNK // 2
            chunks = array.shards.places(_path(mosaic, name, level, (row, col)))
            held = {(2 * row + r // half, 2 * col + c // half) for r, c in chunks}
            yield from (_path(mosaic, name, level - 1, place) for place in sorted(children & held))


def _by_facts(mosaic: ZarrMosaic) -> Iterator[Path]:
    """Shards of heights of level 0 of which the facts say that they hold heights."""
    per_shard = layout.SHARD // (2 * layout.CHUNK)
    wanted = {(row // per_shard, col // per_shard) for row, col in blocks_with_heights(mosaic.path, mosaic.shape)}
    for name in ("z_um", "origin"):
        there = _shards(mosaic.path / name / "0")
        yield from (_path(mosaic, name, 0, place) for place in sorted(wanted - there))


def _shards(array: Path) -> set[Place]:
    """Rows and columns of the shards of an array that have a file, or of the folders that stand for them."""
    folder = array / "c"
    if not folder.is_dir():
        return set()
    return {
        (int(row.name), int(file.name))
        for row in folder.iterdir()
        if row.name.isdecimal() and row.is_dir()
        for file in row.iterdir()
        if file.name.isdecimal() and (file.is_file() or (file / "0").is_file())
    }


def _path(mosaic: ZarrMosaic, name: str, level: int, place: Place) -> Path:
    return mosaic.path / name / str(level) / "c" / f"{place[0]}" / f"{place[1]}"
