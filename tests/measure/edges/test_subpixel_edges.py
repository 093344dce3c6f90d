"""Straight and round edges on pictures with known truth: how far off they are, what U says, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from tests.support.made_up_pictures import covered, disc, edge, pixels, strip
from wafer_viewer.measure.base.correlated_errors import chain_uncertainty, correlation_length
from wafer_viewer.measure.base.robust_fit import fit_line
from wafer_viewer.measure.edges.edge_search import U_SUBPIXEL_PX, SearchStrip
from wafer_viewer.measure.edges.straight_edges import find_edge
from wafer_viewer.measure.tools.circle import find_circle
from wafer_viewer.model.errors import MeasureError

RUNS = 40


def off_px(found, at_px):
    """How far an upright edge lies to the right of a place on the middle line."""
    return -float(found.line.off(at_px, 0.0))


def even_edge(at_px, blur_px):
    """Without noise and rounding."""
    x, _ = pixels(60, 80)
    return 60 + 120 * ndtr((x - at_px) / blur_px)


@pytest.mark.parametrize("blur_px", [0.7, 1.0, 2.0, 4.0])
def test_where_an_edge_lies_between_two_pixels_does_not_matter(blur_px):
    errors = [off_px(find_edge(strip(even_edge(at, blur_px))), at) for at in np.arange(0, 1, 0.05)]
    assert np.abs(errors).max() < 2 * U_SUBPIXEL_PX


@pytest.mark.parametrize("blur_px", [0.8, 1.2, 3.0])
def test_an_edge_in_noise_is_found_within_a_fiftieth_of_a_pixel(blur_px):
    errors, expanded = [], []
    for seed in range(RUNS):
        at = float(np.random.default_rng(seed).uniform(-0.5, 0.5))
        found = find_edge(strip(edge(at, blur_px=blur_px, seed=seed)))
        errors.append(off_px(found, at))
        expanded.append(found.line.u_um(float(found.line.along(at, 0.0))).expanded)
    assert abs(np.mean(errors)) < 0.005
    assert np.abs(errors).max() < 0.02
    assert covered(errors, expanded) >= 0.88


@pytest.mark.parametrize("correlation_px", [3.0, 8.0])
def test_u_covers_edges_whose_points_err_alike(correlation_px):
    found = [find_edge(strip(edge(0.3, seed=seed, correlation_px=correlation_px))) for seed in range(RUNS)]
    errors = [off_px(one, 0.3) for one in found]
    assert covered(errors, [one.line.u_um(float(one.line.along(0.3, 0.0))).expanded for one in found]) >= 0.88


def test_an_edge_says_its_slope_its_sign_and_how_sure_both_are():
    found = find_edge(strip(edge(0.3, slope=0.08)))
    assert found.sign == 1
    assert abs(found.line.angle_deg) == pytest.approx(90 + np.degrees(np.arctan(0.08)), abs=0.01)
    assert 0 < found.line.u_angle_deg.u < 0.01
    assert find_edge(strip(edge(0.3)[:, ::-1])).sign == -1


def test_a_line_is_square_to_its_points_and_leaves_outliers_out():
    rng = np.random.default_rng(1)
    along, off = np.linspace(-100, 100, 400), rng.normal(0, 0.05, 400)
    off[::17] += 6.0
    cos, sin = np.cos(np.radians(70)), np.sin(np.radians(70))
    line = fit_line(3 + along * cos - off * sin, -5 + along * sin + off * cos)
    assert line.angle_deg == pytest.approx(70, abs=0.01)
    assert float(line.off(3, -5)) == pytest.approx(0, abs=0.02)
    assert len(line.off_um) <= 400 - 24


@pytest.mark.slow
def test_a_circle_is_found_within_a_fiftieth_of_a_pixel_and_u_covers_it():
    errors, expanded = [], []
    for seed in range(RUNS):
        x_px, y_px = np.random.default_rng(seed).uniform(-2, 2, 2)
        found = find_circle(strip(disc(30.3, x_px, y_px, seed=seed)), 0.0, 0.0, 40.0)
        assert np.hypot(found.x_um - x_px, found.y_um - y_px) < 0.03
        errors.append(found.radius_um - 30.3)
        expanded.append(found.u_radius_um.expanded)
    assert abs(np.mean(errors)) < 0.005
    assert np.abs(errors).max() < 0.02
    assert covered(errors, expanded) >= 0.88


def test_what_is_missing_of_a_disc_does_not_move_its_circle():
    picture = disc(30.3)
    picture[60:76, 80:] = 60
    found = find_circle(strip(picture), 0.0, 0.0, 40.0)
    assert found.radius_um == pytest.approx(30.3, abs=0.05)


def test_neighbours_that_err_alike_are_distinguished_from_those_that_do_not():
    rng = np.random.default_rng(0)
    white = rng.normal(size=4000)
    assert correlation_length(white) == pytest.approx(1, abs=0.4)
    assert correlation_length(np.repeat(white[:400], 10)) == pytest.approx(10, rel=0.4)
    assert chain_uncertainty(np.ones((5000, 1)), rng.normal(size=5000), np.ones(1)).u == pytest.approx(
        1 / np.sqrt(5000), rel=0.1
    )
    assert chain_uncertainty(np.ones((4, 1)), white[:4], np.ones(1)) is None


def noise(rows=200, cols=160):
    return 120 + 20 * np.random.default_rng(5).normal(size=(rows, cols))


def two_edges():
    x, _ = pixels(200, 160)
    return 60 + 60 * ndtr(x + 40) + 58 * ndtr(x - 40)


def half_an_edge():
    grey = edge(0.0).astype(float)
    grey[100:] = 60
    return grey


@pytest.mark.parametrize(
    ("picture", "sentence"),
    [
        (lambda: np.full((200, 160), 90.0), "No edge stands out in the region"),
        (noise, "No edge stands out in the region"),
        (two_edges, "Two edges in the region are about as strong"),
        (half_an_edge, "No edge stands out in the region"),
    ],
)
def test_a_picture_without_one_clear_edge_is_one_sentence(picture, sentence):
    with pytest.raises(MeasureError, match=sentence):
        find_edge(strip(picture()))


def two_rings():
    x, y = pixels(160, 160)
    away = np.hypot(x, y)
    return 60 + 60 * ndtr(30 - away) + 58 * ndtr(55 - away)


@pytest.mark.parametrize(
    ("picture", "sentence"),
    [
        (lambda: np.full((160, 160), 90.0), "No round edge stands out"),
        (two_rings, "Two round edges in the circle are about as strong"),
        (lambda: edge(0.0, slope=0.0, rows=160, cols=160), "round edge"),
    ],
)
def test_a_picture_without_one_clear_round_edge_is_one_sentence(picture, sentence):
    with pytest.raises(MeasureError, match=sentence):
        find_circle(strip(picture()), 0.0, 0.0, 70.0)


def test_a_strip_knows_where_its_pixels_lie_however_it_is_turned():
    made = SearchStrip.of(np.arange(12.0).reshape(3, 4), 0.5, 10.0, 20.0)
    for one in (made, made.turned, made.reversed, made.turned.reversed, made.part(slice(1, 3), slice(2, 4))):
        line, place = np.indices(one.grey.shape)
        x_um, y_um = one.at(line.astype(float), place.astype(float))
        assert np.array_equal(one.grey, 4 * (20 - y_um) / 0.5 + (x_um - 10) / 0.5)
        again = one.where(x_um, y_um)
        assert np.allclose(again, (line, place))
