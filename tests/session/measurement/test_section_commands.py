from __future__ import annotations

import dataclasses
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.datasets.grid_dataset import RESULT, make_dataset
from tests.support.surfaces import coordinates, surface_of
from wafer_viewer.model.acquisition.plan import FieldGrid
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.measurement.sections import OtherSurface, SectionRequest
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.session.measurement.dataset_queries import Measuring, Sections
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

LINE = Region.line(-15, 0, 15, 0)
FIELDS = FieldGrid(rows=1, cols=1, field_width_um=40, field_height_um=30).centred_on(0, 0).fields()


def tilted(offset_um: float = 0.0, shift_um: float = 0.0):
    """z = 0.1 x + offset; its raw heights are a micrometre higher, and 2 of 80 columns have none."""
    x_um, _ = np.meshgrid(*coordinates(60, 80))
    z = 0.1 * x_um + offset_um
    raw = z + 1.0
    raw[:, 40:42] = np.nan
    made = surface_of(z, raw, np.where(np.isfinite(raw), 0, 1).astype(np.uint8))
    return dataclasses.replace(made, x0_um=made.x0_um + shift_um)


def a_dataset(folder, name, surface):
    made = SimpleNamespace(fields=FIELDS, heights=[surface])
    path = make_dataset(folder / f"{name}.wafer", made)
    write_mosaic_to(path, RESULT, surface)
    return path


def write_mosaic_to(path, result, surface):
    target = Dataset.open(path).result(result).mosaic_path
    target.parent.mkdir(parents=True)
    write_mosaic(target, surface)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    a_dataset(folder, "before", tilted())
    write_mosaic_to(a_dataset(folder, "after", tilted(5.0)), "again", tilted(7.0))
    a_dataset(folder, "far", tilted(0.0, 900.0))
    return folder


@pytest.fixture
def sections(folder):
    """Those of `before`, which is open."""
    shown = Dataset.open(folder / "before.wafer")
    now = SimpleNamespace(
        dataset=SimpleNamespace(path=shown.path, name="before", calibration_problem=None, stamps={}),
        surface=SimpleNamespace(result=RESULT, stamp=1),
        datasets=[SimpleNamespace(path=path) for path in sorted(folder.glob("*.wafer"))],
    )

    def surface(show):
        return shown.result(RESULT).mosaic()

    return Sections(SimpleNamespace(surface_source=surface, measuring=Measuring(surface, lambda: now)), lambda: now)


def other(folder, name, result=RESULT):
    return OtherSurface(str(folder / f"{name}.wafer"), result)


@pytest.mark.slow
def test_the_same_line_on_raw_and_cleaned_heights(sections):
    requested = SectionRequest(1, LINE)
    raw, cleaned = (sections.section(dataclasses.replace(requested, cleaned=which)) for which in (False, True))
    assert (raw.title, cleaned.title) == ("B", "B filtered and filled heights")
    assert np.isnan(raw.curve.z_um).any()
    np.testing.assert_allclose((raw.curve.z_um - cleaned.curve.z_um)[np.isfinite(raw.curve.z_um)], 1.0, atol=0.03)
    assert raw.source == "before"


def test_the_same_line_on_another_dataset(sections, folder):
    here = sections.section(SectionRequest(0, LINE))
    present = sections.section(SectionRequest(0, LINE, of=other(folder, "after")))
    assert present.title == "A after"
    given = np.isfinite(here.curve.z_um)
    np.testing.assert_allclose((present.curve.z_um - here.curve.z_um)[given], 5.0, atol=1e-5)


def test_each_surface_is_levelled_on_its_own_plane(sections, folder):
    level = Levelling(by="plane")
    for of in (None, other(folder, "after")):
        found = sections.section(SectionRequest(0, LINE, levelling=level, of=of))
        np.testing.assert_allclose(found.curve.z_um[np.isfinite(found.curve.z_um)], 0.0, atol=1e-3)


def test_every_stitched_surface_but_the_one_looked_at_is_offered(sections):
    assert [o.title for o in sections.others()] == ["after · again", "after", "far"]


def test_where_they_do_not_overlap_the_other_is_named(sections, folder):
    with pytest.raises(MeasureError, match=r"^far has no heights along line A. The line from"):
        sections.section(SectionRequest(0, LINE, of=other(folder, "far")))


def test_a_dataset_that_is_gone_is_one_sentence(sections, folder, tmp_path):
    path = a_dataset(tmp_path, "gone", tilted())
    shutil.rmtree(path)
    with pytest.raises(DatasetError):
        sections.section(SectionRequest(0, LINE, of=other(tmp_path, "gone")))


@pytest.mark.slow
def test_the_files_are_those_of_their_endings(sections):
    found = [sections.section(SectionRequest(0, LINE))]
    assert sections.file(found, ".csv").startswith(b"# Wafer Viewer")
    assert sections.file(found, ".png").startswith(b"\x89PNG")
    assert sections.file(found, ".PDF").startswith(b"%PDF")
    assert b"<svg" in sections.file(found, ".svg")
    with pytest.raises(DatasetError, match=r"use \.csv, \.png, \.pdf or \.svg"):
        sections.file(found, ".xls")
