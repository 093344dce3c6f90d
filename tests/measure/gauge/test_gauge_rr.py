"""Gauge R&R: the manual's own example, and studies whose spread is known."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.measure.gauge.gauge_studies import gauge_rr
from wafer_viewer.model.errors import MeasureError

AIAG = np.array(
    [
        [
            [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36],
            [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25],
            [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31],
        ],
        [
            [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68],
            [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62],
            [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50],
        ],
        [
            [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49],
            [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77],
            [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16],
        ],
    ]
).transpose(2, 0, 1)
"""The example of the manual: ten parts, three appraisers, three trials."""


def test_the_manuals_example_by_anova():
    found = gauge_rr(AIAG)
    assert (found.parts, found.appraisers, found.trials) == (10, 3, 3)
    assert round(found.repeatability, 6) == 0.199933
    assert round(found.reproducibility, 6) == 0.226838
    assert found.gauge_rr == pytest.approx(0.302373, abs=2e-6)  # the manual adds rounded variances
    assert round(found.part_variation, 6) == 1.042327
    assert round(100 * found.share_of_variation, 1) == 27.9
    assert found.distinct_categories == 4
    assert found.interaction_p == pytest.approx(0.974, abs=5e-4)
    assert found.interaction_variation == 0.0


def test_the_manuals_example_has_its_table_of_variance():
    rows = {row.effect: row for row in gauge_rr(AIAG).anova}
    assert [row.freedom for row in rows.values()] == [9, 2, 18, 60]
    assert rows["part"].f == pytest.approx(245.614, rel=1e-4)
    assert rows["appraiser"].f == pytest.approx(39.617, rel=1e-4)
    assert rows["part"].mean_square == pytest.approx(9.81799, abs=1e-5)
    assert rows["part x appraiser"].f == pytest.approx(0.434, abs=5e-4)
    assert rows["repeatability"].f is None


@pytest.mark.slow
@pytest.mark.parametrize("together", [0.0, 0.4])
def test_confidence_limits_cover_what_was_drawn(together: float):
    drawn = 2.0, 0.5, together, 0.3
    true = drawn[3], np.sqrt(drawn[1] ** 2 + together**2 + drawn[3] ** 2), drawn[0]
    rng, covered = np.random.default_rng(11), np.zeros(3)
    for _ in range(300):
        each = zip(drawn, ((10, 1, 1), (1, 3, 1), (10, 3, 1), (10, 3, 3)), strict=True)
        found = gauge_rr(sum(rng.normal(0, s, shape) for s, shape in each))
        limits = found.repeatability_limits, found.gauge_rr_limits, found.part_limits
        covered += [one.low <= s <= one.high for one, s in zip(limits, true, strict=True)]
    assert (covered / 300 > 0.91).all()  # .95 less three deviations of 300 studies
    assert (covered / 300 < 0.985).all()


def test_limits_of_repeatability_are_those_of_chi_squared():
    limits = gauge_rr(AIAG).repeatability_limits
    low, high = (found * 0.199933 for found in (np.sqrt(78 / 104.316), np.sqrt(78 / 55.466)))  # 78 degrees of freedom
    assert (limits.low, limits.high) == (pytest.approx(low, rel=1e-3), pytest.approx(high, rel=1e-3))


@pytest.mark.parametrize(
    ("tolerance", "word"),
    [(None, "acceptable for some uses"), (40.0, "acceptable for some uses"), (0.3, "not acceptable")],
)
def test_the_worse_of_variation_and_tolerance_gives_the_word(tolerance, word):
    found = gauge_rr(AIAG, tolerance=tolerance)
    assert found.word == word
    assert ("VDA 5" in found.why) == (tolerance is not None)
    if tolerance == 0.3:
        assert "604.7 % of the tolerance" in found.why
        assert found.q_mp == pytest.approx(4 * found.gauge_rr / 0.3)
        assert "not fit for this tolerance" in found.why


def test_the_manuals_example_by_range():
    found = gauge_rr(AIAG, method="range")
    # The manual goes on with rounded ranges: .3417 for .34167.
    assert found.repeatability == pytest.approx(0.20188, abs=3e-5)
    assert found.reproducibility == pytest.approx(0.22963, abs=5e-5)
    assert found.gauge_rr == pytest.approx(0.30575, abs=3e-5)
    assert found.part_variation == pytest.approx(1.10456, abs=1e-4)
    assert found.total_variation == pytest.approx(1.14610, abs=1e-4)
    assert round(100 * found.share_of_variation, 1) == 26.7
    assert found.distinct_categories == 5


def a_study(rng: np.random.Generator, together: float = 0.0) -> np.ndarray:
    shape = 200, 60, 4
    return (
        rng.normal(0, 2.0, (shape[0], 1, 1))
        + rng.normal(0, 0.5, (1, shape[1], 1))
        + rng.normal(0, together, shape[:2])[..., None]
        + rng.normal(0, 0.3, shape)
    )


@pytest.mark.parametrize("together", [0.0, 0.4])
def test_each_spread_is_found(together: float):
    found = gauge_rr(a_study(np.random.default_rng(3), together), tolerance=6.0)
    assert found.repeatability == pytest.approx(0.3, rel=0.02)
    assert found.reproducibility == pytest.approx(np.hypot(0.5, together), rel=0.2)
    assert found.part_variation == pytest.approx(2.0, rel=0.1)
    assert found.share_of_tolerance == pytest.approx(found.gauge_rr)
    assert found.interaction_p is not None
    assert (found.interaction_p < 0.05) == (together > 0)
    assert found.interaction_variation == pytest.approx(together, rel=0.02)


def test_one_appraiser_says_nothing_of_others():
    found = gauge_rr(AIAG[:, :1])
    assert found.reproducibility is None
    assert any("not evaluated" in note for note in found.notes)
    assert (found.interaction_variation, found.interaction_p) == (None, None)


def test_repeats_that_do_not_differ_leave_the_interaction_alone():
    x = np.repeat(np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 1.0]])[..., None], 2, axis=2)
    found = gauge_rr(x)
    assert (found.repeatability, found.interaction_p) == (0.0, 0.0)
    assert found.interaction_variation == pytest.approx(np.sqrt(2 / 3))


def test_what_does_not_vary_has_no_share():
    found = gauge_rr(np.ones((3, 2, 2)))
    assert (found.gauge_rr, found.distinct_categories) == (0.0, 0)
    assert np.isnan(found.share_of_variation)


@pytest.mark.parametrize(
    ("values", "method", "message"),
    [
        (AIAG[:, :, :1], "anova", "two trials"),
        (AIAG[:1], "anova", "two parts"),
        (np.where(AIAG == 2.26, np.nan, AIAG), "anova", "Part 9, appraiser 1, trial 1"),
        (np.concatenate([AIAG, AIAG]), "range", "20 parts"),
    ],
)
def test_a_study_that_is_none_is_refused(values, method, message):
    with pytest.raises(MeasureError, match=message):
        gauge_rr(values, method=method)
