"""Places on the surface: where tools begin, what a pull does to them, what only echoes a drag."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.page_stand_in import MemoryShelf, height_map
from wafer_viewer.gui.scene.heightfield import HeightField
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.tools.initial_regions import first_levelling, initial_regions
from wafer_viewer.gui.tools.region_tools import CENTRE, SHAPES, has_required_kinds, outline_of
from wafer_viewer.gui.widgets.callbacks import EchoFilter
from wafer_viewer.model.measurement.tool_options import PLACES
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.region import Region
from wafer_viewer.session.rendering import render_statistics
from wafer_viewer.session.rendering.render_request import (
    CoarseHeightField,
    ColourScale,
    RenderRequest,
    SurfaceKey,
    SurfaceStatistics,
)

SIDE_PX = 300
SOURCE = SurfaceKey(None, "", 0, 1)  # type: ignore[arg-type]


def height_field_of(z_um: np.ndarray) -> HeightField:
    """A surface with pixels of 1 um, its lower left corner at (0, 0)."""
    import msgspec

    shelf = MemoryShelf({0: height_map(z_um, 1.0, 0.0, z_um.shape[0] - 1.0)})
    facts = msgspec.msgpack.decode(
        render_statistics.facts(shelf, RenderRequest(SOURCE, "facts")), type=SurfaceStatistics
    )
    relief = msgspec.msgpack.decode(
        render_statistics.relief(shelf, RenderRequest(SOURCE, "relief")), type=CoarseHeightField
    )
    scale = ColourScale("height", 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, ())
    return HeightField(relief, DisplayedSurface(SOURCE, facts, scale, facts.lowest_um, 1.0))


def xy() -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(SIDE_PX, dtype=float), np.arange(SIDE_PX, dtype=float)[::-1])
    return x, y


def noise() -> np.ndarray:
    return np.random.default_rng(1).normal(0, 0.05, (SIDE_PX, SIDE_PX))


def bumped() -> np.ndarray:
    """A dome of radius 30 at (90, 200) on a level face; nothing measured at the right edge."""
    x, y = xy()
    z = np.maximum(0, 12 * (1 - ((x - 90) ** 2 + (y - 200) ** 2) / 30**2)) + noise()
    z[:, 260:] = np.nan
    return z


def roof() -> np.ndarray:
    """Level for x under 150, from there on falling by 0.3 um per um."""
    return -0.3 * np.maximum(0, xy()[0] - 150) + noise()


def test_radius_and_volume_begin_at_what_stands_out() -> None:
    height_field = height_field_of(bumped())
    (circle,) = initial_regions("radius", height_field, (150.0, 150.0))
    assert (circle.points[0].x_um, circle.points[0].y_um) == pytest.approx((90, 200), abs=8)
    assert 20 < circle.radius_um < 55
    (square,) = initial_regions("volume", height_field, (150.0, 150.0))
    x0, y0, x1, y1 = square.bounds_um
    assert x0 < 60
    assert x1 > 120
    assert y0 < 170
    assert y1 > 230


def test_a_bump_is_found_where_its_die_ends_nearby() -> None:
    x, y = xy()
    die = (np.abs(x - 150) < 110) & (np.abs(y - 150) < 90)
    dome = np.maximum(0, 14 * (1 - ((x - 100) ** 2 + (y - 180) ** 2) / 50**2))
    (circle,) = initial_regions("radius", height_field_of(np.where(die, 12 + dome, 0) + noise()), (150.0, 150.0))
    assert (circle.points[0].x_um, circle.points[0].y_um) == pytest.approx((100, 180), abs=15)
    assert 25 < circle.radius_um < 70


def test_among_bumps_side_by_side_a_top_nearby_is_chosen() -> None:
    x, y = xy()
    z = 6 * np.clip(np.cos(x * (2 * np.pi / 30)) * np.cos(y * (2 * np.pi / 30)) - 0.4, 0, None) + noise()
    (circle,) = initial_regions("radius", height_field_of(z), (152.0, 152.0))
    at = circle.points[0]
    assert np.cos(at.x_um * (2 * np.pi / 30)) * np.cos(at.y_um * (2 * np.pi / 30)) > 0.8
    assert np.hypot(at.x_um - 152, at.y_um - 152) < 40


def test_an_angle_begins_on_the_slope_and_the_level_face() -> None:
    steep, level = initial_regions("angle", height_field_of(roof()), (150.0, 150.0))
    assert steep.bounds_um[0] > 150
    assert level.bounds_um[2] < 155


@pytest.mark.parametrize("tool", ["flatness", "texture"])
def test_a_face_is_looked_for_where_nothing_stands_out(tool) -> None:
    (square,) = initial_regions(tool, height_field_of(bumped()), (90.0, 200.0))
    x0, y0, x1, y1 = square.bounds_um
    away = math.hypot(max(x0 - 90, 0, 90 - x1), max(y0 - 200, 0, 200 - y1))
    assert away > 15
    assert x1 <= 260


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("tool", list(TOOLS))
@pytest.mark.parametrize("surface", [bumped, roof])
def test_every_tool_begins_with_the_places_it_asks_for_on_the_surface(tool, surface: Callable[[], np.ndarray]) -> None:
    height_field = height_field_of(surface())
    places = initial_regions(tool, height_field, (250.0, 40.0))
    assert tuple(p.kind for p in places) == tuple(requested.kind for requested in TOOLS[tool].places)
    for place in places:
        for point in place.points:
            assert height_field.clamped((point.x_um, point.y_um)) == (point.x_um, point.y_um)


@pytest.mark.parametrize("tool", ["point", "distance"])
def test_points_begin_where_there_is_a_height(tool) -> None:
    height_field = height_field_of(bumped())
    for place in initial_regions(tool, height_field, (295.0, 150.0)):
        assert height_field.measured(np.array([place.points[0].x_um]), np.array([place.points[0].y_um]))[0]


@pytest.mark.parametrize("by", list(PLACES))
def test_every_way_of_levelling_begins_with_its_places(by) -> None:
    levelling = first_levelling(by, height_field_of(bumped()), (150.0, 150.0))
    assert levelling.by == by
    assert len(levelling.places) == PLACES[by]


def test_three_points_lie_far_apart_and_not_on_the_bump() -> None:
    x, y = np.array(
        [
            (p.points[0].x_um, p.points[0].y_um)
            for p in first_levelling("three points", height_field_of(bumped()), (0, 0)).places
        ]
    ).T
    area = abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])) / 2
    assert area > 0.1 * SIDE_PX**2
    assert np.hypot(x - 90, y - 200).min() > 25


def test_tools_begin_in_what_is_in_sight() -> None:
    x, y = xy()
    z = bumped() + np.maximum(0, 30 * (1 - ((x - 200) ** 2 + (y - 60) ** 2) / 40**2))
    height_field = height_field_of(z)
    sight = height_field.within((30.0, 140.0, 150.0, 260.0))
    assert sight.bounds_um == (30.0, 140.0, 150.0, 260.0)
    (circle,) = initial_regions("radius", sight, (90.0, 200.0))
    assert (circle.points[0].x_um, circle.points[0].y_um) == pytest.approx((90, 200), abs=8)
    assert height_field.within((500.0, 500.0, 600.0, 600.0)) is height_field


LAND = height_field_of(bumped())
PLACES_ON_IT = st.tuples(st.floats(-200, 500), st.floats(-200, 500))
SHAPED = {
    "point": Region.point(120, 90),
    "rectangle": Region.rectangle(100, 80, 160, 120),
    "circle": Region.circle(130, 100, 25),
    "line": Region.line(100, 80, 160, 120),
}


@pytest.mark.parametrize("kind", list(SHAPES))
@given(to=PLACES_ON_IT)
def test_whatever_is_pulled_stays_on_the_surface_and_of_its_kind(kind, to) -> None:
    for hold in SHAPES[kind].holds(SHAPED[kind]):
        pulled = SHAPES[kind].pulled(SHAPED[kind], hold, LAND.clamped(to), LAND)
        x0, y0, x1, y1 = pulled.bounds_um
        assert pulled.kind == kind
        assert x0 >= -0.01
        assert y0 >= -0.01
        assert max(x1, y1) <= SIDE_PX - 0.99
        least = math.hypot(x1 - x0, y1 - y0) if kind == "line" else min(x1 - x0, y1 - y0)
        assert kind == "point" or least >= 4 - 0.01


def test_the_middle_moves_a_region_whole_and_the_rim_its_radius() -> None:
    moved = SHAPES["rectangle"].pulled(SHAPED["rectangle"], CENTRE, (200, 200), LAND)
    assert moved.bounds_um == (170, 180, 230, 220)
    wider = SHAPES["circle"].pulled(SHAPED["circle"], "rim", (130, 140), LAND)
    assert (wider.points, wider.radius_um) == (SHAPED["circle"].points, 40)


def test_outlines_are_those_of_the_regions() -> None:
    assert len(outline_of(SHAPED["point"])) == 0
    ring = outline_of(SHAPED["circle"])
    assert np.hypot(ring[:, 0] - 130, ring[:, 1] - 100) == pytest.approx(25)
    assert outline_of(Region.line(1, 2, 3, 4)).tolist() == [[1, 2], [3, 4]]


def test_an_echo_is_heard_once_and_what_was_told_before_it_is_past() -> None:
    echoes: EchoFilter[int] = EchoFilter()
    for value in (1, 2, 3):
        echoes.tell(value)
    assert echoes.is_echo(2)
    assert echoes.is_echo(2)  # the view still holds it
    assert echoes.is_echo(3)
    assert not echoes.is_echo(1)  # chosen again from a list


def test_places_of_another_tool_do_not_fit() -> None:
    square = Region.rectangle(0, 0, 1, 1)
    assert has_required_kinds(TOOLS["flatness"], (square,))
    assert not has_required_kinds(TOOLS["step"], (square,))
    assert not has_required_kinds(TOOLS["radius"], (square,))
    assert not has_required_kinds(TOOLS["point"], ())
