"""The map of a report: axes, scale, colour bar, and a number beside every place that no other one covers."""

from __future__ import annotations

import itertools
import math
import re

import pytest

from wafer_viewer.draw.charts.marked_map import MapKey, Mark, marked_map_svg
from wafer_viewer.model.region import Region

BOUNDS_UM = (0.0, 0.0, 1000.0, 600.0)
KEY = MapKey(-2.0, 30.0, "mako")
FACE = Region.rectangle(100, 100, 200, 200)


LEADER = r'd="M[\d.]+ [\d.]+L[\d.]+ [\d.]+" fill="none" stroke="#15202B" stroke-width="1.1"'


def drawn(*places, bounds_um=BOUNDS_UM, key=KEY):
    marks = [Mark(f"{k}", regions) for k, regions in enumerate(places, 1)]
    return str(marked_map_svg("data:image/png;base64,", bounds_um, marks, key))


def texts(svg):
    return re.findall(r"<text[^>]*>([^<]+)</text>", svg)


def badges(svg):
    return [(float(x), float(y)) for x, y in re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg)]


def test_a_map_has_axes_scale_and_colour_bar():
    svg = drawn([FACE])
    assert {"x, y in µm", "Height, µm", "+10", "+20", "200\u202fµm"} <= set(texts(svg))
    assert "linearGradient" in svg
    assert svg == drawn([FACE])


@pytest.mark.slow
@pytest.mark.parametrize("n", [2, 5, 60])
def test_numbers_of_places_at_the_same_corner_do_not_cover_each_other(n):
    svg = drawn(*[[FACE]] * n)
    found = badges(svg)
    assert len(found) == n
    assert min(math.dist(one, other) for one, other in itertools.combinations(found, 2)) > 17
    assert bool(re.findall(LEADER, svg)) == (n == 60), "a number away from its place has a line to it"


def test_the_number_of_a_point_leaves_the_point_in_sight():
    svg = drawn([Region.point(500, 300)])
    ((x, y),) = badges(svg)
    left, middle = (float(part) for part in re.search(r"M([\d.]+) ([\d.]+)h10", svg).groups())
    assert math.dist((x, y), (left + 5, middle)) > 8.5


def test_parts_left_out_are_drawn_too():
    assert drawn([FACE.without(Region.circle(150, 150, 20))]).count("a") > drawn([FACE]).count("a")


@pytest.mark.parametrize("bounds_um", [(0, 0, 3000, 120), (0, 0, 120, 3000), (0, 0, 500, 500)])
def test_nothing_of_a_map_of_any_shape_leaves_the_drawing(bounds_um):
    x1, y1 = bounds_um[2:]
    corners = [[Region.point(x, y)] for x in (0, x1) for y in (0, y1)]
    svg = drawn(*corners, *[[Region.point(x1 / 2, y1 / 2)]] * 8, bounds_um=bounds_um)
    wide, high = (float(side) for side in re.search(r'viewBox="0 0 (\d+) (\d+)"', svg).groups())
    found = badges(svg)
    assert all(9 <= x <= wide - 9 and 9 <= y <= high - 9 for x, y in found)
    assert min(math.dist(one, other) for one, other in itertools.combinations(found, 2)) > 17
    labels = [
        (float(x), float(y), 5.0 * len(text))
        for x, y, text in re.findall(r'<text x="([-\d.]+)" y="([-\d.]+)" text-anchor="middle">([^<]+)<', svg)
    ]
    assert labels
    for (x, y, width), (other_x, other_y, other_width) in itertools.combinations(labels, 2):
        assert y != other_y or abs(x - other_x) > (width + other_width) / 2


def test_a_large_surface_has_its_axes_in_mm():
    shown = texts(drawn(bounds_um=(-15000, -15000, 15000, 15000)))
    assert {"x, y in mm", "10", "\u221210"} <= set(shown)
    assert "x, y in µm" not in shown


def test_lines_join_the_regions_of_one_place():
    svg = drawn([FACE, Region.rectangle(400, 100, 500, 200)])
    ((x0, y0, x1, y1),) = re.findall(r'd="M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)" [^>]+ stroke-dasharray', svg)
    assert y0 == y1
    per_um = (float(x1) - float(x0)) / 200
    assert per_um == pytest.approx((680 - 48 - 98) / 1000, rel=0.01), "from the edge of one to that of the other"


def test_what_is_not_measured_has_a_hatch_in_the_legend():
    assert "Not measured, 5 %" in texts(drawn(key=MapKey(-2.0, 30.0, "mako", "Not measured, 5 %")))
    assert "hatch" not in drawn()
