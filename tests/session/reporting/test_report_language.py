"""Reports in German: every text is translated, numbers have a decimal comma, and names stay as they are."""

from __future__ import annotations

import re
import typing

import pytest

from tests.session.reporting.test_report_contents import RESULT
from tests.session.reporting.test_report_contents import dataset as dataset
from tests.support.gauge_repeats import signed
from wafer_viewer.cli.app import main
from wafer_viewer.draw.quantities import setting_text, settings_text
from wafer_viewer.measure.base import measurement_context
from wafer_viewer.measure.tools import site_range
from wafer_viewer.model.measurement.result_rows import labels_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.report import PART_TITLES, ReportOrder
from wafer_viewer.model.spec import replace, settings_of
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import LAYER_TITLES, ORIGIN_TITLES
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.reporting.report import report_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.conformance_reports import report_html
from wafer_viewer.store.records.report_language import Translation

GERMAN = ReportOrder(language="de")
RECIPE_CHOICES = {
    setting_text(field, value)
    for path, field in settings_of(Recipe).items()
    for value in field.setting.titles
    if path != "focus_measure"
}


@pytest.fixture(scope="module")
def report(dataset):
    return report_of(dataset, RESULT, GERMAN)


@pytest.mark.slow
def test_no_text_of_a_report_of_everything_is_left_in_english(report):
    translation = Translation("de", report.names)
    translation.of(report)
    assert sorted(translation.unknown) == []


@pytest.mark.parametrize(
    "texts",
    [
        PART_TITLES.values(),
        ORIGIN_TITLES.values(),
        LAYER_TITLES.values(),
        (tool.title for tool in TOOLS.values()),
        (label.title for tool in TOOLS.values() for label in labels_of(tool.result).values() if label.listed),
        (field.setting.title for field in settings_of(Recipe).values()),
        RECIPE_CHOICES,
        (measure.description for measure in focus_measures().values()),
        (text for name, text in vars(measurement_context).items() if name.isupper() and isinstance(text, str)),
    ],
)
def test_every_title_has_a_translation(texts):
    translation = Translation("de")
    for text in texts:
        translation.text(text)
    assert sorted(translation.unknown) == []


def choices_of(kind):
    """Return the choices of the fields of a struct as the report words them."""
    hints = typing.get_type_hints(kind)
    for name in kind.__struct_fields__:
        for hint in (hints[name], *typing.get_args(hints[name])):
            if typing.get_origin(hint) is typing.Literal and labels_of(kind)[name].listed:
                yield from (value.replace("_", " ") for value in typing.get_args(hint) if isinstance(value, str))


def test_every_choice_of_a_tool_and_its_results_has_a_translation():
    kinds = [kind for tool in TOOLS.values() for kind in (tool.options, tool.result) if kind is not None]
    translation = Translation("de")
    for kind in kinds:
        for text in choices_of(kind):
            translation.text(text)
    for kind in filter(None, (tool.options for tool in TOOLS.values())):
        translation.text(settings_text(kind()))
    assert sorted(translation.unknown) == []


def test_every_note_on_sites_has_a_translation():
    translation = Translation("de")
    notes = (site_range.AS_MOUNTED, site_range.NO_OTHER, site_range.NOISE_WIDENS, site_range.LARGEST_ALONE)
    for text in (*notes, *site_range._left_out(1), *site_range._left_out(3)):
        translation.text(text)
    assert sorted(translation.unknown) == []


@pytest.mark.slow
def test_a_name_that_is_a_word_of_the_report_stays_as_it_is(dataset):
    result = Dataset.open(dataset).result(RESULT)
    before = result.findings()
    first, *others = before.items
    result.save_findings(replace(before, items=(replace(first, name="Surface"), *others)))
    text = report_html(report_of(dataset, RESULT, GERMAN))
    result.save_findings(before)
    assert "</span>Surface<b>" in text
    assert "<h2>Oberfläche</h2>" in text


def test_numbers_have_a_decimal_comma_and_versions_dates_and_checksums_do_not(report):
    text = report_html(report)
    assert 'lang="de"' in text
    words = re.sub(r"<style>.*?</style>|<svg.*?</svg>|data:[^\"]*", "", text, flags=re.DOTALL)
    left = re.findall(r"[^<>]*\d\.\d[^<>]*", words)
    assert all("Wafer Viewer" in part for part in left), left
    assert "12,3" in words
    assert re.search(r"<text[^>]*>\d+,\d+</text>", text), "axes of charts as well"


@pytest.mark.slow
def test_values_are_the_same_in_both_languages(dataset, report):
    english, german = report_html(report_of(dataset, RESULT, ReportOrder())), report_html(report)
    values = [re.findall(r"<b>([^<]*\d±?[^<]*)</b>", text) for text in (english, german)]
    assert [value.replace(",", ".").split("\u202f")[0] for value in values[1]] == [
        value.split("\u202f")[0] for value in values[0]
    ]


@pytest.mark.slow
def test_the_laboratory_sets_the_language_and_the_command_line_another(dataset, tmp_path):
    laboratory = dataset.parent / "laboratory.toml"
    laboratory.write_text('name = "Labor"\nlanguage = "de"\nzone = "Europe/Berlin"\n')
    try:
        for name, words in (("de.html", ()), ("en.html", ("--language", "en"))):
            assert main(["report", str(dataset), "-o", str(tmp_path / name), *words]) == 0
    finally:
        laboratory.unlink()
    assert "<h2>Urteil</h2>" in (tmp_path / "de.html").read_text()
    assert "<h2>Verdict</h2>" in (tmp_path / "en.html").read_text()


def test_a_gauge_check_is_translated_and_its_certificate_is_not(dataset):
    result = Dataset.open(dataset).result(RESULT)
    before = result.findings()
    result.save_findings(
        replace(before, items=(replace(signed("2026-03-02", 400.1, 400.05), number=1, name="Blocks"),))
    )
    report = report_of(dataset, RESULT, replace(GERMAN, parts=("results", "gauge")))
    result.save_findings(before)
    translation = Translation("de", report.names)
    (sentence,) = translation.of(report).sections[-1].sentences
    assert "Zertifikat C1 von Lab, Endmaße A1, A2, bis 2026-12-31" in sentence
    assert sorted(translation.unknown) == []
