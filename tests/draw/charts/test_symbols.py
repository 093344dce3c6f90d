"""Signs that differ by shape."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from wafer_viewer.draw.charts.axes import SHAPES, symbol, symbol_svg
from wafer_viewer.draw.charts.wafer_map import MapMark, MapViewport, map_marks_svg


def test_every_shape_is_a_drawing_of_its_own_in_the_colour_asked_for():
    drawn = {name: symbol_svg(name, "#D55E00") for name in SHAPES}
    assert len(set(drawn.values())) == len(SHAPES)
    for text in drawn.values():
        root = ElementTree.fromstring(text)
        assert root[0].get("fill") == root[0].get("color") == "#D55E00"
        assert len(root[0]) == 1


def test_a_sign_stands_at_its_place():
    assert "translate(3.5 -2.0)" in symbol("bar", "#000", 3.5, -2.0)


def test_a_mark_on_the_map_has_the_shape_of_its_class():
    frame = MapViewport((0.0, 0.0, 100.0, 100.0), 200, 200)
    text = map_marks_svg(frame, (), [MapMark(50.0, 50.0, "#008F6B", "D3 <Pattern>", shape="triangle")])
    assert "<path" in text
    assert "translate(100.0 100.0)" in text
    assert "&lt;Pattern&gt;" in text
