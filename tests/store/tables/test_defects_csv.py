"""Defects as a table: what is not resolved or not measured stays empty."""

from __future__ import annotations

import csv
import io

from tests.support.datasets.inspections import defect, inspection
from wafer_viewer.store.tables.csv_tables import DEFECT_COLUMNS, defects_csv


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
