"""Fields for a number that may be left empty: what is typed becomes a number, nothing, or a sentence."""

from __future__ import annotations

import pytest

from tests.support.paths import PACKAGE
from wafer_viewer.gui.widgets.number_field import EMPTY, number_of, pair_of, pair_text, text_of
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.measurement.measuring_tool import NumberControl
from wafer_viewer.model.measurement.tools import TOOLS

GUI = PACKAGE / "gui"


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("", None),
        ("  ", None),
        ("0", 0.0),
        ("23.5", 23.5),
        ("23,5", 23.5),
        ("−5", -5.0),
        ("1e-3", 0.001),
        ("1 200", 1200.0),
    ],
)
def test_what_is_typed_is_a_number_or_nothing(typed: str, meant: float | None):
    assert number_of(typed, "Sample, °C") == meant


@pytest.mark.parametrize("typed", ["warm", "1.2.3", "nan", "inf", "5 um"])
def test_what_is_no_number_is_refused_by_name(typed: str):
    with pytest.raises(WaferViewerError, match="Sample, °C"):
        number_of(typed, "Sample, °C")


def test_limits_are_said_with_the_value():
    with pytest.raises(WaferViewerError, match="over 0"):
        number_of("0", "Pixel, µm", over=0)
    with pytest.raises(WaferViewerError, match="whole"):
        number_of("1.5", "Next in, days", integer=True)
    assert number_of("3", "Next in, days", integer=True) == 3


@pytest.mark.parametrize("value", [None, 0.0, 23.5, 0.123456789, -5.0, 400.0, 1e-7])
def test_a_value_comes_back_as_it_was(value: float | None):
    assert number_of(text_of(value), "x") == value


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("", None),
        ("12.5 × 8", (12.5, 8.0)),
        ("12,5 x 8", (12.5, 8.0)),
        ("12.5, 8", (12.5, 8.0)),
        ("12.5;8", (12.5, 8.0)),
        ("12.5 8", (12.5, 8.0)),
        ("−3, 0", (-3.0, 0.0)),
    ],
)
def test_what_is_typed_is_a_pair_or_nothing(typed: str, meant: tuple[float, float] | None):
    assert pair_of(typed, "Corner, µm") == meant
    assert pair_of(pair_text(meant), "Corner, µm") == meant


@pytest.mark.parametrize("typed", ["12", "1 × 2 × 3", "a × b", "1 ×", "0 × 8"])
def test_what_is_no_pair_is_refused_by_name(typed: str):
    with pytest.raises(WaferViewerError, match="Size, mm"):
        pair_of(typed, "Size, mm", over=0)


def test_no_hint_says_that_zero_stands_for_nothing():
    text = [
        line.strip()
        for path in GUI.rglob("*.py")
        for line in path.read_text().splitlines()
        if any(word in line for word in ("0: not", "0: no ", "0: none", "0: a ", "0: four"))
    ]
    assert text == []


def test_every_option_of_a_tool_says_what_happens_when_it_is_empty() -> None:
    controls = [control for tool in TOOLS.values() for control in tool.controls]
    assert {control.label for control in controls if isinstance(control, NumberControl)} <= set(EMPTY)
