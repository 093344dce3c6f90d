"""What the page says of results: units, signs, where they come from, what of them is drawn and flown to."""

from __future__ import annotations

import pytest
from markupsafe import escape

from tests.browser.sessions.measuring_session import MeasuringSession
from tests.browser.sessions.shaped_session import ShapedSession
from wafer_viewer.draw.quantities import value_texts
from wafer_viewer.gui.presenters import measurement as words
from wafer_viewer.gui.presenters.measurement import ZERO, source
from wafer_viewer.gui.presenters.results import bounds_of
from wafer_viewer.gui.scenes.thumbnails import HEIGHT_PX, WIDTH_PX, framed, outlines
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.result_rows import labels_of
from wafer_viewer.model.measurement.tool_options import PLACES, Levelling
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT, TOOLS
from wafer_viewer.model.quantity import BudgetLine, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

PLACES_OF: dict[ToolName, tuple[Region, ...]] = {
    "profile": (Region.line(-100, 0, 100, 0),),
    "point": (Region.point(0, 0),),
    "distance": (Region.point(-20, -30), Region.point(40, 10)),
    "step": (Region.rectangle(0, -30, 30, 0), Region.rectangle(140, -30, 160, 0)),
    "groove": (Region.line(-127, -65, -77, -65, 10),),
    "angle": (Region.rectangle(80, -30, 110, 0), Region.rectangle(0, -30, 30, 0)),
    "radius": (Region.circle(-60, 40, 40),),
    "volume": (Region.rectangle(-120, -20, 0, 90),),
    "flatness": (Region.rectangle(0, -30, 30, 0),),
    "texture": (Region.rectangle(0, -30, 30, 0),),
    "roughness": (Region.line(0, -15, 30, -15),),
    "site_range": (Region.rectangle(-120, -80, 120, 80),),
}

SHAPED: dict[ToolName, tuple[Region, ...]] = {
    "kerf": (Region.rectangle(-40, -86, 39, -35),),
    "die": (Region.rectangle(-69, -57, 68, 57),),
    "circle": (Region.circle(0, 0, 9),),
    "chipping": (Region.rectangle(-40, -54, 39, -35),),
    "coplanarity": (Region.rectangle(-52, -40, 51, 40),),
    "particles": (Region.rectangle(-52, -40, 51, 40),),
}
"""Of dies with bumps, seen on a picture; all but the bumps have no height."""


@pytest.fixture(scope="module")
def found() -> dict[ToolName, AnyResult]:
    session = MeasuringSession()
    answers = {tool: session.measure(tool, places) for tool, places in PLACES_OF.items()}
    session.close()
    shaped = ShapedSession()
    answers |= {tool: shaped.measure(tool, places) for tool, places in SHAPED.items()}
    shaped.close()
    return answers


@pytest.mark.parametrize(
    ("value", "unit", "expanded", "said"),
    [
        (11.8623, "um", 0.31, ("11.86", "0.31", "µm")),
        (1_302_000.0, "um3", 24_000.0, ("1.302", "0.024", "nl")),
        (65_950.0, "um3", 15_000.0, ("66", "15", "pl")),
        (18.4567, "deg", 0.84, ("18.46", "0.84", "°")),
        (2_500_000.0, "um2", 30_000.0, ("2.500", "0.030", "mm²")),
        (950.0, "um2", None, ("950.00", "–", "µm²")),
    ],
)
def test_quantities_read_in_units_of_their_size_with_u_to_two_figures(value, unit, expanded, said):
    assert value_texts(Quantity(value=value, unit=unit, expanded=expanded)) == said


@pytest.mark.slow
@pytest.mark.parametrize("tool", list(TOOLS))
def test_every_quantity_of_a_result_is_shown(tool, found):
    text = words.numbers(found[tool])
    others = {name: one for name, one in found[tool].quantities.items() if name != found[tool].main_field}
    titles = labels_of(type(found[tool]))
    assert [name for name in others if titles[name].title not in text] == []


def test_a_budget_stands_in_the_unit_of_its_answer():
    lines = (BudgetLine(name="z scale", u=9000.0), BudgetLine(name="noise", u=12_000.0))
    text = words.budget(Quantity.evaluated(1_302_000.0, "um3", lines))
    assert "nl, k = 1" in text
    assert "0.0090" in text
    assert "0.0150 · 0.0300" in text


@pytest.mark.parametrize("tool", list(TOOLS))
def test_every_result_leads_back_to_its_tool_and_its_places(tool, found):
    assert TOOL_OF_RESULT[type(found[tool])].name == tool
    assert found[tool].inputs == {**PLACES_OF, **SHAPED}[tool]
    assert set(found[tool].inputs) <= set(found[tool].drawn)


@pytest.mark.parametrize("tool", list(TOOLS))
def test_every_result_says_where_it_comes_from_and_from_which_zero(tool, found):
    text = source(found[tool])
    assert "On the stitched surface" in text
    assert (stage_zero() in text) == (tool not in SHAPED or tool in ("coplanarity", "particles"))
    assert "SIMULATED" in text or not found[tool].simulated


def stage_zero() -> str:
    return escape(f"Heights are read from {ZERO['stage']}.")


def test_every_way_of_levelling_has_words():
    assert set(ZERO) == set(PLACES)
    assert Levelling().by in ZERO


def test_signs_are_letters_of_their_own(found):
    assert len({words.symbol(finding) for finding in found.values()}) == len(found)


def test_what_is_flown_to_holds_all_places_and_has_a_least_size(found):
    assert bounds_of(found["step"]) == (0, -30, 160, 0)
    x0, y0, x1, y1 = bounds_of(found["point"], least_um=20)
    assert (x1 - x0, y1 - y0) == (20, 20)


@pytest.mark.parametrize("tool", list(TOOLS))
def test_places_are_outlined_within_their_picture(tool, found):
    x0, y0, x1, y1 = box = framed(bounds_of(found[tool], 20))
    assert (x1 - x0) / (y1 - y0) == pytest.approx(WIDTH_PX / HEIGHT_PX)
    drawn = outlines(found[tool], box)
    assert drawn.count("<circle") + drawn.count("<polygon") + drawn.count("<polyline") == len(found[tool].drawn)


def test_a_step_across_an_edge_or_upside_down_is_no_large_number(found):
    step = found["step"]
    assert "font-size:40px" in words.card(step, "Step")
    height = step.height.value_um
    doubtful = {
        "rougher than a tenth": replace(step, upper_sq_um=0.11 * height),
        "lies below the lower one": replace(step, height=replace(step.height, value_um=-height)),
    }
    for words_of_it, finding in doubtful.items():
        told = words.card(finding, "Step")
        assert words_of_it in told
        assert "drag them" in told
        assert "40px" not in told
        assert "expanded" not in told
    assert "40px" in words.card(replace(step, upper_sq_um=0.09 * height), "Step")
