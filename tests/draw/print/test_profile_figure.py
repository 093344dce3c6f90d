"""The profile figure in print: its size, its words and colours, and that nothing but the sections decides on it."""

from __future__ import annotations

import dataclasses
import io
import re
import xml.etree.ElementTree as ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from tests.support.made_up_sections import hill, section_of
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, rgb
from wafer_viewer.draw.print_figures import HEIGHT_PX, WIDTH_PX, profile_figure


def with_a_gap():
    z = hill()
    z[1000:1500] = np.nan
    z[1250] = 3.0
    return section_of(z)


def texts(svg: bytes) -> list[str]:
    return [element.text or "" for element in ElementTree.fromstring(svg).iter() if element.tag.endswith("}text")]


def counts(png: bytes, colour: str) -> int:
    image = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), int)
    return int((np.abs(image - np.array(rgb(colour[1:]))).max(axis=2) < 12).sum())


@pytest.mark.slow
def test_the_picture_shows_both_curves_in_their_colours_and_says_that_it_is_simulated():
    z = hill()
    z[:3000] = np.nan
    png = profile_figure([section_of(z), section_of(hill() - 10, 1, simulated=False)], "png")
    image = Image.open(io.BytesIO(png))
    assert image.size == (WIDTH_PX, HEIGHT_PX)
    assert image.info["dpi"] == pytest.approx((300, 300), abs=0.1)
    assert counts(png, PROFILE_COLOURS[0]) > 2000
    assert counts(png, PROFILE_COLOURS[1]) > 1.5 * counts(png, PROFILE_COLOURS[0])
    assert counts(png, PROFILE_COLOURS[2]) == 0
    red, real = counts(png, "#B42318"), counts(profile_figure([section_of(hill(), simulated=False)], "png"), "#B42318")
    assert red > 500 > 10 > real


@pytest.mark.slow
def test_the_words_of_a_drawing_are_text_with_units_and_sources():
    told = texts(profile_figure([with_a_gap(), section_of(hill() - 2, cleaned=True)], "svg"))
    assert {"z, µm", "Distance along the profile, µm", "1\u202f000", "SIMULATED"} <= set(told)
    assert any(text.startswith("A\u2003coupon-07, measured heights") for text in told)
    assert "SIMULATED" not in texts(profile_figure([section_of(hill(), simulated=False)], "svg"))


def test_dollar_signs_in_a_name_are_letters():
    section = dataclasses.replace(section_of(hill(50)), source="lot_$7_x^$")
    assert any("lot_$7_x^$" in text for text in texts(profile_figure([section], "svg")))


def test_a_gap_stays_open_and_a_single_point_in_it_is_a_dot():
    drawn = profile_figure([with_a_gap()], "svg").decode().lower()
    curve = next(d for d, look in re.findall(r'<path d="([^"]*)"[^>]*style="([^"]*)"', drawn) if "e8590c" in look)
    assert curve.count("m") >= 2
    assert len(re.findall(r"<use [^>]*e8590c", drawn)) == 1


@pytest.mark.slow
def test_a_page_of_vectors_is_seventeen_by_nine_centimetres():
    pdf = profile_figure([with_a_gap()], "pdf")
    box = re.search(rb"/MediaBox \[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", pdf)
    assert [float(side) / 72 * 2.54 for side in box.groups()] == pytest.approx([17, 9], abs=0.01)
    assert b"/TrueType" in pdf or b"/CIDFontType2" in pdf


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("kind", ["png", "pdf", "svg"])
def test_the_same_sections_are_the_same_file_whatever_the_users_settings_are(kind):
    before = profile_figure([with_a_gap()], kind)
    with mpl.rc_context({"font.size": 30.0, "axes.facecolor": "black"}):
        assert profile_figure([with_a_gap()], kind) == before
        assert mpl.rcParams["font.size"] == 30.0


@pytest.mark.slow
def test_without_a_measured_point_there_are_axes_alone():
    nothing = section_of(np.full(50, np.nan))
    assert counts(profile_figure([nothing], "png"), PROFILE_COLOURS[0]) < 1000  # the line of the legend
