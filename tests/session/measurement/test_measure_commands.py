"""Measuring on what is shown: the tool by its name, the zero by choice, the calibration as the dataset has it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.surfaces import calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.registry import measuring_function
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Datum, Levelling
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.region import Region
from wafer_viewer.session.measurement.dataset_queries import Measuring

POINT, CIRCLE = Region.point(-20.0, 10.0), Region.circle(20.0, 0.0, 14.0)
LEFT, RIGHT = Region.rectangle(-45, -30, -25, 30), Region.rectangle(-22, -30, 2, 30)
PLACES = {
    "profile": (Region.line(-40, 0, 40, 0),),
    "point": (POINT,),
    "distance": (POINT, Region.point(0.0, -20.0)),
    "step": (LEFT, RIGHT),
    "groove": (Region.line(20, -39, 20, 39, 4),),
    "angle": (LEFT, RIGHT),
    "radius": (CIRCLE,),
    "volume": (Region.rectangle(3, -17, 37, 17),),
    "particles": (Region.rectangle(-10, -35, 45, 35),),
    "flatness": (LEFT,),
    "texture": (LEFT,),
    "roughness": (Region.line(-40, -20, -10, -20),),
    "site_range": (Region.rectangle(-40, -30, -5, 30),),
}
SHAPES = {"kerf", "die", "circle", "chipping", "coplanarity"}
"""These want a picture or bumps; `tests/measure/tools/test_shapes.py` and `test_coplanarity.py` have some."""
PLANE = Levelling(by="plane")


class Shown:
    """A dataset with a stitched surface and one field, which are told apart by their heights."""

    def __init__(self):
        x_um, y_um = np.meshgrid(*coordinates(160, 200))
        away2 = (x_um - 20) ** 2 + y_um**2
        bump = np.where(away2 < 100, np.sqrt(np.maximum(400 - away2, 0)) - np.sqrt(300), 0)
        self.z = bump + 0.01 * x_um + noise_of(1, x_um.shape, 0.02)
        self.asked: list[int] = []
        self.problem: str | None = None
        self.stamp = 1

    def surface(self, show):
        self.asked.append(show)
        return surface_of(self.z + 5 * show, calibration=calibration(), z_step_um=1.0, simulated=True)

    def snapshot(self):
        data = SimpleNamespace(path=Path("a.wafer"), stamps={3: 7}, calibration_problem=self.problem)
        compared = (SimpleNamespace(stamp=self.stamp),)
        return SimpleNamespace(dataset=data, surface=SimpleNamespace(stamp=self.stamp), comparisons=compared)


@pytest.fixture
def shown():
    return Shown()


@pytest.fixture
def measuring(shown):
    return Measuring(shown.surface, shown.snapshot)


def test_every_tool_has_a_measurement_and_places_to_be_tried_at():
    assert all(callable(measuring_function(tool)) for tool in TOOLS)
    assert set(TOOLS) == set(PLACES) | SHAPES


@pytest.mark.parametrize("tool", PLACES)
def test_every_tool_measures_on_what_is_shown(measuring, tool):
    found = measuring.measure(tool, PLACES[tool], show=3, levelling=PLANE)
    assert (found.show, found.levelling, found.simulated, found.number) == (3, PLANE, True, 0)
    assert np.isfinite(found.main.value)
    assert found.main.unit == {"angle": "deg", "volume": "um3"}.get(tool, "um")


def test_a_field_and_the_whole_are_different_surfaces(measuring):
    complete, field = measuring.measure("point", (POINT,)), measuring.measure("point", (POINT,), 3)
    assert field.height.value_um - complete.height.value_um == pytest.approx(15.0, abs=1e-5)


def test_a_height_is_read_from_the_zero_that_is_chosen(measuring):
    zero = measuring.datum(PLANE)
    from_stage, from_plane = (measuring.measure("point", (POINT,), 0, levelling) for levelling in (None, PLANE))
    under = float(zero.at(np.array(-20.0), np.array(10.0)))
    assert from_plane.height.value_um == pytest.approx(from_stage.height.value_um - under, abs=1e-3)
    assert measuring.datum(Levelling()) == Datum()
    line, curve = measuring.profile(Region.line(-45, 0, -5, 0), 0, PLANE)
    assert line.levelling == PLANE
    assert abs(np.nanmedian(curve.z_um)) < 0.3
    assert measuring.measure("step", (LEFT, RIGHT), levelling=PLANE).levelling == PLANE


def test_a_zero_is_found_once_for_each_state_of_a_surface(measuring, shown):
    for _ in range(3):
        measuring.datum(PLANE)
    assert shown.asked == [0]
    measuring.datum(PLANE, 3)
    assert shown.asked == [0, 3]
    shown.stamp = 2
    measuring.datum(PLANE)
    assert shown.asked == [0, 3, 0], "the surface has grown, so its plane is another"
    for stamp in (2, 3, 3):
        shown.stamp = stamp
        measuring.datum(PLANE, -1)
    assert shown.asked == [0, 3, 0, -1, -1], "a comparison that was made anew"


def test_without_a_calibration_that_holds_there_is_no_uncertainty(measuring, shown):
    assert measuring.measure("step", (LEFT, RIGHT)).main.status == "evaluated"
    shown.problem = "the calibration was due on 2026-01-01"
    assert measuring.measure("step", (LEFT, RIGHT)).main.status == "uncalibrated"


@pytest.mark.parametrize(
    ("tool", "places", "sentence"),
    [
        ("distance", (POINT,), r"Distance is measured at 2 places \(from, to\), 1 are given: give as many"),
        ("point", (), r"Point is measured at 1 places \(point\), 0 are given"),
        ("flatness", (POINT,), "has no area"),
        ("radius", (LEFT,), "draw a circle"),
        ("point", (CIRCLE,), "set a point"),
        ("profile", (LEFT,), "needs a line"),
    ],
)
def test_places_that_a_tool_does_not_take_are_one_sentence(measuring, tool, places, sentence):
    with pytest.raises(MeasureError, match=sentence):
        measuring.measure(tool, places)
