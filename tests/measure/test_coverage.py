"""How often U covers the truth, on small versions of the benchmarks: the figures are in bench_step, bench_coverage."""

from __future__ import annotations

import pytest

from tests.bench.bench_coverage import SAMPLES, cells
from tests.bench.bench_step import runs

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("correlation_px", [2, 8])
def test_u_covers_the_truth_about_as_often_as_it_says(correlation_px):
    of = runs(correlation_px, range(40), side_px=300)
    assert abs(of.bias_um) <= of.allowed_um
    assert of.covered >= 0.85
    assert of.expanded_um.mean() < 3 * of.errors_um.std(), "nor is it far too large"


@pytest.mark.parametrize("correlation_px", [0.0, 16.0])
@pytest.mark.parametrize("name", ["points", "groove"])
def test_u_covers_errors_that_are_alike_over_much_of_a_zone(name, correlation_px):
    for quantity, cell in cells(SAMPLES[name], range(120), correlation_px).items():
        assert 0.88 <= cell.covered < 0.995, quantity
