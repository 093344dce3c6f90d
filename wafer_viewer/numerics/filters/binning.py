"""Sums of square blocks of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def binned(plane: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return the sums of factor x factor pixels; an incomplete remainder at the end is omitted."""
    rows, cols = (n // factor * factor for n in plane.shape)
    wide: Any = sum(plane[:rows, k:cols:factor] for k in range(factor))
    both: Any = sum(wide[k::factor] for k in range(factor))
    return both
