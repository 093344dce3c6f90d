"""Noise with long tails: a score is the deviation that normal noise would reach as seldom."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.measure.defect_noise import NORMAL_FALL, START, Planes, as_normal, noise_of

KEY = ("height", 0.0)
SIDE, CELLS = 200, 6


def cells(rng: np.random.Generator, heavy: bool) -> list[Planes]:
    """Uncorrelated noise of spread 2, normal or of Laplace's distribution."""
    draw = rng.laplace if heavy else rng.standard_normal
    return [{KEY: 2 * np.asarray(draw(size=(SIDE, SIDE)), np.float32)} for _ in range(CELLS)]


def over(planes: list[Planes], limit: float) -> int:
    return sum(int((np.abs(plane[KEY]) > limit).sum()) for plane in planes)


def test_normal_noise_keeps_its_deviations() -> None:
    many = cells(np.random.default_rng(1), heavy=False)
    scores = noise_of(many).scores(many[0])[KEY]
    assert scores == pytest.approx(many[0][KEY] / 2, rel=0.03, abs=0.02)


def test_noise_with_long_tails_reaches_a_score_hardly_more_often_than_normal_noise() -> None:
    rng = np.random.default_rng(2)
    heavy, normal = cells(rng, heavy=True), cells(rng, heavy=False)
    in_scores = [noise_of(heavy).scores(planes) for planes in heavy]
    raw = [{KEY: planes[KEY] / np.float32(noise_of(heavy).spread[KEY])} for planes in heavy]
    assert over(raw, 4.5) > 200
    assert over(in_scores, 4.5) <= 0.1 * over(raw, 4.5)
    assert over(normal, 2 * 4.5) < 20


def test_a_few_defects_do_not_lengthen_the_tail() -> None:
    many = cells(np.random.default_rng(3), heavy=False)
    clean = noise_of(many).fall[KEY]
    for planes in many:
        planes[KEY][20:23, 20:23] = 40.0
    assert noise_of(many).fall[KEY] == pytest.approx(clean, rel=0.1)


def test_scores_keep_their_order_and_sign_beyond_the_start_of_the_tail() -> None:
    plane = np.linspace(-20, 20, 401, dtype=np.float32)[None, :]
    scores = as_normal(plane, 0.5 * NORMAL_FALL)
    assert (np.diff(scores[0]) > 0).all()
    assert scores[0, ::-1] == pytest.approx(-scores[0])
    assert scores[np.abs(plane) <= START] == pytest.approx(plane[np.abs(plane) <= START])
    assert scores.max() < plane.max() / 2


def test_nothing_compared_has_no_noise() -> None:
    assert noise_of([]).scores({KEY: np.ones((2, 2), np.float32)})[KEY] == pytest.approx(1.0)
