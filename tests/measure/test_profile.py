"""Profiles along a line."""

from __future__ import annotations

import numpy as np
import pytest

from tests.measure.surfaces import PIXEL_UM, height_map, step_surface
from wafer_viewer.measure.profile import profile
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region


def test_a_profile_over_a_step_reads_its_height():
    found, curve = profile(step_surface(10.0), Region.line(-50, 0, 50, 0))
    assert found.pt.value_um == pytest.approx(10.0)
    assert found.rise.value_um == pytest.approx(-10.0)
    assert found.length_um == pytest.approx(100.0)
    assert len(curve.z_um) == 201
    assert np.all(np.diff(curve.distance_um) > 0)


def test_a_slanted_line_on_a_plane_is_straight():
    x = (np.arange(400) - 199.5) * PIXEL_UM
    y = -(np.arange(200) - 99.5) * PIXEL_UM
    _, curve = profile(height_map(0.1 * x[None] + 0.2 * y[:, None]), Region.line(-40, -30, 35, 28.3, width_um=2.0))
    assert curve.z_um == pytest.approx(0.1 * curve.x_um + 0.2 * curve.y_um, abs=1e-4)


def test_width_averages_noise_away():
    surface = step_surface(0.0, noise_um=1.0, seed=2)
    narrow = profile(surface, Region.line(-80, 0, 80, 0))[1].z_um.std()
    wide = profile(surface, Region.line(-80, 0, 80, 0, width_um=8.0))[1].z_um.std()
    assert wide < 0.4 * narrow


def test_what_is_unmeasured_or_outside_is_a_gap():
    surface = step_surface(5.0)
    z = surface.z_um.copy()
    z[:, 150:160] = np.nan
    found, curve = profile(height_map(z), Region.line(-150, 0, 50, 0))
    assert np.isnan(curve.z_um[curve.x_um < -101]).all()
    assert 0.6 < found.measured_fraction < 0.75


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (Region.line(0, 0, 0.1, 0), "at least one pixel"),
        (Region.line(900, 0, 990, 0), "outside"),
        (Region.rectangle(0, 0, 5, 5), "needs a line"),
    ],
)
def test_lines_that_cannot_be_cut_say_why(line, words):
    with pytest.raises(MeasureError, match=words):
        profile(step_surface(5.0), line)


def test_nothing_measured_along_the_line():
    with pytest.raises(MeasureError, match="Nothing is measured"):
        profile(height_map(np.full((50, 50), np.nan)), Region.line(-5, 0, 5, 0))
