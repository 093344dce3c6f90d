"""Templates: kept results repeated on other surfaces, one table as CSV and Excel, lines that fail are told."""

from __future__ import annotations

import csv

import numpy as np
import openpyxl
import pytest

import wafer_viewer as wv
from tests.support.surfaces import height_map
from wafer_viewer import Region
from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.measurement.template import MeasurementTemplate, TemplateItem
from wafer_viewer.model.measurement.tool_options import Levelling, TextureOptions
from wafer_viewer.model.measurement.tools import ToolOptions
from wafer_viewer.store.formats.conversion import write_surface

TEXTURE = TextureOptions(s_filter_um=3.0, spikes="remove")
TEMPLATE = MeasurementTemplate(
    places_from="corner",
    measurements=(
        TemplateItem(
            name="=step", tool="step", places=(Region.rectangle(5, 5, 35, 45), Region.rectangle(45, 5, 75, 45))
        ),
        TemplateItem(
            name="face",
            tool="texture",
            places=(Region.rectangle(5, 5, 35, 45).without(Region.circle(20, 25, 8)),),
            options=ToolOptions(texture=TEXTURE),
            levelling=Levelling(by="plane"),
        ),
    ),
)


def write_part(path, seed, height_um, at_um=0.0):
    """Write a step of 80 x 50 um, its lower left pixel at (at, at)."""
    z_um = np.random.default_rng(seed).normal(0, 0.05, (100, 160))
    z_um[:, :80] += height_um
    write_surface(height_map(z_um.astype(np.float32), 0.5, at_um, at_um + 99 * 0.5), path)
    return path


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_part(folder / "a.npz", 1, 10.0)
    write_part(folder / "b.npz", 2, 12.0, at_um=1000.0)
    (folder / "c.npz").write_bytes(b"no surface")
    wv.write_template(TEMPLATE, folder / "t.toml")
    return folder


def test_a_template_reads_back_as_it_was_written(parts):
    assert wv.read_template(parts / "t.toml") == TEMPLATE
    assert "groove" not in (parts / "t.toml").read_text()


def test_one_table_has_a_line_for_each_part_with_its_u(parts, capsys):
    table = parts / "all.xlsx"
    assert main(["measure", "apply", str(parts / "t.toml"), str(parts / "*.npz"), "--table", str(table)]) == 1
    assert "2 measured, 1 failed" in capsys.readouterr().out
    heads, *lines = openpyxl.load_workbook(table).active.values
    first, second, broken = (dict(zip(heads, line, strict=True)) for line in lines)
    assert first["=step height, um"] == pytest.approx(10.0, abs=0.05)
    assert second["=step height, um"] == pytest.approx(12.0, abs=0.05)
    assert "face sq, um" in heads
    assert "U of face sq, um" in heads
    assert (broken["status"], broken["=step height, um"]) == ("failed", None)
    assert "c.npz" in broken["message"]
    with table.with_suffix(".csv").open(newline="") as file:
        texts = list(csv.DictReader(file))
    assert float(texts[0]["'=step height, um"]) == first["=step height, um"]


def test_no_cell_of_the_workbook_is_a_formula(parts):
    table = parts / "again.xlsx"
    wv.apply_template(TEMPLATE, [parts / "a.npz"], table)
    sheet = openpyxl.load_workbook(table).active
    assert {cell.data_type for row in sheet.rows for cell in row} <= {"s", "n"}


def test_without_openpyxl_nothing_is_measured_for_a_workbook(parts, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    told = []
    with pytest.raises(DatasetError, match=r"pip install 'wafer-viewer\[tables\]', or choose .csv"):
        wv.apply_template(TEMPLATE, [parts / "a.npz"], parts / "none.xlsx", told=told.append)
    assert not told


def test_a_second_run_goes_on_with_what_is_new_and_makes_the_same_cells(parts):
    table = parts / "on.xlsx"
    report = wv.apply_template(TEMPLATE, [parts / "a.npz"], table)
    before = list(openpyxl.load_workbook(table).active.values)
    assert (report.done, report.kept) == (1, 0)
    report = wv.apply_template(TEMPLATE, [parts / "a.npz", parts / "b.npz"], table)
    assert (report.done, report.kept) == (1, 1)
    assert list(openpyxl.load_workbook(table).active.values)[:2] == before


def test_a_measurement_without_a_result_leaves_its_columns_empty_and_says_why(parts):
    beyond = TemplateItem(name="far", tool="point", places=(Region.point(900, 900),))
    template = MeasurementTemplate(places_from="corner", measurements=(*TEMPLATE.measurements, beyond))
    (row,) = wv.apply_template(template, [parts / "a.npz"]).rows
    assert row["status"] == "done"
    assert row["message"].startswith("far: ")
    assert not [column for column in row if column.startswith("far")]


def test_a_wrong_template_is_refused_with_its_place(parts):
    text = (parts / "t.toml").read_text()
    (parts / "wrong.toml").write_text(text.replace('tool = "step"', 'tool = "stepp"'))
    with pytest.raises(MeasureError, match=r"wrong.toml: .*tool is 'stepp': it must be one of 'profile'"):
        wv.read_template(parts / "wrong.toml")
    (parts / "few.toml").write_text('[[measurements]]\nname = "a"\ntool = "step"\nplaces = []\n')
    with pytest.raises(MeasureError, match=r"measured at upper \(rectangle\), lower \(rectangle\): give as many"):
        wv.read_template(parts / "few.toml")
