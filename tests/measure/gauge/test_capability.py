"""Cg and Cgk by hand."""

from __future__ import annotations

import pytest

from wafer_viewer.measure.gauge.gauge_studies import VARIANT, capability


def test_cg_and_cgk_by_hand():
    """Errors of 0.01 +- 0.02 in turn: s = 0.02 sqrt(26 / 25), T = 2: Cg = 0.4 / (6 s), Cgk = (0.2 - 0.01) / (3 s)."""
    found = capability([0.03, -0.01] * 13, 2.0)
    s_um = 0.02 * (26 / 25) ** 0.5
    assert (found.n, found.s_um) == (26, pytest.approx(s_um))
    assert found.cg == pytest.approx(0.4 / (6 * s_um))
    assert found.cgk == pytest.approx(0.19 / (3 * s_um))
    assert found.capable is True
    assert found.variant == VARIANT


def test_a_bias_takes_from_cgk_alone():
    found = capability([0.13, 0.09] * 13, 2.0)
    assert found.cg == pytest.approx(0.4 / (6 * found.s_um))
    assert found.cgk == pytest.approx((0.2 - 0.11) / (3 * found.s_um))
    assert capability([0.16, 0.12] * 13, 2.0).capable is False


def test_fewer_than_25_repeats_give_numbers_but_no_verdict():
    found = capability([0.03, -0.01] * 12, 2.0)
    assert found.cg is not None
    assert found.capable is None
    assert "24 of 25" in found.why


def test_repeats_that_do_not_differ_say_nothing():
    found = capability([0.01] * 25, 2.0)
    assert (found.cg, found.cgk, found.capable) == (None, None, None)
    assert "do not differ" in found.why
    assert capability([], 2.0).n == 0
