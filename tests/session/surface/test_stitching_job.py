"""A mosaic is brought up to date: from nothing, field by field, after repairs and after a broken-off job."""

from __future__ import annotations

import dataclasses
import os

import numpy as np
import pytest

from tests.support.datasets.grid_dataset import REGISTERED, RESULT, add_surfaces, make_dataset
from tests.truth.field_grid import SMALL, make
from wafer_viewer.compute.task_runner import LocalRunner
from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.session.surface.stitching_inputs import StitchingInputs
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.manifest import MANIFEST

LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin", "overlap_um")


@pytest.fixture(scope="module")
def made():
    return make(SMALL)


@pytest.fixture
def dataset(tmp_path, made):
    return make_dataset(tmp_path / "grid.wafer", made)


@pytest.mark.slow
def test_a_mosaic_from_nothing_shows_every_field_where_it_truly_lies(dataset, made):
    stored = add_surfaces(dataset, made, range(len(made.fields)))
    reported: list[float] = []
    info = bring_up_to_date(dataset, RESULT, REGISTERED, progress=reported.append)
    poses = stored.poses()
    assert poses is not None
    assert _off_px(poses, made) < 0.15
    assert reported == sorted(reported)
    assert reported[-1] == pytest.approx(1.0)

    assert info.n_fields == len(made.fields)
    assert info.stitching is not None
    assert info.stitching.n_believed > 0.9 * info.stitching.n_overlaps
    assert info.stitching.step_median_um < 0.05
    assert info.changed == ()
    mosaic = stored.mosaic().window()
    assert mosaic.overlap_um is not None
    assert np.isfinite(mosaic.overlap_um).any()
    bring_up_to_date(dataset, RESULT, Recipe(stitching=Stitching(poses="stage", blend="ramp")))
    assert _scatter_um(mosaic, made) < 0.75 * _scatter_um(stored.mosaic().window(), made)


@pytest.mark.slow
def test_the_number_of_workers_makes_no_difference(dataset, made, tmp_path):
    stored = add_surfaces(dataset, made, range(6))
    bring_up_to_date(dataset, RESULT, REGISTERED, crew=LocalRunner(1))
    alone = stored.mosaic().window()
    other = make_dataset(tmp_path / "other.wafer", made)
    stored = add_surfaces(other, made, range(6))
    bring_up_to_date(other, RESULT, REGISTERED, crew=LocalRunner(3))
    _assert_same(alone, stored.mosaic().window())


@pytest.mark.campaign
def test_fields_that_come_are_placed_beside_the_others_and_solved_for_together_at_the_end(dataset, made, tmp_path):
    for place in range(len(made.fields)):
        stored = add_surfaces(dataset, made, [place])
        before = stored.poses()
        info = bring_up_to_date(dataset, RESULT, REGISTERED, final=False)
        assert info.n_fields == place + 1
        assert bool(info.changed) == (place > 0)
        if before is not None:  # the others stayed where they were
            np.testing.assert_array_equal(stored.poses().x_um[:place], before.x_um)
    assert _off_px(stored.poses(), made) < 0.5
    assert not stored.shows_all(made.fields)
    bring_up_to_date(dataset, RESULT, REGISTERED)
    grown = stored.poses()
    assert stored.shows_all(made.fields)

    at_once = make_dataset(tmp_path / "at_once.wafer", made)
    add_surfaces(at_once, made, range(len(made.fields)))
    bring_up_to_date(at_once, RESULT, REGISTERED)
    complete = Dataset.open(at_once).result(RESULT).poses()
    pixel_um = made.heights[0].pixel_um
    assert np.abs(grown.x_um - complete.x_um).max() < 0.11 * pixel_um  # what moved by less stayed where it was drawn
    assert np.abs(grown.z_um - complete.z_um).max() < 0.02


@pytest.mark.slow
def test_nothing_new_leaves_the_mosaic_alone(dataset, made):
    stored = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    files = {file: file.stat().st_mtime_ns for file in stored.mosaic_path.rglob("*/0/c/*/*")}
    assert files
    info = bring_up_to_date(dataset, RESULT, REGISTERED)
    assert {file: file.stat().st_mtime_ns for file in stored.mosaic_path.rglob("*/0/c/*/*")} == files
    assert info.n_fields == 4


@pytest.mark.slow
def test_a_field_made_again_is_shown_as_it_is_now(dataset, made):
    stored = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    first = made.heights[0]
    higher = dataclasses.replace(first, z_um=first.z_um + 50, z_raw_um=first.z_raw_um + 50)
    stored.save_surface(made.fields[0], higher)
    bring_up_to_date(dataset, RESULT, REGISTERED)
    poses = stored.poses()
    assert poses.z_um[0] - np.median(poses.z_um[1:]) == pytest.approx(50, abs=8)


