"""Dies of product wafers drawn by seed: rows, columns, pairs and arrays, with their true size."""

from __future__ import annotations

import pytest

from tests.bench.product_wafers import judged, product
from wafer_viewer.measure.dies.die_lattice import find_dies


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(11, id="a column of two, lines"),
        pytest.param(38, id="a column of four, bumps"),
        pytest.param(57, id="a column of three, logic"),
        pytest.param(18, id="a row of eight, bumps"),
        pytest.param(24, id="three by two, bumps"),
        pytest.param(27, id="narrow streets, lines"),
        pytest.param(43, id="six by seven, lines"),
        pytest.param(41, id="streets along y only"),
    ],
)
def test_dies_of_a_product_are_found_with_their_size(seed):
    drawn = product(seed)
    right, why = judged(find_dies(drawn.surface), drawn)
    assert right, why
