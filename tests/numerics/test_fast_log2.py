"""The logarithm of whole vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import bare_kernel, quick_log2


@bare_kernel
def _log2_of(values: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    for x in range(values.size):
        out[x] = quick_log2(values[x])


def test_it_is_the_logarithm_from_the_least_to_the_largest_number() -> None:
    values = np.geomspace(1e-37, 3e38, 100_001).astype(np.float32)
    out = np.empty_like(values)
    _log2_of(values, out)
    np.testing.assert_allclose(out, np.log2(values.astype(np.float64)), atol=1.3e-4)


def test_powers_of_two_are_exact() -> None:
    values = 2.0 ** np.arange(-20, 21).astype(np.float32)
    out = np.empty_like(values)
    _log2_of(values, out)
    np.testing.assert_array_equal(out, np.arange(-20, 21))
