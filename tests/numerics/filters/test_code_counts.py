from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.filters.regions import count_codes


def test_every_code_is_counted_whatever_part_of_a_map_it_is_in() -> None:
    codes = np.random.default_rng(1).integers(0, 20, (123, 77), np.uint8)
    for part in (codes, codes[5:50, 3:70], codes[:0]):
        np.testing.assert_array_equal(count_codes(part, 32), np.bincount(part.ravel(), minlength=32))
