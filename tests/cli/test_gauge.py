"""A study of repeated measurements judged from the command line: numbers as JSON, or one sentence."""

from __future__ import annotations

import json
import re
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
    ("head", "separator", "comma"),
    [
        ("Part,Operator,Measurement", ",", "."),
        ("Wafer;Operator;Height (um)", ";", ","),
        ("sample\tinspector\treading [µm]", "\t", "."),
    ],
)
def test_columns_and_separators_as_people_write_them(study, capsys, head, separator, comma):
    lines = [separator.join(text.replace(".", comma) for text in line.split(",")) for line in LINES]
    assert main(["measure", "rr", study(lines, head)]) == 0
    assert json.loads(capsys.readouterr().out)["gauge_rr"] == pytest.approx(0.30237, abs=1e-5)


def test_a_person_at_a_terminal_reads_a_table(study, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert main(["measure", "rr", study(LINES), "--tolerance", "0.5"]) == 0
    told = capsys.readouterr().out
    assert "NOT ACCEPTABLE: Gauge R&R is 27.9 % of the total variation and 362.8 % of the tolerance" in told
    assert re.search(r"part x appraiser +18 +0\.358982 +0\.0199435 +0\.4337 +0\.9741", told)
    assert "0.1729 to 0.2371" in told


@pytest.mark.parametrize(
    ("lines", "head", "printed"),
    [
        (LINES[:-1], "part,appraiser,value", "part 10 has 2 values of C"),
        ([*LINES, "11,A,1", "11,A,1", "11,A,1"], "part,appraiser,value", "part 11 has 0 values of B"),
        ([*LINES[:-1], "10,C,high"], "part,appraiser,value", "line 92: 'high' is not a number"),
        ([*LINES[:-1], "10,C"], "part,appraiser,value", "line 92: '' is not a number"),
        (LINES, "part,who,value", "no column appraiser, only part, who, value"),
        (LINES, "value,appraiser,value", "no column part"),
        (LINES, "part,appraiser,value,part", "two columns part"),
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
