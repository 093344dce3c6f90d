"""Sums of pixels by squares."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def binned(plane: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Sums of factor x factor pixels; what is left over at the end is left out."""
    rows, cols = (n // factor * factor for n in plane.shape)
    wide: Any = sum(plane[:rows, k:cols:factor] for k in range(factor))
    both: Any = sum(wide[k::factor] for k in range(factor))
    return both
