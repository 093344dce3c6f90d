"""Regions in stage um and the pixels they take."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import height_map
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Origin


def flat(rows=40, cols=60, pixel=0.5) -> HeightMap:
    return height_map(np.zeros((rows, cols)), pixel, 100.0, 50.0)


def test_a_rectangle_takes_the_pixels_whose_centres_it_holds():
    window = flat().window(Region.rectangle(105.0, 40.0, 110.0, 45.0))
    assert window.shape == (11, 11)
    assert window.bounds_um == pytest.approx((105.0, 40.0, 110.0, 45.0))


def test_circle_and_polygon_hold_what_they_should():
    x, y = np.meshgrid(np.linspace(-2, 2, 401), np.linspace(-2, 2, 401))
    area = (4 / 400) ** 2
    assert Region.circle(0, 0, 1.5).contains(x, y).sum() * area == pytest.approx(np.pi * 1.5**2, rel=0.01)
    assert Region.polygon((-1, -1), (1, -1), (0, 1)).contains(x, y).sum() * area == pytest.approx(2.0, rel=0.02)
    assert not Region.line(-1, 0, 1, 0).contains(x, y).any()


def test_a_region_outside_of_the_surface_is_refused_with_both_extents():
    with pytest.raises(MeasureError, match="outside"):
        flat().window(Region.rectangle(0, 0, 10, 10))


@pytest.mark.parametrize(
    "make",
    [
        lambda: Region(kind="polygon", points=Region.line(0, 0, 1, 1).points),
        lambda: Region.circle(0, 0, 0.0),
    ],
)
def test_a_region_needs_its_points(make):
    with pytest.raises(MeasureError):
        make()


def test_measurements_take_unsmoothed_heights_and_origin_codes_stay_what_they_are():
    surface = flat()
    assert surface.to_measure() is surface.z_raw_um
    assert {o.name: int(o) for o in Origin} == {
        "MEASURED": 0,
        "FILLED": 1,
        "NOT_COVERED": 10,
        "CLIPPED": 11,
        "NO_TEXTURE": 12,
        "AMBIGUOUS": 13,
        "END_OF_RANGE": 14,
        "WINDOWS_DISAGREE": 15,
        "BLEEDING_EDGE": 16,
        "OUTLIER": 17,
        "TOO_FEW_FRAMES": 18,
        "STEP_EDGE": 19,
        "NO_REASON": 20,
    }
