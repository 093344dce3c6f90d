"""How often U covers the truth, on small versions of the benchmarks: the figures are in bench_step, bench_coverage."""

from __future__ import annotations

import pytest

from tests.bench.bench_coverage import SAMPLES, Reconstructed, answers, cells, gathered
from tests.bench.bench_step import runs
from tests.support.campaigns import drawn_after

pytestmark = pytest.mark.slow
SEEDS = range(12)


@pytest.mark.parametrize("correlation_px", drawn_after(1, [2, 8]))
def test_u_covers_the_truth_about_as_often_as_it_says(correlation_px):
    of = runs(correlation_px, range(40), side_px=300)
    assert abs(of.bias_um) <= of.allowed_um
    assert of.covered >= 0.85
    assert of.expanded_um.mean() < 3 * of.errors_um.std(), "nor is it far too large"


@pytest.mark.parametrize("correlation_px", drawn_after(1, [0.0, 16.0]))
@pytest.mark.parametrize("name", ["points", "groove"])
def test_u_covers_errors_that_are_alike_over_much_of_a_zone(name, correlation_px):
    for quantity, cell in cells(SAMPLES[name], range(60), correlation_px).items():
        assert cell.covered >= 0.88, quantity


@pytest.mark.campaign
@pytest.mark.parametrize(("name", "runs", "least"), [("step", 40, 0.88), ("bumps", 10, 0.8), ("flatness", 10, 0.8)])
def test_u_covers_errors_that_are_alike_over_all_of_a_small_face(name, runs, least):
    """Noise of the face or the bump alone covers 83 % of the steps and 42 % of the coplanarities."""
    for quantity, cell in cells(SAMPLES[name], range(runs), 32.0).items():
        assert least <= cell.covered, quantity


@pytest.mark.campaign
def test_u_covers_the_texture_that_noise_makes_rougher():
    for quantity, cell in cells(SAMPLES["texture"], range(10), 9.0).items():
        assert cell.covered >= 0.8, quantity


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["points", "step"])
def test_u_covers_what_is_reconstructed_from_a_focus_stack(name):
    found = [
        answers(SAMPLES[name], instrument)
        for instrument in map(Reconstructed, SEEDS)
        if not instrument.optics.jitter_dof
    ]
    for quantity, cell in gathered(one for one in found if one is not None).items():
        assert cell.covered >= 0.8, quantity
