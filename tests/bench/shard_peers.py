"""Our shards beside Zarr's own codec pipeline and that of zarrs, on one layer of a mosaic.

    python tests/bench/shard_peers.py [--quick]        (needs: pip install zarrs)

Each writes and reads the same float32 layer with the same chunks, shards and codecs: seconds by the clock, minimum of
five runs. zarrs uses all cores, ours one; a job of ours has a process per core. Reading is of the whole and of windows
as a page asks for.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zarr
from zarr.codecs import BytesCodec, ShardingCodec

from tests.bench.harness import read_options, show, took
from wafer_viewer.store.mosaic.zarr_shards import CHUNK, SHARD, ShardedArray, Shards, codecs

RUNS, WINDOWS = 5, 40
CHUNK_PX, SHARD_PX, WINDOW_PX = CHUNK, SHARD, 700
PIPELINES = {"Zarr": "zarr.core.codec_pipeline.BatchedCodecPipeline", "zarrs": "zarrs.ZarrsCodecPipeline"}


def main() -> None:
    side = 2048 if read_options(__doc__).quick else 8192
    layer = heights(side)
    with tempfile.TemporaryDirectory() as folder:
        rows = {"ours": measured(*ours(Path(folder) / "ours", layer), side)}
        for name, pipeline in PIPELINES.items():
            with zarr.config.set({"codec_pipeline.path": pipeline}):
                rows[name] = measured(*theirs(Path(folder) / name, layer), side)
    table = [(name, *seconds) for name, seconds in rows.items()]
    show(f"{side} x {side} pixels of float32", " | write s | read s | windows s", table)


def heights(side: int) -> np.ndarray:
    """A rough surface of three levels, with a tenth unmeasured."""
    rng = np.random.default_rng(2)
    z = rng.normal(0, 0.3, (side, side)).cumsum(1).astype(np.float32) + 30 * rng.integers(0, 3, (side, 1))
    z[rng.random((side, side)) < 0.1] = np.nan
    return z.astype(np.float32)


def measured(write: Callable[[], None], read: Callable[[slice, slice], np.ndarray], side: int) -> list[float]:
    """Seconds to write the layer, to read all of it, and to read windows."""
    whole = slice(0, side), slice(0, side)
    at = np.random.default_rng(3).integers(0, side - WINDOW_PX, (WINDOWS, 2))
    windows = [(slice(r, r + WINDOW_PX), slice(c, c + WINDOW_PX)) for r, c in at.tolist()]
    acts = (write, lambda: read(*whole), lambda: [read(*window) for window in windows])
    return [took(act, RUNS).clock_s for act in acts]


def ours(folder: Path, layer: np.ndarray) -> tuple[Callable[[], None], Callable[[slice, slice], np.ndarray]]:
    shards = Shards(np.dtype(np.float32), np.nan, CHUNK_PX, SHARD_PX)
    tops = range(0, len(layer), SHARD_PX)

    def write() -> None:
        empty_array(folder, layer)
        array = ShardedArray.open(folder, shards, layer.shape)
        for r in tops:
            for c in tops:
                array.write(layer[r : r + SHARD_PX, c : c + SHARD_PX], r, c)

    return write, lambda rows, cols: ShardedArray.open(folder, shards, layer.shape).read(rows, cols)


def theirs(folder: Path, layer: np.ndarray) -> tuple[Callable[[], None], Callable[[slice, slice], np.ndarray]]:
    def write() -> None:
        empty_array(folder, layer)[:] = layer

    return write, lambda rows, cols: zarr.open_array(folder, mode="r")[rows, cols]


def empty_array(folder: Path, layer: np.ndarray) -> zarr.Array:
    shutil.rmtree(folder, ignore_errors=True)
    inner = [BytesCodec(), *codecs()]
    return zarr.create_array(
        folder,
        shape=layer.shape,
        dtype="float32",
        chunks=(SHARD_PX, SHARD_PX),
        serializer=ShardingCodec(chunk_shape=(CHUNK_PX, CHUNK_PX), codecs=inner),
        compressors=None,
        filters=None,
        fill_value=np.nan,
    )


if __name__ == "__main__":
    main()
