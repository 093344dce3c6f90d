"""Cp and Cpk of drawn parts, and what cannot have one."""

from __future__ import annotations

import json

import numpy as np
import pytest

from wafer_viewer.cli.app import main
from wafer_viewer.measure.gauge.process_capability import process_capability
from wafer_viewer.model.errors import MeasureError


def test_by_hand():
    found = process_capability([9.0, 10.0, 11.0], lower=7.0, upper=16.0)
    assert (found.mean, found.s) == (10.0, 1.0)
    assert (found.cp, found.cpk) == (pytest.approx(1.5), pytest.approx(1.0))
    assert found.cp_limits.low == pytest.approx(1.5 * np.sqrt(0.0506356 / 2), rel=1e-5)  # chi-squared, 2 degrees
    off = 1.959964 * np.sqrt(1 / 27 + 1 / 4)
    assert found.cpk_limits == (pytest.approx(1 - off, rel=1e-5), pytest.approx(1 + off, rel=1e-5))
    assert (found.word, found.beyond) == ("not shown", 0)
    assert found.expected_beyond == pytest.approx(0.00135, rel=1e-2)


def test_one_limit_has_no_cp_and_a_mean_beyond_it_a_negative_cpk():
    found = process_capability([9.0, 10.0, 11.0, 10.0], upper=9.0)
    assert (found.cp, found.cp_limits, found.word, found.beyond) == (None, None, "not capable", 3)
    assert found.cpk < 0


def test_the_limits_cover_what_was_drawn():
    rng = np.random.default_rng(4)
    each = [process_capability(rng.normal(0.3, 1, 50), lower=-4.5, upper=4.5) for _ in range(400)]
    covered = [
        np.mean([one.cp_limits.low <= 1.5 <= one.cp_limits.high for one in each]),
        np.mean([one.cpk_limits[0] <= 1.4 <= one.cpk_limits[1] for one in each]),
    ]
    assert (np.abs(np.array(covered) - 0.95) < 0.035).all()


@pytest.mark.parametrize(
    ("values", "limits", "message"),
    [
        ([1.0, 2.0], {}, "no limit"),
        ([1.0, 2.0], {"lower": 2.0, "upper": 1.0}, "smaller one as lower"),
        ([1.0], {"upper": 1.0}, "1 values"),
        ([1.0, np.nan], {"upper": 1.0}, "Value 2"),
        ([1.0, 1.0], {"upper": 2.0}, "the same"),
    ],
)
def test_what_has_no_capability_is_refused(values, limits, message):
    with pytest.raises(MeasureError, match=message):
        process_capability(values, **limits)


def test_a_column_of_a_table_from_the_command_line(tmp_path, capsys, monkeypatch):
    table = tmp_path / "steps.csv"
    rows = [f"w{k};{29.9 + 0.02 * k:.2f}".replace(".", ",") for k in range(11)]
    table.write_text("\n".join(["# of one lot", "wafer;height_um", *rows, "w12;"]) + "\n")
    words = ["measure", "capability", str(table), "--column", "height_um", "--lower", "29", "--upper", "31"]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["n"], found["mean"], found["word"]) == (11, pytest.approx(30.0), "capable")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert main([*words[:-1], "30.1"]) == 1
    assert "steps.csv, height_um: NOT CAPABLE, Cpk 0.50" in capsys.readouterr().out
    assert main([*words[:4], "depth", *words[5:]]) == 2
    assert "no column depth: it has wafer, height_um" in capsys.readouterr().err