@pytest.mark.slow
def test_two_runs_on_the_same_surfaces_leave_the_same_bytes(made, tmp_path):
    results = []
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        dataset = make_dataset(tmp_path / folder / "grid.wafer", made)
        stored = add_surfaces(dataset, made, range(6))
        for file in (stored.path / "surfaces").iterdir():
            os.utime(file, ns=(0, len(results) + file.stat().st_size))
        bring_up_to_date(dataset, RESULT, REGISTERED)
        manifest = stored.path / MANIFEST  # it is signed with the key of its folder
        made_files = [file for file in _files(stored.path) if file != manifest]
        results.append({file.relative_to(stored.path): file.read_bytes() for file in made_files})
    assert results[0].keys() == results[1].keys()
    assert len(results[0]) > 20
    assert [name for name, content in results[0].items() if content != results[1][name]] == []


@pytest.mark.slow
def test_a_surface_that_is_written_again_with_the_same_content_changes_nothing(dataset, made):
    stored = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    add_surfaces(dataset, made, [2])
    assert StitchingInputs.open(dataset, RESULT, REGISTERED).previous_solution().unchanged.all()
    shown = {file: file.stat().st_mtime_ns for file in stored.mosaic_path.rglob("*/0/c/*/*")}
    bring_up_to_date(dataset, RESULT, REGISTERED)
    assert {file: file.stat().st_mtime_ns for file in stored.mosaic_path.rglob("*/0/c/*/*")} == shown


def _files(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


@pytest.mark.slow
def test_what_was_broken_off_is_made_anew(dataset, made):
    stored = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    complete = stored.mosaic().window()
    stored.begin_mosaic_update(stored.poses())  # and its process was killed, with a part drawn
    for file in stored.mosaic_path.rglob("z_um/0/c/*/*"):
        file.unlink()
    assert stored.broken_off
    assert not stored.shows_all(made.fields)
    bring_up_to_date(dataset, RESULT, REGISTERED)
    assert not stored.broken_off
    _assert_same(complete, stored.mosaic().window())


@pytest.mark.slow
def test_a_stopped_job_leaves_the_mosaic_that_there_was(dataset, made):
    stored = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    before = stored.mosaic().window()
    add_surfaces(dataset, made, [4])
    with pytest.raises(ComputeError, match="stopped"):
        bring_up_to_date(dataset, RESULT, REGISTERED, should_stop=lambda: True)
    _assert_same(before, stored.mosaic().window())


def test_a_torn_surface_is_named_and_left_out(dataset, made):
    stored = add_surfaces(dataset, made, range(4))
    torn = next(stored.path.rglob(f"{made.fields[2].name}.npz"))
    torn.write_bytes(torn.read_bytes()[:1000])
    info = bring_up_to_date(dataset, RESULT, REGISTERED)
    assert info.n_fields == 3
    assert any("Field 3 is left out" in note for note in info.recipe_notes)


def test_without_a_surface_there_is_nothing_to_stitch(dataset):
    with pytest.raises(DatasetError, match="no surfaces to stitch"):
        bring_up_to_date(dataset, RESULT, REGISTERED)


def _off_px(poses, made) -> float:
    """How far fields lie from the truth, rms, the whole moved as well as possible: only the stage knows that."""
    off_x, off_y = poses.x_um - made.known.x_um[: len(poses.x_um)], poses.y_um - made.known.y_um[: len(poses.y_um)]
    off_um = np.hypot(off_x - off_x.mean(), off_y - off_y.mean())
    return float(np.sqrt(np.mean(off_um**2))) / made.heights[0].pixel_um


def _scatter_um(mosaic, made) -> float:
    """How far heights are from the truth, rms, but for the height of the whole."""
    return float(np.std((mosaic.z_um - made.truth(mosaic.x0_um, mosaic.y0_um, mosaic.shape))[mosaic.measured]))


def _assert_same(a, b) -> None:
    for name in LAYERS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_a_surface_of_another_dataset_is_named_and_left_out(dataset, made):
    stored = add_surfaces(dataset, made, range(4))
    stored.save_surface(made.fields[1], made.heights[7])
    cropped = made.heights[3].crop(slice(0, 100), slice(0, 100))
    stored.save_surface(made.fields[3], cropped)
    info = bring_up_to_date(dataset, RESULT, REGISTERED)
    assert info.n_fields == 2
    assert [note.split(":")[0] for note in info.recipe_notes if "left out" in note] == [
        "Field 2 is left out",
        "Field 4 is left out",
    ]
