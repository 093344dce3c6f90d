"""Width of the response to a step on height maps with a known edge."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from wafer_viewer.calibrate.topography import edge_response
from wafer_viewer.model.errors import MeasureError

PIXEL_UM = 0.5


def edge(angle_deg=4.0, width_um=4.0, gap_um=0.0, step_um=20.0, noise_um=0.2, shape=(180, 220)):
    """A step with a response of this width from 10 % to 90 %, tilted, with a gap of heights that are not measured."""
    rng, (row, col) = np.random.default_rng(0), np.indices(shape)
    angle = np.deg2rad(angle_deg)
    away = ((col - shape[1] / 2) * np.cos(angle) - (row - shape[0] / 2) * np.sin(angle)) * PIXEL_UM
    z_um = step_um * ndtr(away * 2.563 / width_um) + 0.002 * row - 0.001 * col + rng.normal(0, noise_um, shape)
    z_um[np.abs(away) < gap_um / 2] = np.nan
    return z_um.astype(np.float32)


@pytest.mark.parametrize("angle_deg", [0.0, 4.0, -30.0, 88.0, 184.0])
@pytest.mark.parametrize("width_um", [3.0, 8.0])
def test_the_width_from_a_tenth_to_nine_tenths_is_found(angle_deg, width_um):
    found = edge_response(edge(angle_deg, width_um), PIXEL_UM)
    assert found.width_um.value == pytest.approx(width_um, abs=max(2 * found.width_um.u, 0.3))
    assert found.step_um == pytest.approx(20.0, abs=0.2)
    assert found.width_um.u < 0.5


def test_heights_that_are_not_measured_are_part_of_the_width():
    assert edge_response(edge(width_um=1.0, gap_um=9.0), PIXEL_UM).width_um.value == pytest.approx(9.0, abs=0.7)


@pytest.mark.parametrize(
    ("heights", "why"),
    [
        (edge(step_um=0.0), "are not of two levels"),
        (edge(step_um=2.0, noise_um=0.2), "times the scatter"),
        (np.full((100, 100), np.nan, np.float32), "less than half of the field"),
    ],
)
def test_no_step_is_refused_with_the_reason(heights, why):
    with pytest.raises(MeasureError, match=why):
        edge_response(heights, PIXEL_UM)
