"""Operators of a texture as a chain: spikes left out, their names and Sq in order, masks with holes."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import height_map
from wafer_viewer import Region, texture
from wafer_viewer.measure.texture.operators import spikes_of
from wafer_viewer.model.errors import MeasureError


def noise(seed=3, shape=(120, 160)):
    return np.random.default_rng(seed).normal(0, 0.1, shape)


def test_spikes_of_one_and_two_pixels_are_found_and_noise_is_none():
    z_um = noise()
    assert not spikes_of(z_um).any()
    placed = [(10, 10), (50, 80), (50, 81), (119, 100)]
    for row, col in placed:
        z_um[row, col] += 3.0
    z_um[60:80, 20:40] = np.nan
    assert sorted(zip(*np.nonzero(spikes_of(z_um)), strict=True)) == placed


def test_a_slope_and_a_wall_have_no_spikes():
    rows, cols = np.mgrid[:80, :90]
    assert not spikes_of(noise(shape=(80, 90)) + 0.5 * cols + np.where(rows < 40, 0.0, 0.3)).any()


def test_the_chain_names_the_operators_in_order_with_sq_after_each():
    z_um = noise()
    z_um[50, 80] += 5.0
    region = Region.rectangle(0.5, 0.5, 79.0, 59.0)
    surface = height_map(z_um.astype(np.float32), 0.5, 0.0, 59.5)
    found = texture(surface, region, spikes="remove", s_filter_um=2.0, l_filter_um=20.0, borders="cut")
    steps = found.chain.split(" → ")
    assert [step.split(":")[0] for step in steps] == ["spikes, 1 points", "S 2 um", "F plane", "L 20 um", "borders cut"]
    assert float(steps[-1].split("Sq ")[1].split()[0]) == pytest.approx(found.sq.value_um, rel=0.01)
    assert found.sp.value_um < 0.5 < texture(surface, region).sp.value_um


def test_a_mask_with_holes_leaves_out_what_lies_in_them():
    z_um = noise()
    z_um[40:60, 60:90] += 4.0
    surface = height_map(z_um.astype(np.float32), 0.5, 0.0, 59.5)
    face = Region.polygon((0.5, 0.5), (79.0, 0.5), (79.0, 59.0), (0.5, 59.0))
    masked = texture(surface, face.without(Region.rectangle(29.4, 29.6, 45.1, 40.1)))
    assert masked.sq.value_um == pytest.approx(0.1, rel=0.02)
    assert masked.measured_fraction == pytest.approx(1.0, abs=0.02)
    assert texture(surface, face).sq.value_um > 5 * masked.sq.value_um


def test_holes_belong_to_regions_with_an_area():
    with pytest.raises(MeasureError, match="it must be rectangle, circle, polygon"):
        Region.line(0, 0, 1, 1).without(Region.circle(0, 0, 1))


def test_the_area_of_a_mask_is_what_its_holes_leave():
    ring = Region.circle(5, 5, 4).without(Region.circle(5, 5, 2))
    assert ring.area_um2 == pytest.approx(np.pi * 12, rel=2e-3)
    half_out = Region.rectangle(0, 0, 10, 10).without(Region.rectangle(5, -5, 15, 15))
    assert half_out.area_um2 == pytest.approx(50, rel=2e-3)


def test_numbers_in_place_of_a_region_are_refused_with_what_to_give():
    surface = height_map(noise().astype(np.float32), 0.5, 0.0, 59.5)
    with pytest.raises(MeasureError, match=r"The face region is \(1, 2, 3, 4\): give a Region"):
        texture(surface, (1, 2, 3, 4))
