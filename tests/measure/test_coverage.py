"""How often U covers the truth, on a small version of the benchmark: the figures themselves are in bench_step."""

from __future__ import annotations

import pytest

from tests.bench.bench_step import runs

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("correlation_px", [2, 8])
def test_u_covers_the_truth_about_as_often_as_it_says(correlation_px):
    of = runs(correlation_px, range(40), side_px=300)
    assert abs(of.bias_um) <= of.allowed_um
    assert of.covered >= 0.85
    assert of.expanded_um.mean() < 3 * of.errors_um.std(), "nor is it far too large"
