"""The map of many fields, the marks over it, and where a click on it lies."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from wafer_viewer.draw.charts.wafer_map import MOST_SINGLE, MapMark, field_map_svg, map_frame, map_marks_svg
from wafer_viewer.model.acquisition.plan import FieldGrid

SIDE = 100
SIZE_UM = (336.0, 252.0)


def fields(side: int = SIDE):
    grid = FieldGrid(rows=side, cols=side, field_width_um=SIZE_UM[0], field_height_um=SIZE_UM[1])
    return grid.centred_on(0.0, 0.0).fields()


def test_ten_thousand_fields_are_few_shapes():
    every = fields()
    states = {f.number: "measured" if f.row < SIDE / 2 else "to come" for f in every}
    drawing = field_map_svg(every, *SIZE_UM, states, selected=7, pick="field")
    assert len(every) == 10_000
    assert len(drawing) < 400_000
    paths = ElementTree.fromstring(drawing).findall(".//path")
    assert sorted(path.find("title").text for path in paths) == ["measured", "pending"]
    assert [path.get("d").count("M") for path in paths] == [5000, 5000]
    assert drawing.count("data-k=") == 1  # the one that is selected


def test_few_fields_are_buttons_of_their_own():
    few = fields(4)
    assert len(few) <= MOST_SINGLE
    assert field_map_svg(few, *SIZE_UM).count('role="button"') == len(few)


@pytest.mark.parametrize("place_um", [(0.0, 0.0), (-4321.0, 987.6)])
def test_a_place_on_the_picture_is_one_on_the_stage_and_back(place_um):
    frame = map_frame(fields(), *SIZE_UM)
    assert frame.um_at(frame.x(place_um[0]), frame.y(place_um[1])) == pytest.approx(place_um)


def test_a_click_is_turned_into_um_by_the_scale_of_the_map():
    frame = map_frame(fields(), *SIZE_UM)
    drawing = ElementTree.fromstring(field_map_svg(fields(), *SIZE_UM, pick_place="place"))
    (whole,) = (element for element in drawing.iter() if "data-frame" in element.attrib)
    assert whole.get("data-where") == "map"
    x_um, y_um, scale = (float(number) for number in whole.get("data-frame").split(","))
    assert (x_um, y_um) == pytest.approx(frame.um_at(0, 0), abs=1e-3)
    assert scale == pytest.approx(frame.scale)


def test_marks_lie_where_results_are_and_names_cannot_break_out():
    frame = map_frame(fields(), *SIZE_UM)
    drawing = map_marks_svg(frame, (), [MapMark(500.0, -200.0, "red", 'a "<b>" & c', chosen=True)])
    root = ElementTree.fromstring(drawing)
    assert root.find(".//title").text == 'a "<b>" & c'
    circles = root.findall(".//circle")
    assert len(circles) == 2  # its ring as well
    assert float(circles[0].get("cx")) == pytest.approx(frame.x(500.0), abs=0.1)
    assert float(circles[0].get("cy")) == pytest.approx(frame.y(-200.0), abs=0.1)


def test_what_is_seen_is_a_frame_and_from_very_near_a_cross():
    frame = map_frame(fields(), *SIZE_UM)
    wide = map_marks_svg(frame, [(-5000, -5000), (5000, -5000), (5000, 5000), (-5000, 5000)], [])
    near = map_marks_svg(frame, [(0, 0), (20, 0), (20, 20), (0, 20)], [])
    assert "<polygon" in wide
    assert "<polygon" not in near
    assert "<path" in near
    assert map_marks_svg(frame, (), []) == ""
