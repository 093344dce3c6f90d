"""Noise with long tails: a score is the deviation that normal noise would reach as seldom."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.measure.defects.matched_filters import BINS
from wafer_viewer.measure.defects.noise_model import KINDS, NOISE, NoiseModel, Planes, to_normal_deviations
from wafer_viewer.measure.defects.noise_model import noise_of as noise_over

KEY = ("height", 0.0)
SIDE, CELLS = 200, 6
PLAIN = np.zeros((SIDE, SIDE), np.uint8)


def noise_of(many: list[Planes], kinds: np.ndarray = PLAIN) -> NoiseModel:
    return noise_over(many, kinds, np.ones(BINS, np.float32))


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
    raw: list[Planes] = [{KEY: planes[KEY] / noise_of(heavy).spread[KEY][0]} for planes in heavy]
    assert over(raw, 4.5) > 200
    assert over(in_scores, 4.5) <= 0.1 * over(raw, 4.5)
    assert over(normal, 2 * 4.5) < 20


def test_a_few_defects_do_not_lengthen_the_tail() -> None:
    many = cells(np.random.default_rng(3), heavy=False)
    clean = noise_of(many).fall[KEY][0]
    for planes in many:
        planes[KEY][20:23, 20:23] = 40.0
    assert noise_of(many).fall[KEY][0] == pytest.approx(clean, rel=0.1)


def test_a_missing_die_does_not_lengthen_the_tail() -> None:
    many = cells(np.random.default_rng(3), heavy=False)
    clean = noise_of(many).fall[KEY][0]
    many[2][KEY][20:] += 30 * np.random.default_rng(6).standard_normal((SIDE - 20, SIDE)).astype(np.float32)
    assert noise_of(many).fall[KEY][0] == pytest.approx(clean, rel=0.1)


def test_a_wide_scale_of_which_hardly_anything_stands_out_has_the_tail_of_the_one_before() -> None:
    many = cells(np.random.default_rng(7), heavy=True)
    for planes in many:
        planes["height", 10.0] = np.random.default_rng(8).standard_normal((SIDE // 4, SIDE // 4)).astype(np.float32)
    noise = noise_of(many)
    assert noise.fall["height", 10.0][0] == noise.fall[KEY][0]


def test_scores_keep_their_order_and_sign_beyond_the_start_of_the_tail() -> None:
    plane = np.linspace(-20, 20, 401, dtype=np.float32)[None, :]
    falls = np.full(KINDS, 0.5 * NOISE.normal_fall, np.float32)
    scores = to_normal_deviations(plane, falls, np.zeros(plane.shape, np.uint8))
    assert (np.diff(scores[0]) > 0).all()
    assert scores[0, ::-1] == pytest.approx(-scores[0])
    assert scores[np.abs(plane) <= NOISE.start] == pytest.approx(plane[np.abs(plane) <= NOISE.start])
    assert scores.max() < plane.max() / 2


def test_uneven_ground_has_its_own_noise() -> None:
    many = cells(np.random.default_rng(4), heavy=False)
    kinds = PLAIN.copy()
    kinds[:, 150:] = 1
    for planes in many:
        planes[KEY][:, 150:] *= 5
    scores = noise_of(many, kinds).scores(many[0])[KEY]
    assert scores[:, 150:].std() == pytest.approx(1, abs=0.05)
    assert scores[:, :150].std() == pytest.approx(1, abs=0.05)


def test_hardly_any_uneven_ground_is_taken_to_be_as_noisy_as_plain_ground() -> None:
    many = cells(np.random.default_rng(5), heavy=False)
    kinds = PLAIN.copy()
    kinds[:5, :5] = 1
    spread = noise_of(many, kinds).spread[KEY]
    assert spread[1] == spread[0]


def test_nothing_compared_has_no_noise() -> None:
    assert noise_of([]).scores({KEY: np.ones((2, 2), np.float32)})[KEY] == pytest.approx(1.0)
