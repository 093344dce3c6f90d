from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.support.made_up_sections import hill, section_of
from wafer_viewer.draw.charts.profile_plot import curves_svg, frame_of, profile_plot_html, round_ends, runs, thinned
from wafer_viewer.draw.colormaps import PROFILE_COLOURS

rng = np.random.default_rng(3)


curves = arrays(np.float64, st.integers(2, 3000), elements=st.floats(-100, 100) | st.just(np.nan))


@given(curves, st.integers(2, 400))
def test_a_thinned_curve_keeps_its_extremes_whatever_it_holds(z, most):
    x, shown = thinned(np.arange(len(z), dtype=float), z, most)
    assert len(x) == len(shown) <= (len(z) if len(z) <= most else most)
    assert (np.diff(x) >= 0).all()
    if np.isfinite(z).any():
        assert np.nanmax(shown) == np.nanmax(z)
        assert np.nanmin(shown) == np.nanmin(z)
        low, high = round_ends(shown)
        assert low < np.nanmin(z) <= np.nanmax(z) < high
    else:
        assert np.isnan(shown).all()


@pytest.mark.parametrize("n", [2, 99, 100, 101, 1007, 6000])
def test_a_thinned_curve_keeps_highest_and_lowest_and_the_order(n):
    x, z = np.arange(n, dtype=float), rng.normal(size=n)
    few_x, few_z = thinned(x, z, 100)
    assert len(few_x) == len(few_z) <= max(100, 2)
    assert (np.diff(few_x) >= 0).all()
    assert (few_z.min(), few_z.max()) == (z.min(), z.max())
    assert set(zip(few_x, few_z, strict=True)) <= set(zip(x, z, strict=True))


def test_a_thinned_curve_keeps_its_gap_and_draws_nothing_in_it():
    x, z = np.arange(6000.0), np.ones(6000)
    z[2000:2600] = np.nan
    z[2300] = 5.0
    few_x, few_z = thinned(x, z, 600)
    inside = (few_x > 2020) & (few_x < 2580) & (abs(few_x - 2300) > 20)
    assert inside.any()
    assert np.isnan(few_z[inside]).all()
    assert np.nanmax(few_z) == 5.0


def test_the_frame_ends_on_round_heights_and_stays_while_they_change_a_little():
    frame = frame_of([section_of(hill())])
    assert frame.x_um == (0.0, 3000.0)
    assert frame.z_um == (-5.0, 25.0)
    assert frame_of([section_of(hill(height_um=19.7))]).z_um == frame.z_um


def test_a_span_shows_a_part_and_its_own_heights():
    tall = frame_of([section_of(hill())], (2700.0, 5000.0))
    assert tall.x_um == (2700.0, 3000.0)
    assert tall.z_um[1] - tall.z_um[0] < 1
    assert frame_of([section_of(hill())], (9000.0, 9900.0)).x_um == (0.0, 3000.0)


def test_nothing_at_all_has_a_frame_too():
    assert frame_of([]).z_um == (-1.0, 1.0)
    nothing = section_of(np.full(50, np.nan))
    assert runs(nothing, frame_of([nothing])) == []


def paths(html: str) -> dict[str, str]:
    return {name: re.search(rf'data-curve="{re.escape(name)}" d="([^"]*)"', html)[1] for name in curves(html)}


def curves(html: str) -> list[str]:
    return re.findall(r'data-curve="([^"]*)"', html)


def test_a_gap_in_a_curve_is_a_gap_in_the_drawing():
    z = hill()
    z[1000:1500] = np.nan
    section = section_of(z)
    html = profile_plot_html([section], frame_of([section]), ())
    assert paths(html)["A"].count("M") == 2


def test_every_line_has_its_colour_and_what_is_compared_lies_over_it_in_dashes():
    sections = [section_of(hill()), section_of(hill(), 0, cleaned=True), section_of(hill(2000), 1)]
    html = profile_plot_html(sections, frame_of(sections), (100.0, 9000.0))
    assert curves(html) == ["A", "B", "A+"]
    strokes = dict(re.findall(r'data-curve="([^"]*)" d="[^"]*" stroke="([^"]*)"', html))
    assert (strokes["A"], strokes["B"]) == PROFILE_COLOURS[:2]
    assert PROFILE_COLOURS[0] in strokes["A+"]
    assert html.count("stroke-dasharray") == 1
    assert html.count("wv-cursor") == 1
    assert len(html) < 60_000


def test_named_curves_break_where_there_is_no_height_and_stay_in_the_frame():
    x_um = np.arange(6, dtype=np.float32)
    broken = np.array([0, 1, np.nan, 2, 500, 3], np.float32)
    drawing = curves_svg({"TEN": (x_um, broken), "true": (x_um, np.zeros(6, np.float32))}, (-10.0, 40.0))
    curve, truth = re.findall(r'<path d="([^"]*)" fill="none" stroke-width=".9"', drawing)
    assert (curve.count("M"), curve.count("L"), truth.count("M"), truth.count("L")) == (2, 3, 1, 5)
    heights_px = [float(y) for y in re.findall(r"[ML][\d.]+ ([\d.]+)", curve)]
    frame = re.search(r'<path d="M(\d+) (\d+)H(\d+)V(\d+)H', drawing)
    assert min(heights_px) == pytest.approx(float(frame[2]))
    assert [name in drawing for name in (">TEN<", ">true<")] == [True, True]
