from __future__ import annotations

import numpy as np
import pytest

from tests.support.campaigns import drawn_after
from tests.support.surfaces import PIXEL_UM, calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.tools.step_profile import step_profile
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Conditions
from wafer_viewer.model.region import Region

ACROSS = Region.line(-90, 0, 90, 0, width_um=10)


def grooved(depth_um=8.0, *, noise_um=0.1, tilt=2e-3, seed=0, correlation_px=3.0, **about):
    """A groove 40 um wide along y, its middle at x = 5 um."""
    x_um, _ = np.meshgrid(*coordinates(80, 400))
    z = -depth_um * (np.abs(x_um - 5) < 20) + tilt * x_um + 3.0
    noise = noise_of(seed, z.shape, noise_um, correlation_px) if noise_um else 0.0
    about.setdefault("calibration", calibration(u_z_scale=0.0))
    return surface_of(z + noise, **about)


def stepped(height_um=5.0, *, noise_um=0.05):
    x_um, _ = np.meshgrid(*coordinates(80, 400))
    z = height_um * (x_um > -20) - 1e-3 * x_um
    return surface_of(z + noise_of(4, z.shape, noise_um, 3.0), calibration=calibration(u_z_scale=0.0))


def test_a_groove_without_noise_is_exact():
    found = step_profile(grooved(noise_um=0.0), ACROSS)
    assert found.kind == "groove"
    assert found.height.value_um == pytest.approx(8.0, abs=1e-4)
    assert found.edges_um == pytest.approx((75.0, 115.0), abs=PIXEL_UM)
    assert found.width.value_um == pytest.approx(40, abs=2 * PIXEL_UM)


def test_zones_are_those_of_the_standard():
    found = step_profile(grooved(noise_um=0.0), ACROSS)
    (left, right), w = found.edges_um, found.width.value_um
    by_name = {name: (start, end) for name, start, end in found.zones}
    assert by_name["A"] == pytest.approx((left - w, left - w / 3))
    assert by_name["C"] == pytest.approx((left + w / 3, right - w / 3))
    assert by_name["B"] == pytest.approx((right + w / 3, right + w))


def test_a_ridge_is_distinguished_from_a_groove():
    found = step_profile(grooved(depth_um=-8.0), ACROSS)
    assert found.kind == "ridge"
    assert found.height.value_um == pytest.approx(8.0, abs=0.1)


def test_a_single_step_has_its_sign():
    up = step_profile(stepped(), ACROSS, shape="step")
    down = step_profile(stepped(), Region.line(90, 0, -90, 0, width_um=10), shape="step")
    assert up.height.value_um == pytest.approx(5.0, abs=0.1)
    assert down.height.value_um == pytest.approx(-up.height.value_um, abs=1e-3)
    assert up.edges_um == pytest.approx((70.0,), abs=PIXEL_UM)
    assert (up.width, [name for name, _, _ in up.zones]) == (None, ["A", "B"])


@pytest.mark.slow
@pytest.mark.parametrize("correlation_px", drawn_after(1, [2.0, 0.0, 4.0]))
def test_its_uncertainty_covers_the_error(correlation_px):
    found = [step_profile(grooved(seed=s, noise_um=0.3, correlation_px=correlation_px), ACROSS) for s in range(40)]
    errors = np.array([f.height.value_um - 8.0 for f in found])
    expanded = np.array([f.height.expanded_um for f in found])
    assert np.mean(np.abs(errors) <= expanded) >= 0.85
    assert expanded.mean() < 6 * errors.std(), "an uncertainty that is far too large is no help either"


def test_single_false_heights_do_not_change_it():
    made = grooved()
    z = made.z_um.copy()
    z[:, ::37] += 50.0
    assert step_profile(surface_of(z), ACROSS).height.value_um == pytest.approx(8.0, abs=0.1)


def test_the_budget_lists_what_nobody_knows():
    valid = Conditions(repeatability_um=0.01, temperature_c=23.0, u_temperature_c=0.0, drift_um=0.002)
    found = step_profile(grooved(), ACROSS, conditions=valid)
    lines = {line.name: line.u_um for line in found.height.budget}
    assert lines["repeatability"] == 0.01
    assert lines["temperature"] == pytest.approx(8.0 * 11.5e-6 * 3, rel=0.05)
    assert found.not_evaluated == ("z linearity", "Abbe offset")


def test_without_a_calibration_there_is_no_uncertainty():
    found = step_profile(grooved(calibration=None), ACROSS)
    assert (found.height.status, found.height.expanded_um, found.not_evaluated) == ("uncalibrated", None, ())


def holed():
    made = grooved()
    z = made.z_um.copy()
    z[:, 195:230] = np.nan
    return surface_of(z)


@pytest.mark.parametrize(
    ("surface", "line", "sentence"),
    [
        (grooved(), Region.line(900, 0, 990, 0), "lies outside"),
        (grooved(), Region.rectangle(-90, -5, 90, 5), "needs a line"),
        (grooved(), Region.line(-40, 0, 90, 0, 10), "The line reaches 2[45].. um beyond what stands out"),
        (grooved(depth_um=0.0), ACROSS, "No groove stands out|has to reach as far as that|across something wider"),
        (holed(), ACROSS, "Zone C of the profile has 0 measured samples"),
        (surface_of(np.full((80, 400), np.nan)), ACROSS, "No heights were measured along the line"),
        (grooved(), Region.line(-4, 0, 4, 0), "Too few heights were measured along the line"),
    ],
    ids=["outside", "no line", "short", "flat", "holes", "unmeasured", "tiny"],
)  # fmt: skip
def test_what_cannot_be_measured_is_one_sentence(surface, line, sentence):
    with pytest.raises(MeasureError, match=sentence):
        step_profile(surface, line)
