"""Sharded arrays: files of individually encoded chunks with an index of their offsets (``sharding_indexed``).

Zarr's own library takes 1.1 to 2.4 times as long, the zarrs package on all cores as long as this module on one
(tests/bench/shard_peers.py). Both open the file separately for the index and the chunks, between which another process
may have replaced it. Here a shard is replaced by one rename and read through one open file; unchanged chunks are copied
without decoding.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import IO, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, WaferViewerError, parser_errors_as
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Count, Positive, Spec, encode
from wafer_viewer.model.surface.height_map import COUNTS, EXTREMES, Mosaic, Origin, Provenance
from wafer_viewer.store.io.atomic_files import atomic_write, make_folder, os_errors_as_dataset_errors, to_disk
from wafer_viewer.store.io.checksums import crc32c, damaged, remedy

# ---------------------------------------------------------------------------------------------------------- zarr shards


ABSENT = 2**64 - 1
"""Index entry of a chunk that holds only the fill value."""
CHECKSUM_BYTES = 4
_OF_CHECKED = 0x48674BC7
"""CRC-32C of any bytes that are followed by their own."""
Chunks = dict[tuple[int, int], bytes]
"""Encoded chunks by row and column in their shard."""


@dataclass(frozen=True, slots=True)
class Shards:
    """Shard format of one array: dtype, fill value, and chunk and shard sizes in pixels."""

    dtype: np.dtype[Any]
    fill: float
    chunk_px: int
    shard_px: int

    def read(self, path: Path, rows: slice, cols: slice, out: NDArray[Any]) -> None:
        """Read a part of the shard at `path` into `out`; the fill value if there is no file.

        Raises DatasetError when the file is damaged.
        """
        try:
            with path.open("rb") as file, parser_errors_as(partial(_unreadable, path)):
                index = self._index(file)
                for place, inside, outside in _overlapped_chunks(rows, cols, self.chunk_px):
                    stored = index[place][0] != ABSENT
                    out[outside] = self._decoded(_cut(file, *index[place]))[inside] if stored else self.fill
        except FileNotFoundError:
            out[:] = self.fill

    def places(self, path: Path) -> set[tuple[int, int]]:
        """Return rows and columns of the non-empty chunks in the shard at `path`; none if there is no file.

        Raises DatasetError when the index of the file is damaged.
        """
        try:
            with path.open("rb") as file, parser_errors_as(partial(_unreadable, path)):
                occupied = np.argwhere(self._index(file)[..., 0] != ABSENT).tolist()
        except FileNotFoundError:
            return set()
        return {(row, col) for row, col in occupied}

    def require_good(self, path: Path) -> None:
        """Verify the checksums of the index and of all chunks. Raises DatasetError when one differs."""
        for chunk in self._stored_chunks(path).values():
            try:
                require_checksum(chunk)
            except ValueError as fault:
                raise damaged(path) from fault

    def write(self, path: Path, layer: NDArray[Any], top: int, left: int, *, covers_shard: bool) -> None:
        """Write a layer into the shard at `path`, from the chunk boundary (top, left) to a chunk boundary.

        Other chunks are preserved; whole: there are none, and the contents of `path` are ignored.

        Raises DatasetError when the file is damaged.
        """
        size = self.chunk_px
        places = [(r, c) for r in range(0, layer.shape[0], size) for c in range(0, layer.shape[1], size)]
        chunks = {} if covers_shard else self._stored_chunks(path)
        for r, c in places:
            place = (top + r) // size, (left + c) // size
            chunks.pop(place, None)
            if (encoded := self._encoded(layer[r : r + size, c : c + size])) is not None:
                chunks[place] = encoded
        if chunks:
            self._save(path, chunks)
        elif path.exists():
            with os_errors_as_dataset_errors(path):
                path.unlink()
                to_disk(path.parent)

    def _save(self, path: Path, chunks: Chunks) -> None:
        n = self.shard_px // self.chunk_px
        index = np.full((n, n, 2), ABSENT, "<u8")
        offset = 0
        for place, chunk in chunks.items():
            index[place] = offset, len(chunk)
            offset += len(chunk)
        make_folder(path.parent)
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            file.writelines(chunks.values())
            file.write(append_checksum(index.tobytes()))

    def _stored_chunks(self, path: Path) -> Chunks:
        """Return all encoded chunks of a file."""
        try:
            with path.open("rb") as file, parser_errors_as(partial(_unreadable, path)):
                index = self._index(file)
                occupied = np.argwhere(index[..., 0] != ABSENT).tolist()
                return {(r, c): _cut(file, *index[r, c]) for r, c in occupied}
        except FileNotFoundError:
            return {}

    def _index(self, file: IO[bytes]) -> NDArray[np.uint64]:
        """Return offset and number of bytes of each chunk."""
        n = self.shard_px // self.chunk_px
        file.seek(-(16 * n * n + CHECKSUM_BYTES), os.SEEK_END)
        return np.frombuffer(strip_checksum(file.read()), "<u8").reshape(n, n, 2)

    def _encoded(self, chunk: NDArray[Any]) -> bytes | None:
        """Return an encoded chunk; None if it holds only the fill value."""
        if _holds_only(chunk, self.fill):
            return None
        size = self.chunk_px
        if chunk.shape != (size, size):
            chunk = np.pad(chunk, ((0, size - chunk.shape[0]), (0, size - chunk.shape[1])), constant_values=self.fill)
        return append_checksum(_compressor().encode(np.ascontiguousarray(chunk)))

    def _decoded(self, chunk: bytes) -> NDArray[Any]:
        packed, n_bytes = strip_checksum(chunk), self.chunk_px**2 * self.dtype.itemsize
        if int.from_bytes(packed[4:8], "little") != n_bytes:  # Blosc takes this memory before it unpacks
            raise ValueError("a chunk has another size")
        flat = np.frombuffer(_compressor().decode(packed), self.dtype)
        return flat.reshape(self.chunk_px, self.chunk_px)


@dataclass(frozen=True, slots=True)
class ShardedArray:
    """Array [row, col] of a Zarr hierarchy, read and written in parts."""

    folder: Path
    shards: Shards
    shape: tuple[int, int]

    @classmethod
    def open(cls, folder: Path, shards: Shards, shape: tuple[int, int]) -> ShardedArray:
        """Open the array in a folder. Raises DatasetError when there is none."""
        if not (folder / "zarr.json").exists():
            raise DatasetError(f"{folder} is missing or damaged: {remedy(folder)}.")
        return cls(folder, shards, shape)

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        """Read a part of the array. Raises DatasetError when a shard is damaged."""
        out = np.empty((rows.stop - rows.start, cols.stop - cols.start), self.shards.dtype)
        for part_r in cut(rows.start, rows.stop, self.shards.shard_px):
            for part_c in cut(cols.start, cols.stop, self.shards.shard_px):
                path, inside_r, inside_c = self._inside(part_r, part_c)
                target_rows = np.s_[part_r.start - rows.start : part_r.stop - rows.start]
                across = np.s_[part_c.start - cols.start : part_c.stop - cols.start]
                self.shards.read(path, inside_r, inside_c, out[target_rows, across])
        return out

    def write(self, layer: NDArray[Any], top: int, left: int) -> None:
        """Write a layer into one shard, from pixel (top, left): complete chunks, or up to the array's end.

        Raises DatasetError when the shard has other chunks and is damaged, or when the dtype does not fit.
        """
        if not np.can_cast(layer.dtype, self.shards.dtype):
            raise DatasetError(
                f"{self.folder} holds {self.shards.dtype} and not {layer.dtype}: stitch fields of one kind of camera."
            )
        rows, cols = slice(top, top + layer.shape[0]), slice(left, left + layer.shape[1])
        path, inside_r, inside_c = self._inside(rows, cols)
        covers_shard = self._fills(rows, self.shape[0]) and self._fills(cols, self.shape[1])
        layer = layer.astype(self.shards.dtype, copy=False)
        self.shards.write(path, layer, inside_r.start, inside_c.start, covers_shard=covers_shard)

    def _inside(self, rows: slice, cols: slice) -> tuple[Path, slice, slice]:
        """Return the file of a part of one shard, and the part in pixels of the shard."""
        size = self.shards.shard_px
        row, col = rows.start // size, cols.start // size
        inside_r, inside_c = (slice(run.start - n * size, run.stop - n * size) for run, n in ((rows, row), (cols, col)))
        return self.folder / "c" / str(row) / str(col), inside_r, inside_c

    def _fills(self, run: slice, size: int) -> bool:
        """Return whether a run of pixels covers its shard along an axis of length `size`."""
        start = run.start // self.shards.shard_px * self.shards.shard_px
        return run.start == start and run.stop == min(start + self.shards.shard_px, size)


def cut(start: int, stop: int, size: int) -> Iterator[slice]:
    """Split a run of pixels at the shard boundaries."""
    while start < stop:
        end = min(stop, (start // size + 1) * size)
        yield slice(start, end)
        start = end


@cache
def _compressor() -> Any:
    """Return LZ4 with bit shuffle: noisy heights shrink to two thirds of their size in 2 ns per pixel."""
    import numcodecs.blosc

    numcodecs.blosc.use_threads = False
    return numcodecs.blosc.Blosc(cname="lz4", clevel=5, shuffle=numcodecs.blosc.BITSHUFFLE)


def codecs() -> list[Any]:
    """Return the same codecs for the Zarr library."""
    from zarr.codecs import BloscCodec, Crc32cCodec

    return [BloscCodec(cname="lz4", clevel=5, shuffle="bitshuffle"), Crc32cCodec()]


def append_checksum(content: bytes) -> bytes:
    """Return bytes with their checksum appended."""
    return content + crc32c(content).to_bytes(CHECKSUM_BYTES, "little")


def strip_checksum(content: bytes) -> bytes:
    """Return bytes without their checksum. Raises ValueError when it is wrong."""
    require_checksum(content)
    return content[:-CHECKSUM_BYTES]


def require_checksum(content: bytes) -> None:
    """Raise ValueError when the checksum at the end of bytes is wrong; they are not copied."""
    if len(content) < CHECKSUM_BYTES or crc32c(content) != _OF_CHECKED:
        raise ValueError("the checksum is wrong")


def _unreadable(path: Path, _: Exception) -> DatasetError:
    return DatasetError(f"{path} is damaged: {remedy(path)}.")


def _cut(file: IO[bytes], offset: np.uint64, n_bytes: np.uint64) -> bytes:
    file.seek(int(offset))
    return file.read(int(n_bytes))


def _holds_only(chunk: NDArray[Any], fill: float) -> bool:
    if np.isnan(fill):
        return bool(np.isnan(chunk[0, 0]) and np.isnan(chunk[-1, -1]) and np.isnan(chunk).all())
    return bool(chunk[0, 0] == fill and chunk[-1, -1] == fill and (chunk == fill).all())


def _overlapped_chunks(
    rows: slice, cols: slice, size: int
) -> Iterator[tuple[tuple[int, int], tuple[slice, slice], tuple[slice, slice]]]:
    """Yield the chunks that a part overlaps: index, slices in the chunk, slices in the part."""
    for r in range(rows.start // size, -(-rows.stop // size)):
        for c in range(cols.start // size, -(-cols.stop // size)):
            (inside_r, outside_r), (inside_c, outside_c) = _shared(rows, r * size, size), _shared(cols, c * size, size)
            yield (r, c), (inside_r, inside_c), (outside_r, outside_c)


def _shared(part: slice, start: int, size: int) -> tuple[slice, slice]:
    """Return the overlap of a part with a run of pixels from `start`: as a slice of the run, and of the part."""
    first, last = max(part.start, start), min(part.stop, start + size)
    return slice(first - start, last - start), slice(first - part.start, last - part.start)


# --------------------------------------------------------------------------------------------------------------- layout


CHUNK, SHARD = 256, 2048
COARSEST_PX = 512
"""Side in px of the square that the coarsest level fits into, one image of the entire surface."""
GROUP, OWN = "zarr.json", "wafer_viewer"
"""File of a group, and the name of its attribute that holds the header."""
FILLS: dict[str, float] = {
    "z_um": math.nan,
    "z_raw_um": math.nan,
    "z_min_um": math.nan,
    "z_max_um": math.nan,
    "confidence": 0.0,
    "all_in_focus": 0,
    "origin": Origin.NOT_COVERED,
    "overlap_um": math.nan,
    "u_um": math.nan,
    **dict.fromkeys(COUNTS, 0),
}
NGFF_VERSION = "0.5"
"""Version of OME-NGFF for Zarr 3."""
NGFF_SCENE_VERSION = "0.6"
"""Version of OME-NGFF with scenes; fewer programs read it so far."""
METHODS = {"z_min_um": "minimum", "z_max_um": "maximum", "origin": "minimum"}
"""Downscaling method of layers that are not means: the smallest code of an origin is the best."""
FROM_LEVEL_1 = (*EXTREMES, *COUNTS)
SURFACE = tuple(name for name in FILLS if name not in FROM_LEVEL_1)


class MosaicHeader(Spec, frozen=True, kw_only=True):
    """Lattice, shape, grey depth and provenance of a mosaic."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    pixel_um: Positive
    x0_um: float
    y0_um: float
    rows: Count
    cols: Count
    grey_bits: Literal[8, 16]
    provenance: Provenance

    @property
    def lattice(self) -> tuple[float, float, float, int, int]:
        """Pixel size and origin in um, rows and columns."""
        return self.pixel_um, self.x0_um, self.y0_um, self.rows, self.cols

    @property
    def levels(self) -> int:
        """Number of pyramid levels, at least 2."""
        return levels_for((self.rows, self.cols))

    def shape_of(self, level: int) -> tuple[int, int]:
        """Return (rows, cols) of a level."""
        return -(-self.rows // 2**level), -(-self.cols // 2**level)


def levels_for(shape: tuple[int, int]) -> int:
    """Return the number of pyramid levels for a shape, at least 2."""
    return 1 + max(1, math.ceil(math.log2(max(shape) / COARSEST_PX)))


def header_of(source: Mosaic) -> MosaicHeader:
    """Return the header of a mosaic made of a surface."""
    rows, cols = source.shape
    corner = source.window(Region.rectangle(source.x0_um, source.y0_um, source.x0_um, source.y0_um))
    return MosaicHeader(
        pixel_um=source.pixel_um,
        x0_um=source.x0_um,
        y0_um=source.y0_um,
        rows=rows,
        cols=cols,
        grey_bits=8 if corner.all_in_focus.dtype == np.uint8 else 16,
        provenance=source.provenance,
    )


def as_json(header: MosaicHeader) -> dict[str, Any]:
    """Return the header as an attribute of the group."""
    return json.loads(encode(header, "json"))


def shards_of(name: str, header: MosaicHeader, level: int) -> Shards:
    """Return the shard parameters of a layer at a level."""
    if name in COUNTS:
        return Shards(np.min_scalar_type(4**level), FILLS[name], CHUNK, SHARD)
    dtype = {"origin": "uint8", "all_in_focus": f"uint{header.grey_bits}"}.get(name, "float32")
    return Shards(np.dtype(dtype), FILLS[name], CHUNK, SHARD)


def levels_of(name: str, header: MosaicHeader) -> range:
    """Return the levels of a layer."""
    return range(1 if name in FROM_LEVEL_1 else 0, header.levels)


def ome_of_layer(header: MosaicHeader, name: str) -> dict[str, Any]:
    """Return the OME-NGFF metadata of the group of a layer."""
    return {"version": NGFF_VERSION, "multiscales": [_multiscale(header, name, "")]}


def ome_of_root(header: MosaicHeader) -> dict[str, Any]:
    """Return the OME-NGFF metadata of the mosaic: a multiscale for each layer, the heights first.

    Readers that show one multiscale take the first.
    """
    return {"version": NGFF_VERSION, "multiscales": [_multiscale(header, name, f"{name}/") for name in FILLS]}


def _multiscale(header: MosaicHeader, name: str, folder: str) -> dict[str, Any]:
    """Return the multiscale of a layer: scale and translation of each level in um, for the centres of pixels.

    x is that of the stage, y is minus that of the stage, as rows go down: so no reader needs a negative scale, which
    many refuse, pictures stand upright, and surfaces lie beside each other as on the stage. The centre of a pixel of a
    level is that of the pixels of level 0 below it, (2^level - 1) / 2 of their size from the first.
    """

    def dataset(level: int) -> dict[str, Any]:
        scale, shift = header.pixel_um * 2**level, header.pixel_um * (2**level - 1) / 2
        first = [-header.y0_um + shift, header.x0_um + shift]
        place = [{"type": "scale", "scale": [scale, scale]}, {"type": "translation", "translation": first}]
        return {"path": f"{folder}{level}", "coordinateTransformations": place}

    return {
        "name": name,
        "axes": [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "yx"],
        "datasets": [dataset(level) for level in levels_of(name, header)],
        "type": "sum" if name in COUNTS else METHODS.get(name, "mean"),
        "metadata": {"description": "x is that of the stage, y is minus that of the stage."},
    }
