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


def drawn(*places):
    marks = [Mark(f"{k}", regions) for k, regions in enumerate(places, 1)]
    return str(marked_map_svg("data:image/png;base64,", BOUNDS_UM, marks, KEY))


def badges(svg):
    return [(float(x), float(y)) for x, y in re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg)]


def test_a_map_has_axes_scale_and_colour_bar():
    svg = drawn([FACE])
    texts = re.findall(r"<text[^>]*>([^<]+)</text>", svg)
    assert {"x, y in µm", "Height, µm", "+10", "+20", "200\u202fµm"} <= set(texts)
    assert "linearGradient" in svg
    assert svg == drawn([FACE])


@pytest.mark.parametrize("n", [2, 5, 60])
def test_numbers_of_places_at_the_same_corner_do_not_cover_each_other(n):
    found = badges(drawn(*[[FACE]] * n))
    assert len(found) == n
    assert min(math.dist(one, other) for one, other in itertools.combinations(found, 2)) > 17


def test_the_number_of_a_point_leaves_the_point_in_sight():
    svg = drawn([Region.point(500, 300)])
    ((x, y),) = badges(svg)
    left, middle = (float(part) for part in re.search(r"M([\d.]+) ([\d.]+)h10", svg).groups())
    assert math.dist((x, y), (left + 5, middle)) > 8.5


def test_parts_left_out_are_drawn_too():
    assert drawn([FACE.without(Region.circle(150, 150, 20))]).count("a") > drawn([FACE]).count("a")
