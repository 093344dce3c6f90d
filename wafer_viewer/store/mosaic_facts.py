"""What a mosaic holds, in numbers, kept beside it as it is written, so that nobody need read it all for them.

They are kept by blocks: the pixels of level 0 under one chunk of level 1. A file holds the blocks of one shard of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.numerics.codes import count_codes
from wafer_viewer.numerics.pyramid import Layers
from wafer_viewer.store import mosaic_layout
from wafer_viewer.store.files import replacing

FOLDER = "facts"
SAMPLES = 400_000
"""About as many pixels are looked at where all of them would be too many."""
COARSEST_STEP = 64
_CODES = 32
"""Origins have smaller codes than this."""

Blocks = NDArray[Any]
"""Facts of blocks, [row, col] of records."""


@dataclass(frozen=True, slots=True, eq=False)
class Facts:
    """Pixels by origin, int64 [code]; the span of heights, NaN where there is none; heights and differences of overlaps
    at every so many pixels, without those that have none.
    """

    counts: NDArray[np.int64]
    lowest_um: float
    highest_um: float
    heights_um: NDArray[np.float32]
    overlaps_um: NDArray[np.float32]

    @property
    def has_heights(self) -> bool:
        """Whether there is any height."""
        return self.lowest_um <= self.highest_um


def sampling_step(shape: tuple[int, int]) -> int:
    """Every how manieth pixel of a mosaic, along rows and columns, is looked at."""
    return int(np.clip(np.sqrt(shape[0] * shape[1] / SAMPLES), 1, COARSEST_STEP))


def facts_of(layers: Layers, step: int) -> Facts:
    """The facts of a surface whose layers are in memory, the differences of overlaps among them or not."""
    return _joined(blocks_of(layers, step))


def blocks_of(layers: Layers, step: int) -> Blocks:
    """The facts of a window of level 0 that begins with a block, block by block."""
    size = 2 * mosaic_layout.CHUNK
    rows, cols = layers["z_um"].shape
    blocks = np.empty((-(-rows // size), -(-cols // size)), _record(size, step))
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


def keep_blocks(mosaic: Path, top: int, left: int, blocks: Blocks) -> None:
    """Keep the facts of a window that begins at pixel (top, left) of level 0 and lies under one shard of level 1."""
    size, n = 2 * mosaic_layout.CHUNK, mosaic_layout.SHARD // mosaic_layout.CHUNK
    row, col = top // size, left // size
    path = mosaic / FOLDER / f"{row // n}.{col // n}.npy"
    whole = _loaded(path) if path.exists() else _nothing((n, n), blocks.dtype)
    whole[row % n : row % n + blocks.shape[0], col % n : col % n + blocks.shape[1]] = blocks
    path.parent.mkdir(exist_ok=True)
    with replacing(path) as beside, beside.open("wb") as file:
        np.save(file, whole)


def kept_facts(mosaic: Path) -> Facts:
    """The facts of a whole mosaic. Raises DatasetError when they are damaged."""
    files = sorted((mosaic / FOLDER).glob("*.npy"))
    if not files:
        raise DatasetError(f"{mosaic / FOLDER} is missing or empty: stitch the fields again.")
    return _joined(np.concatenate([_loaded(path).ravel() for path in files]))


def _record(size: int, step: int) -> np.dtype[Any]:
    side = -(-size // step)
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


def _nothing(shape: tuple[int, int], dtype: np.dtype[Any]) -> Blocks:
    """Blocks without pixels."""
    blocks = np.zeros(shape, dtype)
    blocks["lowest"], blocks["highest"], blocks["heights"], blocks["overlaps"] = np.inf, -np.inf, np.nan, np.nan
    return blocks


def _sample(layer: NDArray[np.float32], step: int, out: NDArray[np.float32]) -> None:
    some = layer[::step, ::step]
    out[:] = np.nan
    out[: some.shape[0], : some.shape[1]] = some


def _loaded(path: Path) -> Blocks:
    try:
        return np.load(path)
    except (OSError, ValueError, EOFError) as fault:
        raise DatasetError(f"{path} is damaged: stitch the fields again.") from fault


def _joined(blocks: Blocks) -> Facts:
    blocks = blocks.ravel()
    lowest, highest = float(blocks["lowest"].min()), float(blocks["highest"].max())
    heights, overlaps = blocks["heights"].ravel(), blocks["overlaps"].ravel()
    known = lowest <= highest
    return Facts(
        counts=blocks["counts"].sum(axis=0, dtype=np.int64),
        lowest_um=lowest if known else float("nan"),
        highest_um=highest if known else float("nan"),
        heights_um=heights[np.isfinite(heights)],
        overlaps_um=overlaps[np.isfinite(overlaps)],
    )
