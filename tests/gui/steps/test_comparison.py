"""What the page says of comparisons."""

from __future__ import annotations

import re

import pytest

from tests.browser.sessions.compared_session import AFTER, ALIGNED, CHANGE, CLEANED, FIRST, GOLDEN, RAW, comparisons
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.surface import comparison as words
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import ComparisonFace, Registration, SurfaceName, comparison_of, show_of
from wafer_viewer.session.rendering.render_request import SurfaceKey


def plain(html: str) -> str:
    return re.sub(r"<[^>]+>", "|", html).replace("\u202f", " ")


def test_pairs_are_called_by_what_tells_them_apart():
    assert words.pair_label(FIRST, GOLDEN) == "L2231-W07-golden"
    assert words.pair_label(RAW, CLEANED) == "Measured and filtered"
    assert words.pair_label(FIRST, SurfaceName(path=FIRST.path, result="levy")) == "Result levy"
    assert (
        SurfaceName(path="C:\\data\\a.npz", result="levy", field=3, heights="raw").words
        == "a.npz · levy · field 3 · raw"
    )
    assert words.surfaces_sentence(comparisons()[0].comparison) == "First: L2231-W07. Second: L2231-W07-after."


def test_every_number_of_an_alignment_stands_with_its_uncertainty():
    text = plain(words.alignment(ALIGNED))
    assert "Shift x||+5.991 ± 0.045 µm" in text
    assert "Shift y||−3.986 ± 0.045 µm" in text
    assert "Turn||−0.01 ± 0.21 mrad" in text
    assert "Height||−1.0000 ± 0.0010 µm" in text
    assert "97.9 %" in text
    assert "k = 2" in text
    assert "both are of the same frames" in plain(words.alignment(Registration()))
    by_stage = plain(words.alignment(Registration(by="stage", levelled=True, u_z_um=0.1, u_tilt_mrad=0.1)))
    assert "Shift" not in by_stage
    assert "by the stage" in by_stage


def test_numbers_have_signs_and_limits():
    text = plain(words.change_numbers(CHANGE))
    assert "+0.016 µm" in text
    assert "beyond ±0.22 µm" in text
    assert "4.97 pl" in text
    assert words.volume(2.5e6).replace("\u202f", " ") == "2.50 nl"
    assert "1.3" in plain(words.change_figures(CHANGE))


def test_what_weakens_a_comparison_is_said():
    comparison = comparisons()[0].comparison
    assert "uncalibrated" in words.warnings(comparison, outdated=False)
    assert words.OUTDATED in words.warnings(comparison, outdated=True)
    little = replace(comparison, calibrated=True, registration=replace(ALIGNED, overlap_fraction=0.2))
    assert plain(words.warnings(little, outdated=False)).strip("|").startswith("Only 20.0 % of the first")
    assert words.warnings(replace(comparison, calibrated=True), outdated=False) == ""


@pytest.mark.parametrize("face", ComparisonFace)
def test_one_number_says_which_comparison_and_what_of_it(face):
    from tests.browser.sessions.compared_session import ComparedSession

    session = ComparedSession()
    try:
        show = show_of(2, face)
        assert show < 0
        assert comparison_of(show) == (2, face)
        source = SurfaceKey(session.snapshot.dataset.path, "difference-2", -face, 2)
        assert source_of(session.snapshot, show) == source
        assert source_of(session.snapshot, show_of(7, face)) is None
        assert View(show=show).shows_difference == (face is ComparisonFace.DIFFERENCE)
    finally:
        session.close()
    assert comparison_of(0) is None
    assert comparison_of(3) is None


def test_the_second_to_be_compared_is_named_in_the_list():
    assert words.comparison_name(comparisons()[0].comparison) == AFTER.words
