"""What the panels show: the map of the fields, the colour bar, words and shadows in the scene."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from tests.support.page_stand_in import COLS, PIXEL_UM, ROWS, grid
from wafer_viewer.draw.charts.colour_bar import colour_bar_html, origin_legend_html
from wafer_viewer.draw.charts.wafer_map import FIELD_INKS, field_map_svg
from wafer_viewer.draw.raster_text import LINE_PX, font, length_px, tag
from wafer_viewer.draw.surface.texture_baking import GroundLabel, hatch, shadow
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.session.state.snapshot import FieldState

WIDTH, HEIGHT = COLS * PIXEL_UM, ROWS * PIXEL_UM
SAMPLE = ((-600.0, -500.0), (600.0, -500.0), (600.0, 500.0), (-600.0, 500.0))


def svg(**kwargs: object) -> ElementTree.Element:
    return ElementTree.fromstring(field_map_svg(grid().fields(), WIDTH, HEIGHT, **kwargs))  # pyright: ignore


def boxes(picture: ElementTree.Element) -> dict[str, dict[str, float]]:
    result = {g.attrib["data-k"]: g.find("rect") for g in picture.iter("g") if "data-k" in g.attrib}
    return {
        k: {name: float(box.attrib[name]) for name in ("x", "y", "width", "height")}
        for k, box in result.items()
        if box is not None
    }


def test_the_map_shows_every_field_where_it_lies() -> None:
    at = boxes(svg(outline_um=SAMPLE))
    assert set(at) == {str(k) for k in range(1, 10)}
    assert at["2"]["x"] > at["1"]["x"]
    assert at["4"]["y"] > at["1"]["y"]
    assert at["1"]["width"] / at["1"]["height"] == pytest.approx(WIDTH / HEIGHT, rel=0.05)


def test_a_small_grid_on_a_large_sample_is_shown_enlarged_with_an_inset() -> None:
    wafer = tuple((x * 40, y * 40) for x, y in SAMPLE)
    near, far = boxes(svg(outline_um=SAMPLE)), boxes(svg(outline_um=wafer))
    assert far["1"]["width"] > 0.5 * near["1"]["width"]
    assert len(list(svg(outline_um=wafer).iter("polygon"))) == len(list(svg(outline_um=SAMPLE).iter("polygon"))) + 1


def test_a_field_can_be_clicked_and_named() -> None:
    picture = svg(states={5: "failed"}, pick="field", pick_place="place")
    field = next(g for g in picture.iter("g") if g.attrib.get("data-k") == "5")
    assert field.attrib["data-pick"] == "field"
    assert (picture.attrib["data-pick"], picture.attrib["data-where"]) == ("place", "map")
    assert field.attrib["aria-label"] == "Field 5, failed"


def test_every_state_of_a_field_has_its_ink() -> None:
    assert {state.value for state in FieldState} <= set(FIELD_INKS)


def test_there_is_no_map_of_nothing() -> None:
    assert field_map_svg((), WIDTH, HEIGHT) == ""


def test_the_colour_bar_labels_what_lies_in_its_range() -> None:
    bar = colour_bar_html("Height", "µm", -13.5, 16.5, "mako", [0, 4, 9, 1])
    labels = re.findall(r">([+\u2212]?\d+)<", bar)
    assert labels == ["\u221210", "\u22125", "0", "+5", "+10", "+15"]


def test_the_colour_bar_escapes_its_title_and_stands_a_range_of_nothing() -> None:
    assert "<b>" not in colour_bar_html("<b>", "", 1.0, 1.0, "grey", [])


def test_the_legend_of_origins_names_what_occurs() -> None:
    legend = origin_legend_html({int(Origin.MEASURED): 0.9, int(Origin.CLIPPED): 0.1})
    assert "too bright" in legend
    assert "no texture" not in legend


def test_words_hold_letters_the_font_lacks() -> None:
    micro, plain = tag("500 µm", (255, 255, 255)), tag("500 um", (255, 255, 255))
    assert micro.shape == plain.shape
    assert micro.shape[0] == LINE_PX
    below = slice(round(LINE_PX / 2 + 0.36 * 62 + 5), None)
    assert micro[below, :, 3].sum() > plain[below, :, 3].sum() + 1000


def test_a_word_is_as_long_as_it_says() -> None:
    assert length_px("1\u202f413", font(40)) == pytest.approx(length_px("1 413", font(40)))


def test_a_shadow_is_soft_and_dark_in_its_middle() -> None:
    square = [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)]
    picture = shadow(square, 3.0, 3.0, 0.1, darkness=0.5, shade=(10, 20, 30), long_side_px=300)
    assert picture[150, 150, 3] == pytest.approx(127, abs=4)
    assert picture[3, 3, 3] == 0
    edge = picture[150, 80:120, 3].astype(int)
    assert (np.diff(edge) >= 0).all()


def test_figures_stand_beside_the_shadow_in_their_own_colour() -> None:
    square = [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)]
    figure = GroundLabel("500 µm", 1.5, 2.6, 0.3, "m")
    picture = shadow(
        square, 3.0, 3.0, 0.1, darkness=0.5, shade=(0, 0, 0), ink=(200, 40, 40), figures=(figure,), long_side_px=300
    )
    letters = picture[240:280][picture[240:280, :, 3] > 200]
    assert len(letters) > 50
    assert np.abs(letters[:, :3].astype(int) - (200, 40, 40)).max() < 60


def test_the_hatch_repeats_along_its_diagonal() -> None:
    picture = hatch(52, 52, dark=False)
    assert np.array_equal(picture[0, 1:27], picture[1, 0:26])
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) == 2
