"""A study of repeated measurements judged from the command line: numbers as JSON, or one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.measure.gauge.test_gauge_rr import AIAG
from wafer_viewer.cli.app import main

LINES = [
    f"{part + 1},{'ABC'[appraiser]},{value}"
    for appraiser in range(3)
    for part in range(10)
    for value in AIAG[part, appraiser]
]


@pytest.fixture
def study(tmp_path: Path):
    def write(lines: list[str], head: str = "part,appraiser,value") -> str:
        path = tmp_path / "study.csv"
        path.write_text("\n".join(["# step height of ten dies, um", head, *lines]) + "\n")
        return str(path)

    return write


def test_the_manuals_example(study, capsys: pytest.CaptureFixture[str]):
    assert main(["measure", "rr", study(LINES), "--tolerance", "4"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (reported["parts"], reported["appraisers"], reported["trials"]) == (10, 3, 3)
    assert reported["gauge_rr"] == pytest.approx(0.30237, abs=1e-5)
    assert (reported["interaction_variation"], round(reported["interaction_p"], 3)) == (0.0, 0.974)
    assert "interaction" not in reported
    assert reported["share_of_tolerance"] == pytest.approx(6 * 0.30237 / 4, abs=1e-4)
    assert main(["measure", "rr", study(LINES), "--method", "range"]) == 0
    assert json.loads(capsys.readouterr().out)["distinct_categories"] == 5


@pytest.mark.parametrize(
    ("lines", "head", "printed"),
    [
        (LINES[:-1], "part,appraiser,value", "part 10 has 2 values of C"),
        ([*LINES, "11,A,1", "11,A,1", "11,A,1"], "part,appraiser,value", "part 11 has 0 values of B"),
        ([*LINES[:-1], "10,C,high"], "part,appraiser,value", "line 92: 'high' is not a number"),
        ([*LINES[:-1], "10,C"], "part,appraiser,value", "line 92: '' is not a number"),
        (LINES, "part,who,value", "no column appraiser"),
        ([], "part,appraiser,value", "no values"),
        ([line for line in LINES if line.startswith("1,")], "part,appraiser,value", "two parts"),
    ],
)
def test_an_invalid_study_is_refused_in_one_sentence(study, capsys, lines, head, printed):
    assert main(["measure", "rr", study(lines, head)]) == 2
    reported = capsys.readouterr()
    assert reported.out == ""
    assert reported.err.count("\n") == 1
    assert printed in reported.err


def test_a_table_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["measure", "rr", str(tmp_path / "gone.csv")]) == 2
    assert "gone.csv" in capsys.readouterr().err
