"""Sections through a slab: which points are in it, and the running median of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.page_stand_in import height_map
from wafer_viewer.draw.charts.profile_plot import dots, frame_of, profile_plot_html
from wafer_viewer.measure.tools import profile as slabs
from wafer_viewer.measure.tools.profile import running_median, slab_profile
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.sections import Section, SectionRequest
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap

PIXEL, ROWS, COLS = 0.5, 200, 300


@pytest.fixture
def surface() -> HeightMap:
    """A slope along x with noise, a bump across the middle, one spike, and a column without heights."""
    rng = np.random.default_rng(5)
    z = 0.02 * np.arange(COLS)[None, :] + rng.normal(0, 0.4, (ROWS, COLS))
    z[:, 150:170] += 10
    z[100, 60] = 500.0
    z[:, 220] = np.nan
    return height_map(z, PIXEL)


def test_its_points_are_those_between_two_planes(surface: HeightMap):
    line = Region.line(20.0, -50.0, 120.0, -50.0, 10.0)
    found, curve, points = slab_profile(surface, line)
    inside = np.isfinite(surface.z_um) & (np.abs(surface.y_um + 50) <= 5)[:, None]
    inside &= ((surface.x_um >= 20) & (surface.x_um <= 120))[None, :]
    assert len(points) == inside.sum()
    assert sorted(points.z_um) == pytest.approx(sorted(surface.z_raw_um[inside]))
    assert points.width_um == 10.0
    assert found.filter == "median over 10 um across the line"
    assert found.length_um == 100.0
    assert len(curve.z_um) == 201


def test_the_line_is_their_running_median_and_no_spike_moves_it(surface: HeightMap):
    _, curve, points = slab_profile(surface, Region.line(0.0, -50.0, 149.5, -50.0, 10.0))
    col = np.arange(COLS)
    flat = (col > 5) & (col < 145)
    assert curve.z_um[flat] == pytest.approx(0.02 * col[flat], abs=0.35)
    assert np.nanmax(curve.z_um) < 15
    assert points.spread_um == pytest.approx(0.4, rel=0.1)
    own = [np.median(surface.z_raw_um[90:111, k - 1 : k + 2]) for k in (40, 60, 160)]
    assert curve.z_um[[40, 60, 160]] == pytest.approx(own)


def test_a_slanted_slab_has_as_many_points_as_its_area(surface: HeightMap):
    line = Region.line(10.0, -10.0, 130.0, -90.0, 8.0)
    _, _, points = slab_profile(surface, line)
    area_px = np.hypot(120, 80) * 8 / PIXEL**2
    assert len(points) == pytest.approx(area_px, rel=0.02)
    assert points.distance_um.min() >= 0
    assert points.distance_um.max() <= np.hypot(120, 80)


def test_pieces_make_no_difference(surface: HeightMap, monkeypatch: pytest.MonkeyPatch):
    line = Region.line(10.0, -10.0, 130.0, -90.0, 2.0)
    full = slab_profile(surface, line)[2]
    monkeypatch.setattr(slabs, "_LEAST_PIECE_PX", 8)
    parts = slab_profile(surface, line)[2]
    assert sorted(parts.z_um) == sorted(full.z_um)


def test_without_a_width_it_is_one_pixel_wide(surface: HeightMap):
    _, curve, points = slab_profile(surface, Region.line(0.0, -50.0, 149.5, -50.0))
    assert points.width_um == PIXEL
    assert len(points) == COLS - 1
    assert np.isfinite(curve.z_um[220])  # its neighbours are near enough
    with pytest.raises(MeasureError, match="a rectangle"):
        slab_profile(surface, Region.rectangle(0, -50, 10, -40))
    with pytest.raises(MeasureError, match="outside"):
        slab_profile(surface, Region.line(1e4, 0, 2e4, 0, 5.0))


def test_where_no_point_is_near_there_is_no_line():
    z = running_median(np.array([0.0, 0.1, 9.9]), np.array([1.0, 3.0, 7.0]), 10.0, 11)
    assert z[:2] == pytest.approx([2.0, 2.0])
    assert np.isnan(z[2:9]).all()
    assert z[9:] == pytest.approx([7.0, 7.0])


def test_the_plot_draws_points_below_their_line(surface: HeightMap):
    line = Region.line(0.0, -50.0, 149.5, -50.0, 10.0)
    section = Section(SectionRequest(0, line, slab=True), *slab_profile(surface, line)[:2], "x")
    points = slab_profile(surface, line)[2]
    section = dataclasses.replace(section, points=points)
    frame = frame_of([section])
    assert frame.z_um[1] < 100  # one spike does not flatten the plot
    x_um, z_um = dots(points, frame, 1000)
    assert len(x_um) == 1000
    for shown, (low, high) in ((x_um, frame.x_um), (z_um, frame.z_um)):
        assert ((shown >= low) & (shown <= high)).all()
    drawn = profile_plot_html([section], frame, ())
    assert drawn.index("wv-slab-points") < drawn.index("wv-curve")
    assert f'data-points="{len(points)}"' in drawn
    assert "along the slab" in drawn
