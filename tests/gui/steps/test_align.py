"""What an operator reads, and what a click on the picture of a corner means."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from tests.browser.sessions import operator_session as day
from wafer_viewer.gui.presenters.verdict import card, features
from wafer_viewer.gui.steps.align import clicked, corner_picture, expected_um, square_round
from wafer_viewer.gui.steps.job_dialogs import suggested_marks
from wafer_viewer.gui.steps.preflight_lines import section
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.spec import replace
from wafer_viewer.session.planning.preflight import preflight_of_snapshot

OVERVIEW = Overview(np.zeros((1000, 1000), np.uint8), 6.0, -2997.0, 2997.0, (), (), "wafer")
JOB = day.a_released_job("W07")


def words(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<style.*?</style>|<[^>]+>", " ", html)).strip()


def test_a_click_on_the_picture_is_the_place_that_is_drawn_there():
    square, row, col, side_px = square_round(OVERVIEW, (-2000.0, 0.0))
    assert (row, col, side_px) == (500, 166, 50)
    assert square.at(*square.shares((-1990.0, 7.0))) == pytest.approx((-1990.0, 7.0))
    middle_of_pixel = square.at((side_px // 2 + 0.5) / side_px, (side_px // 2 + 0.5) / side_px)
    assert middle_of_pixel == pytest.approx((-2997.0 + 166 * 6, 2997.0 - 500 * 6))
    n, place = clicked(f"1;{square.left_um!r};{square.top_um!r};{square.side_um!r};0.5;0.25")
    assert n == 1
    assert place == pytest.approx((square.left_um + 150, square.top_um - 75))


def test_the_second_corner_is_expected_where_the_first_one_says():
    assert expected_um(JOB, (None, None), 1) == pytest.approx((2000, 0))
    assert expected_um(JOB, ((-1980.0, 11.0), None), 1) == pytest.approx((2020, 11))
    up = replace(JOB, sample=replace(JOB.sample, notch="up"))
    assert expected_um(up, (None, None), 0) == pytest.approx((2000, 0), abs=1e-9)


def test_the_picture_says_what_it_asks_for_and_without_one_what_to_do():
    drawn = corner_picture(OVERVIEW, JOB, (None, (2001.0, 2.0)), 0)
    assert 'aria-label="Click corner 1: left"' in drawn
    assert 'class="seen"' not in drawn
    assert 'class="seen"' in corner_picture(OVERVIEW, JOB, (None, (2001.0, 2.0)), 1)
    assert "mark the stage position" in words(corner_picture(None, JOB, (None, None), 0))


def test_dies_suggest_corners_far_apart():
    dies = tuple(((x, y), (x + 4, y), (x + 4, y + 3), (x, y + 3)) for x in (-20, 0, 20) for y in (-10.0, -1.0, 9.0))
    marks = suggested_marks(dataclasses.replace(OVERVIEW, dies_um=dies))
    assert [(m.x_um, m.y_um) for m in marks.places] == [(-20, -1), (24, -1)]
    assert [m.x_um for m in suggested_marks(None).places] == [0, 0]


def test_each_line_of_the_look_round_has_a_word_beside_its_colour():
    text = section(preflight_of_snapshot(day.aligned(14.6), None, "2026-11-21"))
    assert [re.search(r'aria-label="(\w+)"', part).group(1) for part in text.split('role="listitem"')[1:]] == [
        *("ok", "stop", "ok", "ok", "ok", "ok")
    ]
    assert "1 of 6 needs attention" in text
    assert "14.6 µm of 10 µm: too large" in words(text)
    assert section(()) == ""


@pytest.mark.parametrize(
    ("verdict", "word", "then"),
    [
        (day.PASS, "PASS", "Take the next wafer."),
        (day.FAIL, "FAIL", "Set the wafer aside"),
        (day.OPEN, "INCONCLUSIVE", "Scan it"),
    ],
)
def test_a_verdict_is_a_word_the_wafer_and_what_to_do(verdict, word, then):
    text = words(card(verdict))
    assert text.startswith(word)
    assert "W07 · L2231 · Coupon 6 mm B SIMULATED" in text
    assert then in text
    assert "not released" not in text
    assert "a trial: the job is not released" in words(card(replace(verdict, released=False)))
    hostile = replace(verdict, wafer_id="<img src=x>")
    assert "<img src=x>" not in card(hostile)


def test_features_are_listed_with_their_u_and_why_they_do_not_pass():
    assert "30.42 ± 0.14 29.5 … 30.5" in words(features(day.OPEN))
    assert "0.08 µm from the limit" in words(features(day.OPEN))
    bare = replace(day.PASS, items=(replace(day.PASS.items[0], measured=None, word="no verdict", why="Not seen."),))
    assert "not measured" in words(features(bare))
    assert "Not seen." in words(features(bare))
