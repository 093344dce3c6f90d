"""A surface file as a dataset: without frames, measured, converted and reported as any other."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.datasets.samples import CALIBRATION, make_surface
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.report import ReportOrder
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.session.files.file_jobs import import_surface
from wafer_viewer.session.reporting.report import contents, report_of
from wafer_viewer.session.surface.focus_evidence import focus_curve
from wafer_viewer.session.surface.headless import file_or_mosaic, measured_surface
from wafer_viewer.session.surface.headless import make_surface as make_again
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.formats.conversion import export


def imported(tmp_path, ending=".x3p", **provenance):
    surface = make_surface(**provenance)
    export(surface, tmp_path / f"part{ending}")
    return surface, import_surface(tmp_path / f"part{ending}", tmp_path / "part.wafer")


def test_a_surface_file_becomes_a_dataset_without_frames(tmp_path):
    surface, path = imported(tmp_path)
    data = Dataset.open(path)
    assert data.finished
    assert data.fields == ()
    assert data.scan.imported_from == "part.x3p"
    assert data.check().ok
    mosaic, calibrated = measured_surface(path, 0, "default")
    assert not calibrated
    np.testing.assert_array_equal(mosaic.window().z_um, surface.z_um)


def test_the_calibration_of_ours_holds_and_simulation_is_reported(tmp_path):
    _, path = imported(tmp_path, calibration=CALIBRATION, simulated=True)
    data = Dataset.open(path)
    assert data.simulated
    assert data.calibration_problem("2026-06-01") is None
    assert data.scan.pixel_um == CALIBRATION.pixel_um


def test_all_layers_of_a_file_that_has_them_are_kept(tmp_path):
    surface, path = imported(tmp_path, ".gwy")
    stored = Dataset.open(path).result().mosaic().window()
    for name in ("z_raw_um", "confidence", "all_in_focus", "origin"):
        np.testing.assert_array_equal(getattr(stored, name), getattr(surface, name))


def test_nothing_is_left_of_an_import_that_is_refused_or_stopped(tmp_path):
    export(make_surface(), tmp_path / "part.x3p")
    with pytest.raises(DatasetError, match="leave --z-unit out"):
        import_surface(tmp_path / "part.x3p", tmp_path / "a.wafer", Reading(z_unit="mm"))
    with pytest.raises(DatasetError, match="was stopped"):
        import_surface(tmp_path / "part.x3p", tmp_path / "a.wafer", should_stop=lambda: True)
    (tmp_path / "a.wafer").mkdir()
    with pytest.raises(DatasetError, match="exists already"):
        import_surface(tmp_path / "part.x3p", tmp_path / "a.wafer")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.wafer", "part.x3p"]


def test_commands_that_need_frames_report_their_absence(tmp_path):
    _, path = imported(tmp_path)
    with pytest.raises(DatasetError, match="is a surface without frames: there is nothing to reconstruct"):
        make_again(path, Recipe(), "default", again=False, tell=lambda _: None, warn=lambda _: None)
    with pytest.raises(DatasetError, match="is a surface without frames: there is no focus curve"):
        focus_curve(path, "default", 0, 105.0, 45.0, None)


def test_its_report_has_neither_plan_nor_recipe(tmp_path):
    _, path = imported(tmp_path)
    held = contents(path, "default")
    assert held["plan"].nothing
    assert held["recipe"].nothing
    titles = [section.title for section in report_of(path, "default", ReportOrder()).sections]
    assert "Surface" in titles
    assert "Plan" not in titles


def test_a_dataset_says_its_units_itself(tmp_path):
    _, path = imported(tmp_path)
    assert file_or_mosaic(path, "default", Reading(), lambda _: None).shape == (30, 40)
    with pytest.raises(DatasetError, match="gives its own units"):
        file_or_mosaic(path, "default", Reading(z_unit="um"), lambda _: None)
