"""Names that a spreadsheet would run as formulas stay text in every table."""

from __future__ import annotations

import csv
import dataclasses
import io

import numpy as np
import pytest

from tests.store.tables.test_measurements_csv import STEP
from tests.support.datasets.inspections import defect, inspection
from tests.support.made_up_sections import hill, section_of
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.measurement.measurements import StepHeight
from wafer_viewer.model.quantity import Length
from wafer_viewer.store.tables.csv_tables import TableWriter, defects_csv, findings_csv, profiles_csv

FORMULAS = (
    "=1+1",
    '=HYPERLINK("http://evil.example")',
    "@SUM(A1)",
    "+cmd|' /C calc'!A0",
    "-2+3+cmd|' /C calc'!A0",
    "\t=1+1",
    "\r=1+1",
    "\r\n=1+1",
    " =1+1",
)
LINES = "a\r=1+1", "a\n=1+1", "a,=1+1"
"""Names that would begin a cell in the middle."""


def runs(cell: str) -> bool:
    """Whether a spreadsheet may take a cell for a formula."""
    text = cell.strip(" \t\r\n")
    if text[:1] in ("=", "@"):
        return True
    return text[:1] in ("+", "-") and not set(text) <= set("+-0123456789.,eE ")


def cells(text: str) -> list[str]:
    return [cell for row in csv.reader(io.StringIO(text)) for cell in row]


@pytest.mark.parametrize("formula", [*FORMULAS, *LINES])
def test_a_name_is_no_formula_in_any_table(formula: str) -> None:
    height = Length(value_um=-1.5, status="uncalibrated")
    result = StepHeight(number=1, name=formula, height=height, **STEP)
    judged = defect(1, "-1,0", 1.0, 2.0, judged_by=formula, note=formula, reasons=(formula,))
    section = dataclasses.replace(section_of(hill(50)), source=formula)
    for text in (
        findings_csv(MeasurementResults(items=(result,))),
        defects_csv(inspection(judged)),
        profiles_csv([section], "1.2"),
    ):
        assert not [cell for cell in cells(text) if runs(cell)]


def test_a_name_of_several_lines_adds_none_to_the_head_of_a_table() -> None:
    section = section_of(hill(50))
    text = profiles_csv([dataclasses.replace(section, source="a\n=1+1,=2")], "1.2")
    heads = [line for line in text.splitlines() if line.startswith("#")]
    assert len(heads) == len(text.splitlines()) - 51
    assert not [cell for cell in cells(text) if runs(cell)]


def test_numbers_dies_and_plain_names_are_as_they_were() -> None:
    plain = ["-1.5", "+2", "-1,0", "-1e-05", "a=b", "W7-3", "", 3, -2.5, np.float64(-1.25), "-"]
    text = io.StringIO()
    TableWriter(text).writerow(plain)
    assert next(csv.reader(io.StringIO(text.getvalue()))) == [str(cell) for cell in plain]
