from __future__ import annotations

import xml.etree.ElementTree as ET

from tests.measure.tools.test_step_profile import ACROSS, grooved
from wafer_viewer.draw.charts.profile_plot import groove_svg
from wafer_viewer.measure.tools.step_profile import step_profile
from wafer_viewer.model.spec import replace


def test_the_picture_shows_the_curve_and_names_the_zones():
    result = step_profile(grooved(), ACROSS)
    picture = ET.fromstring(groove_svg(result))
    texts = [element.text for element in picture.iter() if element.tag.endswith("text")]
    assert {"A", "B", "C"} <= set(texts)
    (path,) = [element.get("d") for element in picture.iter() if element.tag.endswith("path")]
    assert path.count("M") == 1, "nothing is missing along the line"
    assert path.count("L") + 1 == len(result.curve) <= 240


def test_gaps_stay_open_and_without_a_curve_there_is_no_picture():
    result = step_profile(grooved(), ACROSS)
    holed = replace(result, curve=tuple(point for point in result.curve if not 20 < point[0] < 30))
    assert groove_svg(holed).count("M") == 2
    assert groove_svg(replace(result, curve=())) == ""
