"""Displacements between overlapping frames of known shift."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.wave_renderer import PIXEL_UM, WaveRenderer
from wafer_viewer.calibrate.image_geometry import displacement_px


@pytest.mark.parametrize("moved_um", [112.3 + 0.4j, -60.1 - 50.2j, 3.05 + 84.0j])
def test_a_displacement_is_found_to_a_twentieth_of_a_pixel(moved_um):
    seen = WaveRenderer(shape=(240, 320))
    first, second = (seen.frame(z.real, z.imag, 0.0, 125.0, n) for n, z in enumerate((0j, moved_um)))
    found = displacement_px(first, second, complex(moved_um / PIXEL_UM * 1.01))
    assert found is not None
    assert abs(found - moved_um / PIXEL_UM) < 0.05


def test_frames_with_nothing_in_common_have_none():
    rng = np.random.default_rng(0)
    first, second = (rng.integers(0, 255, (240, 320)).astype(np.uint8) for _ in range(2))
    assert displacement_px(first, second, 200 + 0j) is None


def test_frames_that_do_not_overlap_have_none():
    image = WaveRenderer(shape=(240, 320)).frame(0.0, 0.0, 0.0, 125.0, 0)
    assert displacement_px(image, image, 600 + 0j) is None
