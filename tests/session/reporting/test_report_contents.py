"""A report of everything: verdict over dies, results of every kind with budgets, curves, checksums, signatures."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys

import pytest

from tests.support.datasets.judged_datasets import RESULT, STEP, judged_dataset, released_job
from tests.support.gauge_repeats import signed
from wafer_viewer.cli.app import main
from wafer_viewer.measure.registry import measured
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.measurement.feature import Die, Dies
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.report import PART_TITLES, ReportOrder
from wafer_viewer.model.spec import replace
from wafer_viewer.session.reporting import report as report_module
from wafer_viewer.session.reporting import report_data
from wafer_viewer.session.reporting.report import make_report, report_of
from wafer_viewer.session.reporting.report_data import numbers_of
from wafer_viewer.session.reporting.report_pictures import line_across
from wafer_viewer.store.dataset import integrity
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.integrity import digests_of_result
from wafer_viewer.store.records.conformance_reports import report_html
from wafer_viewer.store.records.report_language import translated

FACE = Region.rectangle(-50, -30, -10, 30)
KINDS = (
    ("step", STEP.places),
    ("profile", (Region.line(-50, 0, 50, 0, 2),)),
    ("flatness", (FACE,)),
    ("texture", (FACE,)),
    ("volume", (FACE,)),
    ("distance", (Region.point(-40, 0), Region.point(40, 0))),
    ("roughness", (Region.line(-50, 5, -5, 5),)),
    ("angle", STEP.places),
    ("point", (Region.point(-30, 0),)),
)
DIES = Dies(
    width_um=50, height_um=28, listed=(Die(name="0,0", x_um=-55, y_um=-30), Die(name="0,<1>", x_um=-55, y_um=2))
)
ON_DIE = replace(
    STEP, per_die=True, places=(Region.rectangle(5, 2, 45, 26), Region.rectangle(65, 2, 105, 26)), upper_limit=12.5
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "coupon.wafer"
    judged_dataset(path, 12.3, released_job(ON_DIE, dies=DIES), operator="K. Adler")
    result = Dataset.open(path).result(RESULT)
    found = [measured(result.mosaic(), tool, places, True) for tool, places in KINDS]
    stored = [replace(finding, number=n, name=f"{KINDS[n - 1][0]} {n}") for n, finding in enumerate(found, 1)]
    result.save_findings(MeasurementResults(items=tuple(stored)))
    return path


@pytest.fixture(scope="module")
def report(dataset):
    return report_of(dataset, RESULT, ReportOrder())


def section(report, title):
    return next(section for section in report.sections if section.title == title)


@pytest.mark.slow
def test_every_result_has_a_sheet_with_all_its_numbers_and_its_budget(report):
    sheets = section(report, "Results").sheets
    assert [sheet.title for sheet in sheets] == [f"{tool} {n}" for n, (tool, _) in enumerate(KINDS, 1)]
    step, _, flat, texture, *_ = sheets
    assert step.budget.heads == ("Contribution", "Type", "Freedom", "u, µm", "of u²")
    assert sum(float(row[4].split()[0]) for row in step.budget.rows[:-2] if "<" not in row[4]) == pytest.approx(
        100, abs=1
    )
    assert dict(flat.pairs)["FLTq"].startswith("0.0")
    assert {"Sq", "Sz", "Ssk"} <= dict(texture.pairs).keys()
    assert all(sheet.picture for sheet in sheets)


def test_numbers_are_given_for_any_kind_of_result_and_the_main_one_once(dataset):
    for finding in Dataset.open(dataset).result(RESULT).findings().items:
        pairs = numbers_of(finding)
        assert pairs, finding.name
        names = [name for name, _ in pairs]
        assert len(set(names)) == len(names)
        assert not any("Region(" in text or "Length(" in text for _, text in pairs)


def test_what_is_not_evaluated_is_reported_with_its_result_and_among_the_warnings(report, dataset):
    missing = [(sheet.number, what) for sheet in section(report, "Results").sheets for what in sheet.missing]
    warned = section(report, "Warnings").sentences
    for number, what in missing:
        assert any(what.rstrip(".") in sentence and number in sentence for sentence in warned)
    assert any(number == "1" for number, _ in missing), "a step says what its budget leaves out"


def test_the_verdict_shows_every_die_with_its_word(report):
    reported = section(report, "Verdict")
    assert reported.word == "pass"
    assert [row[1] for row in reported.table.rows] == ["die over street, die 0,0", "die over street, die 0,<1>"]
    assert reported.figures[0].caption.startswith("2 dies: 2 pass.")
    (sheet,) = section(report, "Features").sheets
    assert (sheet.number, sheet.below) == ("F1", "Step height · 11 to 12.5\u202fµm, guard band")
    assert sheet.word == "PASS"
    assert sheet.picture.startswith("<svg")
    assert sheet.budget.rows[0][0] == "z scale"
    combined, expanded = sheet.budget.rows[-2:]
    assert combined[0] == "combined, k = 1"
    assert expanded[0].startswith("expanded, k = 2")
    k = float(expanded[0].removeprefix("expanded, k = "))
    assert float(expanded[3]) == pytest.approx(k * float(combined[3]), rel=0.1)
    assert "temperature" in sheet.missing
    assert any(
        text.startswith("Not evaluated in U of features F1, F2: ") for text in section(report, "Warnings").sentences
    )
    assert reported.figures[0].svg.count("<g ") == 2
    assert "<1>" not in reported.figures[0].svg


def test_places_of_features_and_results_are_numbered_on_the_map(report):
    (figure,) = section(report, PART_TITLES["surface"]).figures
    assert {"F1", "F2", "1", "2"} <= set(re.findall(r'font-weight="650" fill="#FFFFFF">(\w+)<', figure.svg))
    assert "Height, µm" in figure.svg
    assert "x, y in µm" in figure.svg


@pytest.mark.campaign
def test_places_that_are_not_on_the_map_are_named_in_both_languages(dataset, monkeypatch):
    monkeypatch.setattr(report_data, "MOST_MARKS", 3)
    english, german = (report_of(dataset, RESULT, ReportOrder(language=language)) for language in ("en", "de"))
    (figure,) = section(english, PART_TITLES["surface"]).figures
    assert figure.caption.endswith(
        "Numbers: results; F with a number: features of the job. Not on the map: 2, 3, 4, 5, 6, 7, 8, 9."
    )
    (figure,) = section(translated(german), "Oberfläche").figures
    assert figure.caption.endswith("Nicht auf der Karte: 2, 3, 4, 5, 6, 7, 8, 9.")
    monkeypatch.setattr(report_module, "MOST_NAMED", 2)
    (figure,) = section(translated(report_of(dataset, RESULT, ReportOrder(language="de"))), "Oberfläche").figures
    assert figure.caption.endswith("Nicht auf der Karte: 2, 3 und 6 weitere.")


def test_the_map_follows_its_heading_and_the_numbers_of_the_surface_follow_the_map(report):
    page = report_html(report)
    heading, drawing, numbers = (page.index(text) for text in ("<h2>Surface</h2>", "x, y in µm", "<dt>Highest</dt>"))
    assert heading < drawing < numbers


def test_a_profile_across_its_place_is_drawn_beside_each_result(report):
    sheets = {sheet.title: sheet for sheet in section(report, "Results").sheets}
    assert all(sheet.picture.startswith("<svg") for sheet in sheets.values())
    assert all("Distance along the line, µm" in sheet.profile for sheet in sheets.values())
    assert len(re.findall(r"[\d.]+ [\d.]+", sheets["profile 2"].profile)) > 150
    assert sheets["step 1"].profile.count("<rect") == 2, "both faces are shaded"
    (feature,) = section(report, "Features").sheets
    assert feature.profile.count("<rect") == 2


def test_a_line_crosses_the_places_of_a_result():
    upper, lower = Region.rectangle(-50, -30, -10, 30), Region.rectangle(10, -30, 50, 30)
    line = line_across((upper, lower))
    assert [(round(p.x_um, 6), round(p.y_um, 6)) for p in line.points] == [(-60, 0), (60, 0)]
    assert line_across((Region.line(0, 0, 5, 5, 2),)) == Region.line(0, 0, 5, 5, 2)
    path = Region.polyline((0, 0), (5, 5), (9, 5))
    assert line_across((path,)) == path
    (start, stop) = line_across((Region.point(3, 4),)).points
    assert (start.y_um, stop.y_um) == (4, 4)
    assert start.x_um < 3 < stop.x_um


@pytest.mark.slow
def test_data_is_identified_by_checksums_that_change_with_it(report, dataset, tmp_path, capsys):
    rows = {row[0]: row[2] for row in section(report, PART_TITLES["checksums"]).table.rows}
    assert list(rows) == ["Frames", "Surface", "Results", "Verdict"]
    main(["check", str(dataset)])
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[-5:-1]] == list(rows.values())
    assert all(re.fullmatch("[0-9a-f]{64}", value) for value in rows.values())
    other = shutil.copytree(dataset, tmp_path / "coupon.wafer")
    with (other / "journal.jsonl").open("ab") as journal:
        journal.write(b'{"type":"fault","what":"a knock","time":"2026-03-01T10:00:00"}\n')
    again = section(report_of(other, RESULT, ReportOrder()), PART_TITLES["checksums"]).table.rows
    assert [row[0] for row in again if row[2] != rows[row[0]]] == ["Frames"]


def test_what_is_too_large_to_be_read_is_identified_by_names_and_sizes(dataset, monkeypatch):
    result = Dataset.open(dataset).result(RESULT)
    complete = {digest.what: digest.sha256 for digest in digests_of_result(result)}
    monkeypatch.setattr(integrity, "MOST_BYTES", 10_000)
    large = {digest.what: digest for digest in digests_of_result(result)}
    assert "names and sizes alone, because they are" in large["Surface"].of
    assert large["Surface"].sha256 != complete["Surface"]
    assert large["Verdict"].sha256 == complete["Verdict"]


@pytest.mark.slow
def test_the_same_data_makes_the_same_report_in_another_folder_process_and_time_zone(dataset, tmp_path):
    first = make_report(dataset, RESULT, ReportOrder(), tmp_path / "first.html")
    copy = shutil.copytree(dataset, tmp_path / "elsewhere" / dataset.name)
    words = (sys.executable, "-m", "wafer_viewer", "report", str(copy), "-o", str(tmp_path / "second.html"))
    zone = {**os.environ, "TZ": "Pacific/Kiritimati", "PYTHONHASHSEED": "7"}
    subprocess.run(words, check=True, env=zone, capture_output=True)
    assert first.read_bytes() == (tmp_path / "second.html").read_bytes()


def test_the_report_is_self_contained_and_has_a_signature_line(report):
    text = report_html(report)
    assert re.findall(r'(?:src|href)="(?!data:image/jpeg;base64,)', text) == []
    assert "Approved by: name, date, signature" in text
    assert "<1>" not in text
    assert text.count("<article") == len(KINDS) + 1, "a sheet of each result and of the feature"


def test_heights_over_a_levelled_zero_are_cut_again_from_it(dataset):
    result = Dataset.open(dataset).result(RESULT)
    before = result.findings()
    line = replace(before.items[1], levelling=Levelling(by="region", places=(FACE,)))
    result.save_findings(MeasurementResults(items=(line,)))
    (sheet,) = section(report_of(dataset, RESULT, ReportOrder(parts=("results",))), "Results").sheets
    result.save_findings(before)
    assert "levelled by region" in sheet.below
    assert ">\u221212<" in sheet.profile or ">\u221210<" in sheet.profile, "the other face lies below this zero"


def test_a_gauge_check_among_the_results_stands_in_a_table_with_why_it_was_decided_so(dataset):
    checked = replace(signed("2026-03-02", 400.1, 400.05), number=7, name="Blocks")
    result = Dataset.open(dataset).result(RESULT)
    before = result.findings()
    result.save_findings(MeasurementResults(items=(checked,)))
    report = report_of(dataset, RESULT, ReportOrder(parts=("results", "gauge")))
    result.save_findings(before)
    reported = section(report, "Gauge checks")
    (row,) = reported.table.rows
    assert row[0] == "7"
    assert "blocks A1, A2, to 2026-12-31; signed by Ann, 2026-03-02 12:00 UTC." in reported.sentences[0]
    assert checked.why.replace(" um", "\u202fµm") in reported.sentences[0]
    assert row[-1] == checked.verdict.upper()
    (sheet,) = section(report, "Results").sheets
    assert dict(sheet.pairs)["Repeats"] == "2"
    assert float(dict(sheet.pairs)["En"]) == pytest.approx(checked.en, abs=0.001)
    assert checked.not_evaluated == sheet.missing
