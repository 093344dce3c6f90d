"""Type aliases of kernel arguments: arrays by element type, and scalars."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Bools: TypeAlias = NDArray[np.bool_]
Float32s: TypeAlias = NDArray[np.float32]
Float64s: TypeAlias = NDArray[np.float64]
Int32s: TypeAlias = NDArray[np.int32]
Int64s: TypeAlias = NDArray[np.int64]
UInt8s: TypeAlias = NDArray[np.uint8]
UInt16s: TypeAlias = NDArray[np.uint16]
Wholes: TypeAlias = NDArray[Any]
"""int32 if the sums of 8-bit grey fit, int64 for 16-bit grey."""
Greys: TypeAlias = NDArray[Any]
"""uint8 or uint16."""

Whole: TypeAlias = int | np.integer[Any]
Real: TypeAlias = float | np.floating[Any]

_CACHE_LINE_BYTES = 64


def aligned(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Return zeros aligned to a cache line, because vectors that straddle two lines cost twice."""
    dtype = np.dtype(dtype)
    n_bytes = dtype.itemsize * int(np.prod(shape))
    room = np.zeros(n_bytes + _CACHE_LINE_BYTES, np.uint8)
    start = -room.ctypes.data % _CACHE_LINE_BYTES
    return room[start : start + n_bytes].view(dtype).reshape(shape)
