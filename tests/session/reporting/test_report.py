"""Reports: what stands on them, that they stand alone, and that the same dataset makes the same bytes."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.datasets.grid_dataset import RESULT
from tests.support.datasets.samples import CALIBRATION, make_job, make_plan
from tests.support.surfaces import height_map
from wafer_viewer.cli.app import main
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.job import FeatureVerdict, Judgement, Notebook, WaferVerdict
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.report import PARTS, Figure, Holds, Report, ReportOrder, ReportSection, zone_of
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.core.dataset_library import save_summary, summarise
from wafer_viewer.session.reporting import report, report_data, sections
from wafer_viewer.session.reporting.report import contents, gather, make_report, report_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic
from wafer_viewer.store.records.conformance_reports import report_html
from wafer_viewer.store.records.inspection_records import write_notebook

UPPER, LOWER = Region.rectangle(-60, -30, -20, 30), Region.rectangle(20, -30, 60, 30)


def surface() -> HeightMap:
    """A step of 12 um in the middle, with a hole in it."""
    x = np.mgrid[:240, :320][1]
    z = (np.where(x < 160, 12.0, 0.0) + np.random.default_rng(2).normal(0, 0.05, x.shape)).astype(np.float32)
    z[20:60, 20:60] = np.nan
    return height_map(z, 0.5, -79.75, 59.75, grey=120)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    """A stitched dataset with a judged result; its names are not kind to HTML."""
    path = tmp_path_factory.mktemp("data") / "die & street.wafer"
    path.mkdir()
    (path / JOURNAL).touch()
    job = replace(make_job(), sample=Sample(name="<script>alert(1)</script>", lot="L7", wafer_id="W3"))
    record = ScanRecord(
        software_version="1", taken="2026-03-01T10:00:00", simulated=True, calibration=CALIBRATION, job=job,
        plan=make_plan(job),
    )  # fmt: skip
    write_record(path, record)
    result, made = Dataset.open(path).result(RESULT), surface()
    write_mosaic(result.mosaic_path, made)
    save_summary(result, summarise(result.mosaic(), 2, RESULT))
    step = replace(step_height(made, UPPER, LOWER), name="Die <b>", number=1)
    result.save_findings(MeasurementResults(items=(step,)))
    write_notebook(result.path, Notebook(judgements=(Judgement(key="result 1", verdict="accepted", note="a burr"),)))
    return path


def test_the_same_dataset_makes_the_same_bytes_on_the_command_line_too(dataset, tmp_path, capsys):
    first = make_report(dataset, RESULT, ReportOrder(), tmp_path / "one.html")
    assert main(["report", str(dataset), "-o", str(tmp_path / "two.html")]) == 0
    assert first.read_bytes() == (tmp_path / "two.html").read_bytes()
    assert "two.html" in capsys.readouterr().out


def test_progress_is_reported_by_section_and_a_stopped_report_leaves_nothing(dataset, tmp_path):
    reported: list[float] = []
    out = tmp_path / "whole.html"
    assert make_report(dataset, RESULT, ReportOrder(), out, progress=reported.append, should_stop=lambda: False) == out
    assert reported == sorted(reported)
    assert len(reported) >= 8
    assert reported[-1] == 1.0
    reported.clear()
    with pytest.raises(ComputeError, match="The report was stopped"):
        make_report(
            dataset, RESULT, ReportOrder(), tmp_path / "half.html",
            progress=reported.append, should_stop=lambda: len(reported) >= 3,
        )  # fmt: skip
    assert len(reported) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["whole.html"]


def test_a_report_is_self_contained_and_has_no_scripts(dataset):
    text = report_html(report_of(dataset, RESULT, ReportOrder()))
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)" in text
    assert re.findall(r'(?:src|href)="(?!data:image/jpeg;base64,)', text) == []
    assert "http" not in text.replace("http-equiv", "")


def test_the_report_contains_measurements_and_judgements(dataset):
    report = report_of(dataset, RESULT, ReportOrder(parts=("results",)))
    ((number, name, kind, value, place, thought),) = report.sections[0].table.rows
    assert (number, name, place, thought) == ("1", "Die <b>", "x\u202f0.0, y\u202f0.0\u202fµm", "accepted · a burr")
    assert kind == "Step height, measured heights"
    assert value.startswith("12.0")
    (sheet,) = report.sections[0].sheets
    assert (sheet.number, sheet.title, sheet.value) == ("1", "Die <b>", value)
    assert sheet.picture.count("data:image/jpeg") == 1
    assert sheet.budget is None, "without a calibration there is none"
    assert ("Lot", "L7") in report.facts
    assert report.simulated


def a_verdict() -> WaferVerdict:
    feature = Feature(name="die", nominal=12.0, lower_limit=11.0, upper_limit=13.0)
    measured = Quantity(value=12.01, unit="um")
    judged = FeatureVerdict(feature=feature, measured=measured, word="inconclusive", why="No uncertainty.")
    return WaferVerdict(word="inconclusive", next="Calibrate.", items=(judged,), job="Coupon B")


def test_the_verdict_on_a_wafer_and_its_features_stand_first(dataset):
    noted = Notebook(judgements=(Judgement(key="feature die", verdict="accepted", note="measured by hand"),))
    material = dataclasses.replace(gather(dataset, RESULT), verdict=a_verdict(), notebook=noted)
    reported = sections.verdict(material)
    (row,) = reported.table.rows
    assert row[:3] == ("F1", "die", "11 to 13\u202fµm, guard band")
    assert row[-2:] == ("INCONCLUSIVE", "accepted · measured by hand")
    assert (reported.word, reported.beside) == ("inconclusive", "Coupon B · Calibrate.")
    assert reported.sentences[0] == "0 of 1 feature conforms to the limits given."
    assert reported.sentences[1].endswith("U (about 95 %) is taken off every limit (ISO 14253-1).")
    assert reported.sentences[2:] == ("die: No uncertainty.",)
    assert "<svg" in reported.table.drawn[0]
    assert ("Verdict", "INCONCLUSIVE, Coupon B") in report._facts(material, ReportOrder())
    assert gather(dataset, RESULT).verdict is None


def test_each_decision_rule_names_its_features():
    (item,) = a_verdict().items
    simple = replace(item, feature=replace(item.feature, decision_rule="simple_acceptance"), word="pass")
    counted, guarded, accepted = sections.conformity(replace(a_verdict(), items=(item, simple)))
    assert counted == "1 of 2 features conform to the limits given."
    assert guarded.startswith("Decision rule of F1: the expanded uncertainty U")
    assert accepted == "Decision rule of F2: a value within its limits conforms, whatever its U (simple acceptance)."


def test_a_report_has_its_number_customer_laboratory_and_scope(dataset):
    lab = dataset.parent / "laboratory.toml"
    lab.write_text('name = "Lab <1>"\naddress = "1 Street"\naccreditation = "D-K-1"\nlogo = "logo.png"\n')
    Image.new("RGBA", (60, 20), (10, 90, 120, 0)).save(dataset.parent / "logo.png")
    try:
        report = report_of(dataset, RESULT, ReportOrder(parts=("plan",), number='7"; } body { x', customer="A Fab"))
        lab.write_text('nam = "x"')
        with pytest.raises(DatasetError, match=r"laboratory.toml: unknown key 'nam'"):
            report_of(dataset, RESULT, ReportOrder(parts=("plan",)))
    finally:
        lab.unlink()
    assert dict(report.facts)["Customer"] == "A Fab"
    assert dict(report.facts)["Method"].startswith("shape from focus (Log-Laplacian)")
    assert (report.letterhead.name, report.letterhead.lines) == ("Lab <1>", ("1 Street", "D-K-1"))
    assert report.letterhead.logo.startswith("data:image/jpeg")
    text = report_html(report)
    assert "The results relate only to the sample and the places named in this report." in text
    assert "Lab &lt;1&gt;" in text
    style = text[text.index("<style>") : text.index("</style>")]
    assert "Report\\20 7\\22 \\3b " in style
    assert "die\\20 \\26 \\20 street" in style
    unnamed = report_of(dataset, RESULT, ReportOrder(parts=("plan",)))
    assert (unnamed.number, unnamed.letterhead) == ("die & street-20260301", None)


@pytest.mark.parametrize(
    ("iso", "zone", "words"),
    [
        ("2026-03-01T10:00:12.345+00:00", "UTC", "2026-03-01 10:00 UTC"),
        ("2026-03-01T10:00:12.345+00:00", "Europe/Berlin", "2026-03-01 11:00 +01:00"),
        ("2026-07-01T23:30:00+00:00", "Europe/Berlin", "2026-07-02 01:30 +02:00"),
        ("2026-03-01T10:00:00", "Europe/Berlin", "2026-03-01 10:00"),
        ("2026-03-01", "Europe/Berlin", "2026-03-01"),
        ("some day in March", "UTC", "some day in March"),
    ],
)
def test_times_are_written_in_the_zone_of_the_laboratory_to_the_minute(iso, zone, words):
    assert report_data.time_words(iso, zone_of(zone)) == words


def test_an_unknown_time_zone_is_refused_with_the_file_that_names_it(tmp_path):
    (tmp_path / "laboratory.toml").write_text('name = "Lab"\nzone = "Europe/Nowhere"\n')
    with pytest.raises(DatasetError, match=r"laboratory.toml: .*'Europe/Nowhere': it must be the name of a time zone"):
        report_data.laboratory_of(tmp_path)


def test_every_page_names_the_content_by_its_checksum(dataset):
    one, other = (
        re.search('Content ([0-9a-f]{4}(?: [0-9a-f]{4}){3})"', report_html(report_of(dataset, RESULT, order)))[1]
        for order in (ReportOrder(parts=("plan",)), ReportOrder(parts=("plan",), customer="A Fab"))
    )
    assert one != other


def test_all_that_restricts_the_numbers_is_among_the_warnings(dataset):
    material = gather(dataset, RESULT)
    doubtful = dataclasses.replace(material, audit_fault="The audit log cannot be relied on: it was altered.")
    sentences = report._warnings(doubtful).sentences
    assert sentences[0] == "The frames are simulated: nothing was measured on a real sample."
    assert "The audit log cannot be relied on: it was altered." in sentences
    missing = next(text for text in sentences if "of the surface is not measured" in text)
    assert missing.startswith("2.1\u202f% of the surface is not measured: 2.1\u202f% no texture")


def test_a_report_is_a_page_or_a_pdf_by_its_ending(dataset, tmp_path, monkeypatch):
    with pytest.raises(DatasetError, match=r"r.docx is no name of a report: give NAME.html or NAME.pdf"):
        make_report(dataset, RESULT, ReportOrder(), tmp_path / "r.docx")
    monkeypatch.setattr("wafer_viewer.store.records.printed_report.BROWSERS", ("no-such-browser",))
    with pytest.raises(DatasetError, match=r"none is found: install one, or write r.html and print that"):
        make_report(dataset, RESULT, ReportOrder(), tmp_path / "r.pdf")
    assert list(tmp_path.iterdir()) == []


def test_simulated_stands_only_where_it_is_true(dataset):
    report = report_of(dataset, RESULT, ReportOrder(parts=("plan",)))
    real = Report(report.title, report.below, False, report.facts, report.sections)
    assert "SIMULATED" in report_html(report)
    assert "SIMULATED" not in report_html(real)


def test_only_what_was_ordered_goes_in_and_in_that_order(dataset):
    report = report_of(dataset, RESULT, ReportOrder(title="Lot 7", parts=("calibration", "results")))
    assert report.title == "Lot 7"
    assert [section.title for section in report.sections] == ["Traceability", "Results"]


def test_whether_lengths_are_calibrated_is_asked_of_the_day_of_the_scan(dataset):
    calibration = report_of(dataset, RESULT, ReportOrder(parts=("calibration",))).sections[0]
    assert calibration.sentences == ()  # due in 2027, and today may be later
    assert dict(calibration.pairs)["z scale"] == "1.0100 ± 0.0010 (k = 2)"


def test_pictures_at_print_size_go_in_where_there_are_some(dataset):
    order = ReportOrder(parts=("pictures",))
    assert report_of(dataset, RESULT, order).sections == ()
    taken = dataset.with_name(f"{dataset.stem}-picture-1.png")
    Image.new("RGB", (3000, 1000), (10, 90, 120)).save(taken)
    figures = report_of(dataset, RESULT, order).sections[0].figures
    taken.unlink()
    assert [figure.caption for figure in figures] == [taken.stem]
    assert len(figures[0].url) < 60_000


def test_every_part_says_beforehand_what_it_would_hold(dataset):
    message = contents(dataset, RESULT)
    assert set(message) == set(PARTS)
    assert message["results"] == Holds("1 result, 1 judged")
    assert message["surface"] == Holds("320 × 240 points")
    assert message["pictures"] == Holds("no pictures yet: key P takes one", nothing=True)


def test_a_part_without_anything_says_so_and_features_count_as_what_they_are(dataset, monkeypatch):
    material = dataclasses.replace(gather(dataset, RESULT), findings=(), info=None)
    monkeypatch.setattr(report, "gather", lambda *_: material)
    message = contents(dataset, RESULT)
    assert {part for part, holds in message.items() if holds.nothing} == {
        *("verdict", "features", "results", "defects", "dies", "gauge", "pictures", "surface", "audit")
    }
    assert (message["results"].words, message["surface"].words) == ("no results yet", "not stitched yet")
    rejected = Notebook(judgements=(Judgement(key="feature die", verdict="rejected"),))
    material = dataclasses.replace(material, verdict=a_verdict(), notebook=rejected)
    assert contents(dataset, RESULT)["verdict"] == Holds("INCONCLUSIVE, 1 feature, 1 judged")


def test_an_empty_section_is_marked_empty():
    empty = ReportSection("Results", empty="No results were kept.")
    shown = ReportSection("Pictures", figures=(Figure("data:image/jpeg;base64,", "One"),))
    text = report_html(Report("a", "b", False, (), (empty, shown)))
    assert "No results were kept." in text
    assert text.count("<figure>") == 1


def test_an_invalid_dataset_is_refused_in_one_sentence(tmp_path, capsys):
    assert main(["report", str(tmp_path), "-o", str(tmp_path / "r.html")]) == 2
    assert "is not a dataset" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
