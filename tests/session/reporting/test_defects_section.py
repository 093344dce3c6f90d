"""The defects of a surface in its report: by die, by class, the largest listed; nothing unknown looks clean."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.datasets.inspections import defect, inspection, lying
from tests.support.datasets.judged_datasets import RESULT, judged_dataset, released_job
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe
from wafer_viewer.model.report import ReportOrder, ReportSection
from wafer_viewer.model.spec import replace
from wafer_viewer.session.reporting.report import contents, report_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.conformance_reports import report_html
from wafer_viewer.store.records.inspection_records import write_inspection

ORDER = ReportOrder(parts=("defects",))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data") / "coupon.wafer"
    judged_dataset(path, 12.3, released_job())
    return path


def test_without_an_inspection_there_is_no_such_part(dataset: Path):
    assert report_of(dataset, RESULT, ORDER).sections == ()
    assert contents(dataset, RESULT)["defects"].nothing


def test_it_tells_dies_classes_and_what_is_not_known(dataset: Path):
    found = inspection(
        defect(1, "0,0", 100.0, 50.0, judgement="real", judged_by="RB"),
        defect(2, "0,0", 200.0, 50.0, judged_kind="residue", size_resolved=False),
        defect(3, "2,1", 10.0, 10.0, kind="unmeasured"),
        states={"1,1": "not scanned"},
        notes=("Only the strongest are listed.",),
    )
    write_inspection(Dataset.open(dataset).result(RESULT).path, found)
    report = report_of(dataset, RESULT, ORDER)
    section: ReportSection = report.sections[0]
    assert section.table is not None
    assert [row[:3] for row in section.table.rows] == [("1", "particle", "0,0"), ("2", "residue", "0,0")]
    assert [row[-1] for row in section.table.rows] == ["real RB", ""]
    assert section.table.rows[1][4] == "not resolved"
    assert "Not or only partly scanned, so not clean: 1,1." in section.sentences
    assert section.sentences[-1] == "Only the strongest are listed."
    assert dict(section.pairs)["Limits"] == "none set"
    page = report_html(report)
    assert "Die 0,0: 2 defects" in page
    assert "Die 1,1: not scanned" in page
    assert "stroke-dasharray" in page
    assert contents(dataset, RESULT)["defects"].words == "2 defects, 1 judged"


def test_all_dies_lie_on_one_and_what_repeats_is_reported(dataset: Path):
    on = ("0,0", "1,0", "2,0", "0,1")
    same = [defect(n, die, 300.0 + n, 200.0, kind="pattern") for n, die in enumerate(on, 1)]
    write_inspection(Dataset.open(dataset).result(RESULT).path, inspection(*same, defect(9, "1,1", 700.0, 500.0)))
    report = report_of(dataset, RESULT, ORDER)
    message = " ".join(report.sections[0].sentences)
    assert "Place 1, x 302.5, y 200.0 µm of the die: pattern in 4 of 6 whole dies" in message
    page = report_html(report)
    assert "All dies overlaid, their defects by class. Rings: places that repeat." in page
    assert page.count("<title>Place 1, in 4 of 6 whole dies</title>") == 1
    assert "<title>D9, Particle, die 1,1</title>" in page


def test_the_limits_of_the_recipe_are_held_and_reported(dataset: Path):
    strict = DefectRecipe(limits=DefectLimits(max_per_die=1))
    found = inspection(defect(1, "0,0", 100.0, 50.0), defect(2, "0,0", 200.0, 50.0), recipe=strict)
    write_inspection(Dataset.open(dataset).result(RESULT).path, found)
    section: ReportSection = report_of(dataset, RESULT, ORDER).sections[0]
    assert dict(section.pairs)["Limits"] == "not within. More than 1 defect on 1 die: 0,0."
    write_inspection(Dataset.open(dataset).result(RESULT).path, replace(found, grid=None, dies=(), defects=()))
    section = report_of(dataset, RESULT, ORDER).sections[0]
    assert dict(section.pairs)["Limits"].startswith("no verdict, not all was inspected. No die is known, so nothing")


def test_every_die_is_listed_with_what_was_measured_of_it(dataset: Path):
    folder = Dataset.open(dataset).result(RESULT).path
    write_inspection(folder, inspection())
    order = ReportOrder(parts=("dies",))
    assert report_of(dataset, RESULT, order).sections == ()
    assert contents(dataset, RESULT)["dies"].nothing
    on = {"0,0": lying(1.5), "1,0": lying(-4.0, bow_um=0.4)}
    found = inspection(defect(1, "0,0", 100.0, 50.0), measured=on)
    write_inspection(folder, found)
    (section,) = report_of(dataset, RESULT, order).sections
    assert section.table is not None
    assert [row[:3] for row in section.table.rows] == [
        ("1,0", "0", "−4.00 ± 0.20"),
        ("0,0", "1", "+1.50 ± 0.20"),
    ]
    assert contents(dataset, RESULT)["dies"].words == "2 dies measured"
    german = report_html(report_of(dataset, RESULT, replace(order, language="de")))
    for text in ("<h2>Dies</h2>", "Neigung x, mrad", "bezogen auf die anderen Dies", "−4,00\u00a0±\u00a00,20"):
        assert text in german
