"""Defects as a table: what is not resolved or not measured stays empty."""

from __future__ import annotations

import csv
import io

from tests.support.datasets.inspections import defect, inspection, lying
from wafer_viewer.store.tables.csv_tables import DEFECT_COLUMNS, defects_csv, dies_csv


def test_each_result_row_has_its_uncertainty_and_judge():
    found = inspection(
        defect(1, "0,0", 100.0, 50.5, judged_kind="pit", judged_by="RB", judged_at="2026-11-22T05:00:00"),
        defect(2, "1,0", 1.0, 2.0, size_resolved=False),
        defect(3, "1,0", 1.0, 2.0, kind="unmeasured"),
    )
    first, second, third = csv.DictReader(io.StringIO(defects_csv(found)))
    assert tuple(first) == DEFECT_COLUMNS
    assert (first["die"], first["u_um"], first["v_um"]) == ("0,0", "100.000", "50.500")
    assert (first["class"], first["class by rules"], first["judged by"]) == ("pit", "particle", "RB")
    assert (first["height_um"], first["U height_um"], first["area_um2"], first["U area_um2"]) == ("6", "0.4", "94", "")
    assert (second["major_um"], second["height_um"], second["size resolved"]) == ("", "6", "no")
    assert (third["height_um"], third["volume_um3"], third["class"]) == ("", "", "unmeasured")


def test_a_clean_wafer_has_the_heads_alone():
    assert defects_csv(inspection()) == ",".join(DEFECT_COLUMNS) + "\n"


def test_every_die_has_a_line_with_its_numbers_and_those_not_measured_are_empty():
    found = inspection(states={"1,1": "missing"}, measured={"0,1": lying(tilt_mrad=-4.0, bow_um=0.9)})
    lines = {line["die"]: line for line in csv.DictReader(io.StringIO(dies_csv(found)))}
    assert len(lines) == 6
    tilted = lines["0,1"]
    assert (tilted["tilt_x_mrad"], tilted["U tilt_x_mrad"], tilted["bow_um"]) == ("-4", "0.2", "0.9")
    assert (tilted["brightness_percent"], tilted["state"]) == ("3.1", "whole")
    assert (lines["1,1"]["state"], lines["1,1"]["tilt_x_mrad"]) == ("missing", "")
