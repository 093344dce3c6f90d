"""Differences of two results: what both have in common counts once, and a simulation scatters as much."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.support.datasets.judged_datasets import RESULT, STEP, judged_dataset, released_job
from tests.support.surfaces import calibration, noise_of, surface_of
from wafer_viewer.cli.app import main
from wafer_viewer.measure.base.measurement_context import INTERPOLATION, NOISE, Z_SCALE
from wafer_viewer.measure.difference import difference
from wafer_viewer.measure.registry import measured
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.store.dataset.dataset import Dataset

SHAPE, HEIGHTS, SCALE, NOISE_UM = (160, 480), (0.0, 100.0, 130.0), 1e-3, 0.02
FACES = [Region.rectangle(-115 + 80 * k, -35, -45 + 80 * k, 35) for k in range(3)]
"""Faces of three heights beside each other."""


def stairs(seed=0, scale=1.0):
    x_px = np.arange(SHAPE[1])
    z_um = np.broadcast_to(np.array(HEIGHTS)[x_px * 3 // SHAPE[1]], SHAPE)
    noise = noise_of(seed, SHAPE, NOISE_UM)
    return surface_of(scale * z_um + noise, z_step_um=0.0, calibration=calibration(SCALE))


def two_steps(surface):
    ground, low, high = FACES
    return step_height(surface, high, ground), step_height(surface, low, ground)


def lines(quantity):
    return {line.name: line.u for line in quantity.budget}


def test_scales_count_by_the_difference_and_the_rest_by_its_squares():
    first, second = two_steps(stairs())
    found = difference(first, second)
    assert found.value == pytest.approx(30, abs=0.02)
    assert lines(found)[Z_SCALE] == pytest.approx(SCALE * found.value)
    assert lines(found)[NOISE] == pytest.approx(np.hypot(lines(first.main)[NOISE], lines(second.main)[NOISE]))
    assert found.u < 0.3 * np.hypot(first.u, second.u)
    assert difference(second, first).value == -found.value
    assert difference(second, first).expanded == pytest.approx(found.expanded)


def test_values_of_opposite_signs_add_what_a_scale_does_to_them():
    ground, low, _ = FACES
    surface = stairs()
    up, down = step_height(surface, low, ground), step_height(surface, ground, low)
    assert lines(difference(up, down))[Z_SCALE] == pytest.approx(2 * SCALE * 100, rel=1e-3)


def test_noise_of_a_place_that_one_adds_and_the_other_subtracts_is_added():
    ground, low, high = FACES
    surface = stairs()
    upper, lower = step_height(surface, high, low), step_height(surface, low, ground)
    added, independent = (lines(difference(upper, lower, same_surface=same))[NOISE] for same in (True, False))
    assert added == pytest.approx(lines(upper.main)[NOISE] + lines(lower.main)[NOISE])
    assert independent < added


def test_the_same_places_have_the_same_noise_on_one_surface_and_not_in_two_scans():
    one, again = (step_height(stairs(seed), FACES[1], FACES[0]) for seed in (1, 2))
    assert difference(one, one).expanded == 0
    repeated = difference(one, again, same_surface=False)
    assert lines(repeated)[NOISE] == pytest.approx(np.hypot(lines(one.main)[NOISE], lines(again.main)[NOISE]))
    assert lines(repeated)[Z_SCALE] < 1e-3 * lines(one.main)[Z_SCALE]


@pytest.mark.campaign
def test_a_simulation_of_its_sources_scatters_no_more_than_the_difference_says():
    rng = np.random.default_rng(3)
    found = [difference(*two_steps(stairs(seed, 1 + SCALE * rng.standard_normal()))) for seed in range(60)]
    scatter = np.std([each.value for each in found], ddof=1)
    budget = [sum(u**2 for name, u in lines(each).items() if name != INTERPOLATION) for each in found]
    assert 0.8 < np.sqrt(np.mean(budget)) / scatter < 1.5


def test_results_without_u_or_in_other_units_have_no_u_or_no_difference():
    surface = stairs()
    step = two_steps(surface)[0]
    volume = measured(surface, "volume", (FACES[0],), True)
    with pytest.raises(MeasureError, match="One value is in um and the other in um3"):
        difference(step, volume)
    with pytest.raises(MeasureError, match="A StepHeight has no quantity 'sq': choose one of"):
        difference(step, step, quantity="sq")
    bare = step_height(surface, FACES[1], FACES[0], calibration_valid=False)
    assert (difference(step, bare).expanded, difference(step, bare).status) == (None, "uncalibrated")


def test_the_command_line_subtracts_kept_results_also_of_two_scans(tmp_path, capsys):
    for name, height_um in (("before", 12.0), ("after", 12.5)):
        judged_dataset(tmp_path / f"{name}.wafer", height_um, released_job())
        result = Dataset.open(tmp_path / f"{name}.wafer").result(RESULT)
        step = measured(result.mosaic(), "step", STEP.places, True)
        result.save_findings(MeasurementResults(items=(replace(step, number=1), replace(step, number=2))))
    capsys.readouterr()
    words = ["measure", "difference", str(tmp_path / "after.wafer"), "--first", "1"]
    assert main([*words, "--second", "1", "--other", str(tmp_path / "before.wafer")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["value"] == pytest.approx(0.5, abs=0.02)
    assert found["expanded"] > 0
    assert main([*words, "--second", "2"]) == 0
    assert json.loads(capsys.readouterr().out)["value"] == 0
    assert main([*words, "--second", "3"]) == 2
    assert "after.wafer has no result 3 among those of default: it has 1, 2." in capsys.readouterr().err
