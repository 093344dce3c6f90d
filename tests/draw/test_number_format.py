"""Numbers as the operator reads them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.draw.number_format import (
    MINUS,
    NOTHING,
    THIN,
    duration,
    length_text,
    number,
    round_length,
    round_step,
    share,
    size,
    tick_digits,
    ticks,
    value_and_u,
    with_unit,
)

LENGTHS = st.floats(1e-6, 1e9)


@pytest.mark.parametrize(
    ("value", "digits", "signed", "read"),
    [
        (33.914, 2, True, "+33.91"),
        (-11.741, 2, False, f"{MINUS}11.74"),
        (12345.6, 1, False, f"12{THIN}345.6"),
        (-0.001, 2, True, "0.00"),
        (float("nan"), 2, False, NOTHING),
        (None, 2, False, NOTHING),
    ],
)
def test_numbers_have_a_true_minus_and_thin_spaces(value: float | None, digits: int, signed: bool, read: str) -> None:
    assert number(value, digits, signed=signed) == read


@pytest.mark.parametrize(
    ("value", "u", "read"),
    [
        (11.8617, 0.31, ("11.86", "0.31")),
        (399.9, 4.21, ("399.9", "4.2")),
        (1234.4, 17.2, (f"1{THIN}234", "17")),
        (0.5, 0.0995, ("0.50", "0.10")),
        (5.0, None, ("5.00", NOTHING)),
    ],
)
def test_u_has_two_figures_and_the_value_ends_where_it_does(
    value: float, u: float | None, read: tuple[str, str]
) -> None:
    assert value_and_u(value, u) == read


@given(st.floats(1e-4, 1e4))
def test_u_never_shows_fewer_than_two_figures(u: float) -> None:
    shown = value_and_u(0.0, u)[1].replace(THIN, "")
    assert len(shown.replace(".", "").lstrip("0")) >= 2
    assert float(shown) == pytest.approx(u, rel=0.051)


@pytest.mark.parametrize(
    ("seconds", "read"),
    [(22.2, "0:23"), (0, "0:00"), (0.2, "0:01"), (619, "10:19"), (3723, "1:02:03"), (math.inf, NOTHING)],
)
def test_time_left_is_never_rounded_to_nothing(seconds: float, read: str) -> None:
    assert duration(seconds) == read


@pytest.mark.parametrize(
    ("n_bytes", "read"), [(0, "0 B"), (999, "999 B"), (3.4e9, "3.4 GB"), (212e9, "212 GB"), (999_600, "1.0 MB")]
)
def test_sizes_are_decimal(n_bytes: float, read: str) -> None:
    assert size(n_bytes) == read.replace(" ", THIN)


@pytest.mark.parametrize(
    ("fraction", "read"),
    [(0.006, "0.6 %"), (0.0, "0.0 %"), (0.0002, "< 0.1 %"), (0.99999, "99.9 %"), (1.0, "100.0 %")],
)
def test_shares_never_hide_what_is_there_or_missing(fraction: float, read: str) -> None:
    assert share(fraction) == read.replace(" ", THIN)


@given(LENGTHS)
def test_a_scale_bar_fits_and_is_not_too_short(room: float) -> None:
    length = round_length(room)
    assert room / 2.5 * 0.999 <= length <= room * 1.001
    assert f"{length:.0e}"[0] in "125"


@given(LENGTHS)
def test_a_step_is_round_and_not_too_small(least: float) -> None:
    assert least * 0.999 <= round_step(least) <= 2.5 * least * 1.001


@given(st.floats(-1e4, 1e4), st.floats(1e-2, 1e4))
def test_ticks_lie_inside_evenly_and_are_told_apart(low: float, span: float) -> None:
    values = ticks(low, low + span)
    assert values
    assert low - 1e-6 * span <= values[0]
    assert values[-1] <= low + span * (1 + 1e-6)
    texts = [number(v, tick_digits(values)) for v in values]
    assert len(set(texts)) == len(values)


def test_lengths_change_to_mm_from_one_on() -> None:
    assert length_text(500) == with_unit(500, 0)
    assert length_text(2000) == with_unit(2, 0, "mm")
