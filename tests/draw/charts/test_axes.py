from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.draw.charts.axes import Axis, ChartAxes, PlotLook, plot_html, round_ticks

ENDS = st.tuples(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6)).map(lambda pair: (pair[0], pair[0] + pair[1]))


@given(ENDS, st.floats(0, 1))
def test_a_share_of_the_range_is_that_share_of_the_drawing(ends, share):
    value = ends[0] + share * (ends[1] - ends[0])
    assert Axis(ends, (58.0, 664.0)).at(value) == pytest.approx(58 + share * 606, abs=1e-2)
    assert Axis(ends, (174.0, 8.0)).at(value) == pytest.approx(174 - share * 166, abs=1e-2)


@given(ENDS, st.integers(3, 12))
def test_round_ticks_lie_within_the_ends_and_no_two_labels_are_alike(ends, most):
    ticks = round_ticks(ends, most)
    assert 1 <= len(ticks) <= most + 1
    assert len({text for _, text in ticks}) == len(ticks)
    slack = 1e-6 * (ends[1] - ends[0])
    assert all(ends[0] - slack <= value <= ends[1] + slack for value, _ in ticks)


def test_an_array_is_placed_as_each_of_its_values():
    axis = Axis((-5.0, 25.0), (8000, 0))
    values = np.array([-5.0, 10.0, 25.0])
    assert axis.at(values).tolist() == [axis.at(value) for value in values] == [8000, 4000, 0]


def test_a_range_without_extent_has_its_value_at_the_low_end():
    axis = Axis((3.0, 3.0), (0, 100), round_ticks((3.0, 3.0), 6))
    assert [(axis.at(value), text) for value, text in axis.ticks] == [(0, "3.0")]


def test_values_beyond_the_ends_stay_on_the_axis():
    axis = Axis((0.0, 16.0), (0, 1000))
    assert [axis.at(axis.within(z)) for z in (-1.0, 4.0, 99.0)] == [0, 250, 1000]


def test_every_tick_has_a_grid_line_and_a_label_at_its_place():
    axes = ChartAxes.stretched((0.0, 40.0), (0.0, 2.0), round_ticks((0.0, 40.0), 4), round_ticks((0.0, 2.0), 2))
    drawn = plot_html(axes, PlotLook("Plot", "y", "x"), "<b/>")
    lines = re.search(r'd="([^"]*)" stroke="var\(--line\)"', drawn)[1]
    assert re.findall(r"M([\d.]+) 0V1000", lines) == [f"{250 * k:.1f}" for k in range(5)]
    assert re.findall(r"M0 ([\d.]+)H1000", lines) == ["1000.0", "500.0", "0.0"]
    assert re.findall(r'left:([\d.]+)%">(\d+)', drawn) == [(f"{25 * k:.2f}", f"{10 * k}") for k in range(5)]
    assert re.findall(r'top:([\d.]+)%">(\d+)', drawn) == [("100.00", "0"), ("50.00", "1"), ("0.00", "2")]


def test_labels_in_a_drawing_of_fixed_size_stand_below_and_left_of_the_plot():
    axes = ChartAxes(Axis((0.0, 1.0), (58, 664), ((1.0, "1"),)), Axis((0.0, 1.0), (174, 8), ((0.0, "0"),)))
    assert axes.frame() == "M58 8H664V174H58Z"
    assert axes.labels_svg() == (
        '<text x="664.0" y="188" text-anchor="middle">1</text><text x="52" y="178.0" text-anchor="end">0</text>'
    )
