"""Depth shade and the light of brushed heights, as they are baked into a point's colour."""

from __future__ import annotations

import dataclasses

import numpy as np

from tests.support.page_stand_in import height_map
from wafer_viewer.draw.charts.colour_bar import histogram_html
from wafer_viewer.draw.colormaps import BRUSH, rgb
from wafer_viewer.draw.surface.display_style import DisplayStyle, Light
from wafer_viewer.draw.surface.texture_baking import bake, depth_shade

PIT = np.s_[20:40, 20:40]


def pitted() -> np.ndarray:
    z = np.full((60, 60), 10.0, np.float32)
    z[PIT] = 0.0
    return z


def test_level_ground_is_light_and_the_foot_of_a_wall_dark():
    shade = depth_shade(pitted(), 1.0, 1.0)
    assert shade[5, 5] == 1.0
    assert shade[21, 21] < 0.6
    assert shade[30, 30] > shade[21, 21]
    assert shade.min() >= np.float32(0.28)


def test_points_of_one_colour_show_their_relief_by_shade_alone():
    plain = DisplayStyle(low=-1e6, high=1e6, hillshade=0.0)
    part = height_map(pitted(), 1.0)
    flat = bake(part, plain, Light())[..., :3].astype(int)
    shaded = bake(part, dataclasses.replace(plain, depth_shade=1.0), Light())[..., :3].astype(int)
    assert np.ptp(flat.sum(axis=2)) == 0
    assert shaded[21, 21].sum() < 0.7 * flat[21, 21].sum()
    assert (shaded[5, 5] == flat[5, 5]).all()


def test_brushed_heights_take_the_colour_of_the_brush_and_no_others_do():
    part = height_map(pitted(), 1.0)
    plain = DisplayStyle(low=0.0, high=10.0, hillshade=0.0)
    before = bake(part, plain, Light())[..., :3].astype(int)
    lit = bake(part, dataclasses.replace(plain, brush_um=(-1.0, 1.0)), Light())[..., :3].astype(int)
    assert np.abs(lit[PIT] - rgb(BRUSH)).max() <= 0.14 * 255 + 1
    before[PIT] = lit[PIT]
    assert (before == lit).all()


def test_a_histogram_has_a_bar_for_each_bin_with_heights():
    drawn = histogram_html((0, 4, 9, 0, 1), (-1.0, 4.0), ("mako", 0.0, 3.0), within_um=(0.0, 2.5))
    assert drawn.count("<rect") == 3
    assert drawn.count("var(--line)") == 1
    assert histogram_html((), (0.0, 0.0), None) == ""
