from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import STEP_UM, coordinates, gauge_blocks, noise_of, surface_of
from wafer_viewer.measure.gauge.find_faces import find_faces
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.errors import MeasureError


def side_um(region):
    x0, y0, x1, y1 = region.bounds_um
    assert x1 - x0 == pytest.approx(y1 - y0)
    return x1 - x0


@pytest.mark.slow
def test_the_faces_of_two_blocks_are_found_and_measured():
    blocks = gauge_blocks(1)
    upper, lower, notes = find_faces(blocks, size_px=60)
    assert upper.bounds_um[2] < 0 < lower.bounds_um[0], "the upper block lies on the left"
    assert lower.bounds_um[0] >= 0.28 / 0.96 * STEP_UM, "out of the shade of the wall, for an aperture of 0.28"
    assert side_um(upper) == side_um(lower) == pytest.approx(30)
    assert not notes
    length = step_height(blocks, upper, lower).height
    assert abs(length.value_um - STEP_UM) <= length.expanded_um


@pytest.mark.slow
def test_small_faces_get_smaller_squares_and_say_so():
    upper, lower, notes = find_faces(gauge_blocks(1))
    assert side_um(upper) == pytest.approx(side_um(lower))
    assert 50 * 0.5 <= side_um(upper) < 160
    assert notes[0].startswith("The faces have room for squares of ")


def test_a_hole_in_a_face_is_gone_round():
    blocks = gauge_blocks(1, noise_um=0.1)
    x_um, y_um = np.meshgrid(blocks.x_um, blocks.y_um)
    z = np.where(np.hypot(x_um + 60, y_um) < 20, np.nan, blocks.z_um)
    upper, _, _ = find_faces(surface_of(z), size_px=60)
    x0, y0, x1, y1 = upper.bounds_um
    assert np.hypot(max(x0, min(-60, x1)) + 60, max(y0, min(0, y1))) > 17


def test_the_same_surface_gives_the_same_squares():
    blocks = gauge_blocks(2)
    assert find_faces(blocks) == find_faces(blocks)


def made(*, levels=(0.0,), tilt=0.0):
    """Stripes side by side on so many levels, the last of them tilted."""
    x_um, _ = np.meshgrid(*coordinates(240, 640))
    stripe = np.minimum((np.arange(640) * len(levels)) // 640, len(levels) - 1) * np.ones((240, 1), int)
    z = np.asarray(levels)[stripe] + np.where(stripe == len(levels) - 1, tilt * x_um, 0.0)
    return surface_of(z + noise_of(3, z.shape, 0.5, 4))


@pytest.mark.parametrize(
    ("surface", "sentence"),
    [
        (made(), "The surface shows one face where two parallel ones are looked for: draw"),
        (made(levels=(0, 100, 300)), "The surface shows 3 faces or more where two"),
        (made(levels=(0, 100), tilt=0.05), "The two faces are 50 mrad apart in tilt, 20 mrad at most are parallel"),
        (made(levels=(0, 900)), "The lower face has no room for a square of 50 pixels away from its borders"),
        (surface_of(np.full((100, 100), np.nan)), "Too little of the surface is measured"),
    ],
    ids=["one", "three", "tilted", "narrow", "unmeasured"],
)
def test_what_is_no_pair_of_faces_is_one_sentence(surface, sentence):
    with pytest.raises(MeasureError, match=sentence):
        find_faces(surface, size_px=60)
