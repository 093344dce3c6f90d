from __future__ import annotations

import pytest

from tests.support.datasets.samples import assert_same_surface, make_job, make_plan, make_surface
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.measurement.measurements import Length, Profile
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.recipe import Levy, Recipe
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic


@pytest.fixture
def data(tmp_path):
    job = make_job()
    DatasetWriter.create(tmp_path / "a.wafer", make_plan(job), job).close()
    return Dataset.open(tmp_path / "a.wafer")


def test_a_second_recipe_makes_a_second_result(data):
    assert data.results() == ()
    for name, recipe in (("default", Recipe()), ("smooth", Recipe(levy=Levy(mode="guided")))):
        data.result(name).save_recipe(recipe)
    assert data.results() == ("default", "smooth")
    assert data.result("smooth").recipe().levy.mode == "guided"
    assert data.result().recipe() == Recipe()


def test_what_auto_chose_is_kept_for_the_scan_until_the_recipe_changes(data):
    result = data.result()
    result.save_recipe(Recipe())
    assert result.settled() is None
    result.save_settled(Recipe(window=9))
    result.save_recipe(Recipe())
    assert result.settled() == Recipe(window=9)
    result.save_recipe(Recipe(focus_measure="sml"))
    assert result.settled() is None


def test_surfaces_are_kept_by_field(data):
    result, surface = data.result(), make_surface(simulated=True)
    assert result.surfaces_done(data.fields) == set()
    with pytest.raises(DatasetError, match="'default' has no surface of field 2: reconstruct it first"):
        result.surface(data.field(2))
    result.save_surface(data.field(2), make_surface(seed=2))
    result.save_surface(data.field(2), surface)
    assert result.surfaces_done(data.fields) == {2}
    assert_same_surface(result.surface(data.field(2)), surface)
    assert [p.name for p in (result.path / "surfaces").iterdir()] == ["r0000c0001.npz"]


def test_the_mosaic_lies_next_to_them(data):
    result = data.result()
    with pytest.raises(DatasetError, match="has no stitched surface"):
        result.mosaic()
    result.save_recipe(Recipe())
    write_mosaic(result.mosaic_path, make_surface())
    assert result.mosaic().shape == (30, 40)


def test_findings_are_kept_with_their_uncertainty(data):
    line = Region.line(0, 0, 5, 0)
    bare = Length(value_um=1.0, status="uncalibrated")
    found = MeasurementResults(
        items=(Profile(line=line, length_um=5.0, pt=bare, rise=bare, measured_fraction=1.0, number=1),)
    )
    assert data.result().findings() == MeasurementResults()
    data.result().save_findings(found)
    assert data.result().findings() == found


def test_damaged_findings_are_named(data):
    data.result().save_findings(MeasurementResults())
    (data.result().path / "findings.json").write_text("{")
    with pytest.raises(Exception, match=r"findings.json: "):
        data.result().findings()


@pytest.mark.parametrize("name", ["", "../out", "a/b", ".hidden"])
def test_a_result_is_not_called_like_a_path(data, name):
    with pytest.raises(DatasetError, match="A result cannot be called"):
        data.result(name)
