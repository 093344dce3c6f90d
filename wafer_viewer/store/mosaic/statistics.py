"""Statistics of a mosaic, stored with it during writing, so that they need no pass over all pixels.

They are stored per block: the pixels of level 0 under one chunk of level 1. A chunk of the byte array ``facts`` holds
the blocks of one of its shards, uncompressed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.store.io.atomic_files import atomic_write, make_folder
from wafer_viewer.store.io.checksums import Checksum, remedy
from wafer_viewer.store.mosaic import zarr_shards
from wafer_viewer.store.mosaic.zarr_shards import CHECKSUM_BYTES, append_checksum, require_checksum

if TYPE_CHECKING:
    from wafer_viewer.numerics.grids.pyramid_level import Layers

FACTS = "facts"
SAMPLES = 400_000
"""Approximate number of sampled pixels."""
FINEST_KEPT, COARSEST = 8, 64
"""Least and greatest sampling step in px; the samples must stay small compared with the mosaic."""
_CODES = 32
"""Upper bound of the origin codes."""

Blocks = NDArray[Any]
"""Statistics of blocks, [row, col] of records."""


@dataclass(frozen=True, slots=True, eq=False)
class MosaicStatistics:
    """Pixel counts by origin, height range, and samples of heights and overlap differences.

    counts: int64 [code]; lowest_um, highest_um: NaN if there is no height; heights_um, overlaps_um: finite values at
    every n-th pixel.
    """

    counts: NDArray[np.int64]
    lowest_um: float
    highest_um: float
    heights_um: NDArray[np.float32]
    overlaps_um: NDArray[np.float32]

    @property
    def has_heights(self) -> bool:
        """True if there is any height."""
        return self.lowest_um <= self.highest_um


def compute_statistics(layers: Layers) -> MosaicStatistics:
    """Return the statistics of a surface in memory; the overlap layer is optional."""
    return _joined(_blocks_of(layers, _step(layers["z_um"].shape, 1)))


def _step(shape: tuple[int, ...], finest: int = FINEST_KEPT) -> int:
    """Return the sampling step in px along rows and columns for a mosaic shape."""
    return int(np.clip(np.sqrt(shape[0] * shape[1] / SAMPLES), finest, COARSEST))


def _blocks_of(layers: Layers, step: int) -> Blocks:
    """Return the statistics of each block of a window of level 0 that begins at a block boundary."""
    from wafer_viewer.numerics.filters.regions import count_codes

    size = 2 * zarr_shards.CHUNK
    rows, cols = layers["z_um"].shape
    blocks = np.empty((-(-rows // size), -(-cols // size)), _record(step))
    for row, col in np.ndindex(blocks.shape):
        here = slice(row * size, (row + 1) * size), slice(col * size, (col + 1) * size)
        z, overlap = layers["z_um"][here], layers.get("overlap_um")
        block = blocks[row, col]
        block["counts"] = count_codes(layers["origin"][here], _CODES)
        block["lowest"] = np.fmin.reduce(z, axis=None, initial=np.inf)
        block["highest"] = np.fmax.reduce(z, axis=None, initial=-np.inf)
        _sample(z, step, block["heights"])
        _sample(z[:0] if overlap is None else overlap[here], step, block["overlaps"])
    return blocks


def facts_array(shape: tuple[int, int]) -> dict[str, Any]:
    """Return the Zarr array parameters of the statistics: one chunk of bytes per shard of level 1."""
    rows, cols = (math.ceil(size / 2 / zarr_shards.SHARD) for size in shape)
    n_bytes = _per_shard() ** 2 * _record(_step(shape)).itemsize
    from zarr.codecs import Crc32cCodec

    return {
        "shape": (rows, cols, n_bytes),
        "chunks": (1, 1, n_bytes),
        "dtype": "uint8",
        "compressors": [Crc32cCodec()],
        "fill_value": 0,
    }


def save_statistics(mosaic: Path, shape: tuple[int, int], top: int, left: int, layers: Layers) -> None:
    """Save the statistics of a window of level 0.

    It begins at pixel (top, left), a block boundary, and is within one shard of level 1.
    """
    size, n = 2 * zarr_shards.CHUNK, _per_shard()
    row, col = top // size, left // size
    path = mosaic / FACTS / "c" / str(row // n) / str(col // n) / "0"
    blocks = _blocks_of(layers, _step(shape))
    stored = _loaded(path, blocks.dtype).copy() if path.exists() else _empty_blocks((n, n), blocks.dtype)
    stored[row % n : row % n + blocks.shape[0], col % n : col % n + blocks.shape[1]] = blocks
    make_folder(path.parent)
    with atomic_write(path) as temporary:
        temporary.write_bytes(append_checksum(stored.tobytes()))


def load_statistics(mosaic: Path, shape: tuple[int, int]) -> MosaicStatistics:
    """Return the statistics of a mosaic. Raises DatasetError when they are missing or damaged."""
    files = sorted((mosaic / FACTS).glob("c/*/*/0"))
    if not files:
        raise DatasetError(f"{mosaic / FACTS} is missing or empty: {remedy(mosaic)}.")
    record = _record(_step(shape))
    return _joined(np.concatenate([_loaded(path, record).ravel() for path in files]))


def blocks_with_heights(mosaic: Path, shape: tuple[int, int]) -> set[tuple[int, int]]:
    """Return rows and columns of the blocks, 2 x 2 chunks of level 0, that contain a height.

    Raises DatasetError when a statistics file is damaged.
    """
    record, n = _record(_step(shape)), _per_shard()
    found: set[tuple[int, int]] = set()
    for path in (mosaic / FACTS).glob("c/*/*/0"):
        top, left = int(path.parts[-3]) * n, int(path.parts[-2]) * n
        blocks = _loaded(path, record)
        found |= {(top + row, left + col) for row, col in np.argwhere(blocks["lowest"] <= blocks["highest"]).tolist()}
    return found


def facts_state(path: Path) -> Checksum:
    """Return the checksum state of one statistics file."""
    try:
        require_checksum(path.read_bytes())
    except ValueError:
        return Checksum.DAMAGED
    return Checksum.GOOD


def _per_shard() -> int:
    """Return the number of blocks along a side of a shard."""
    return zarr_shards.SHARD // zarr_shards.CHUNK


def _record(step: int) -> np.dtype[Any]:
    """Return the record dtype of a block."""
    side = -(-2 * zarr_shards.CHUNK // step)
    sample = ("<f4", (side, side))
    return np.dtype(
        [
            ("counts", "<u4", (_CODES,)),
            ("lowest", "<f4"),
            ("highest", "<f4"),
            ("heights", *sample),
            ("overlaps", *sample),
        ]
    )


def _empty_blocks(shape: tuple[int, int], dtype: np.dtype[Any]) -> Blocks:
    """Return blocks without pixels."""
    blocks = np.zeros(shape, dtype)
    blocks["lowest"], blocks["highest"], blocks["heights"], blocks["overlaps"] = np.inf, -np.inf, np.nan, np.nan
    return blocks


def _sample(layer: NDArray[np.float32], step: int, out: NDArray[np.float32]) -> None:
    some = layer[::step, ::step]
    out[:] = np.nan
    out[: some.shape[0], : some.shape[1]] = some


def _loaded(path: Path, record: np.dtype[Any]) -> Blocks:
    n = _per_shard()
    damaged = DatasetError(f"{path} is damaged: {remedy(path)}.")
    with parser_errors_as(lambda _: damaged):
        if path.stat().st_size != n * n * record.itemsize + CHECKSUM_BYTES:
            raise damaged
        content = path.read_bytes()
        require_checksum(content)
        return np.frombuffer(content, record, n * n).reshape(n, n)


def _joined(blocks: Blocks) -> MosaicStatistics:
    blocks = blocks.ravel()
    lowest, highest = float(blocks["lowest"].min()), float(blocks["highest"].max())
    heights, overlaps = blocks["heights"].ravel(), blocks["overlaps"].ravel()
    has_heights = lowest <= highest
    return MosaicStatistics(
        counts=blocks["counts"].sum(axis=0, dtype=np.int64),
        lowest_um=lowest if has_heights else float("nan"),
        highest_um=highest if has_heights else float("nan"),
        heights_um=heights[np.isfinite(heights)],
        overlaps_um=overlaps[np.isfinite(overlaps)],
    )
