"""A measuring tool of another package, the one of the documentation, is found wherever there are tools."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest

from tests.support.paths import ROOT
from tests.support.plugin_packages import run_with, write_package
from tests.support.surfaces import surface_of
from wafer_viewer.store.formats.npz_file import write_npz

EVERYWHERE = """
import msgspec
from wafer_viewer.cli.app import commands
from wafer_viewer.gui.steps.measure import measure_step
from wafer_viewer.gui.presenters.measurement import card, symbol
from wafer_viewer.gui.presenters.measurement import source
from wafer_viewer.gui.tools.initial_regions import INITIAL_REGIONS
from wafer_viewer.gui.tools.tool_palette import tool_cards, tool_strip
from wafer_viewer.measure.registry import measured
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.measurement.tools import TOOLS, ToolOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.session.measurement.results import default_name
from wafer_viewer.store.formats.conversion import read_surface
from wafer_viewer.store.tables.csv_tables import findings_csv
from median_height import MedianHeight, MedianHeightOptions

tool = TOOLS["median_height"]
surface = read_surface({surface!r})
place = Region.rectangle(-20, -20, 20, 20)
options = ToolOptions(median_height=MedianHeightOptions(over_um=2.0))
found = replace(measured(surface, "median_height", (place,), True, options), number=3, name="Median 1")
kept = MeasurementResults(items=(found,))
feature = Feature(name="top", tool="median_height", upper_limit=4.0, places=(place,), options=options)
print(msgspec.json.encode(dict(
    command="measure median-height" in commands(),
    placed=tool.initial in INITIAL_REGIONS,
    card="Median height" in tool_cards() and "Median" in tool_strip("median_height", True),
    answer=str(card(found, tool.title)),
    symbol=symbol(found),
    source=str(source(found)),
    name=default_name(found),
    height_um=found.main.value,
    read_back=decode(encode(kept, "json"), MeasurementResults, "findings.json", "json") == kept,
    feature=decode(encode(feature, "toml"), Feature, "a feature") == feature,
    table=findings_csv(kept),
)).decode())
"""


@pytest.fixture
def package(tmp_path):
    source = (ROOT / "assets/examples/09_measuring_tool.py").read_text()
    return write_package(tmp_path / "site", "median_height", source, {"measuring_tools": "mh = median_height:TOOL"})


@pytest.fixture
def surface(tmp_path):
    path = tmp_path / "plate.npz"
    write_npz(surface_of(np.full((150, 150), 5.0)), path)
    return path


@pytest.mark.slow
def test_tables_page_jobs_and_files_have_it(package, surface):
    done = run_with(package, "-c", EVERYWHERE.format(surface=str(surface)))
    reported = json.loads(done.stdout)
    assert reported["command"]
    assert reported["placed"]
    assert reported["card"]
    assert reported["read_back"]
    assert reported["feature"]
    assert reported["height_um"] == pytest.approx(3.0, abs=1e-5)
    assert "Median height" in reported["answer"]
    assert "3.00" in reported["answer"]
    assert reported["symbol"] == "M3"
    assert reported["name"] == "Median"
    assert "Points" in reported["source"]
    rows = list(csv.DictReader(io.StringIO(reported["table"])))
    (height,) = (row for row in rows if row["quantity"] == "height")
    assert float(height["value"]) == pytest.approx(3.0, abs=1e-5)


@pytest.mark.slow
def test_its_command_measures_and_explains_its_flags(package, surface):
    flags = ("-m", "wafer_viewer", "measure", "median-height", str(surface), "--region", "-20", "-20", "20", "20")
    found = json.loads(run_with(package, *flags, "--over-um", "1").stdout)
    assert found["type"] == "median_height"
    assert np.isclose(found["height"]["value_um"], 4.0)
    reported = run_with(package, *flags[:4], "--help").stdout
    assert "Two opposite corners" in reported
    assert "counts as zero" in reported


@pytest.mark.slow
def test_without_its_package_there_is_no_such_tool(package, surface):
    done = run_with(package.parent, "-m", "wafer_viewer", "measure", "median-height", str(surface), check=False)
    assert done.returncode == 2
    assert "median-height" in done.stderr or "needs a subcommand" in done.stderr
