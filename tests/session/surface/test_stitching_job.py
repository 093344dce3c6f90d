"""A mosaic is brought up to date: from nothing, field by field, after repairs and after a broken-off job."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.datasets.grid_dataset import REGISTERED, RESULT, add_surfaces, make_dataset
from tests.truth.field_grid import SMALL, make
from wafer_viewer.compute.task_runner import LocalRunner
from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.dataset.dataset import Dataset

LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin", "overlap_um")


@pytest.fixture(scope="module")
def made():
    return make(SMALL)


@pytest.fixture
def dataset(tmp_path, made):
    return make_dataset(tmp_path / "grid.wafer", made)


def test_a_mosaic_from_nothing_shows_every_field_where_it_truly_lies(dataset, made):
    kept = add_surfaces(dataset, made, range(len(made.fields)))
    told: list[float] = []
    info = bring_up_to_date(dataset, RESULT, REGISTERED, progress=told.append)
    poses = kept.poses()
    assert poses is not None
    assert _off_px(poses, made) < 0.15
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)

    assert info.n_fields == len(made.fields)
    assert info.stitching is not None
    assert info.stitching.n_believed > 0.9 * info.stitching.n_overlaps
    assert info.stitching.step_median_um < 0.05
    assert info.changed == ()
    mosaic = kept.mosaic().window()
    assert mosaic.overlap_um is not None
    assert np.isfinite(mosaic.overlap_um).any()
    bring_up_to_date(dataset, RESULT, Recipe(stitching=Stitching(poses="stage", blend="ramp")))
    assert _scatter_um(mosaic, made) < 0.75 * _scatter_um(kept.mosaic().window(), made)


def test_hands_make_no_difference(dataset, made, tmp_path):
    kept = add_surfaces(dataset, made, range(6))
    bring_up_to_date(dataset, RESULT, REGISTERED, crew=LocalRunner(1))
    alone = kept.mosaic().window()
    other = make_dataset(tmp_path / "other.wafer", made)
    kept = add_surfaces(other, made, range(6))
    bring_up_to_date(other, RESULT, REGISTERED, crew=LocalRunner(3))
    _assert_same(alone, kept.mosaic().window())


@pytest.mark.slow
def test_fields_that_come_are_placed_beside_the_others_and_solved_for_together_at_the_end(dataset, made, tmp_path):
    for place in range(len(made.fields)):
        kept = add_surfaces(dataset, made, [place])
        before = kept.poses()
        info = bring_up_to_date(dataset, RESULT, REGISTERED, final=False)
        assert info.n_fields == place + 1
        assert bool(info.changed) == (place > 0)
        if before is not None:  # the others stayed where they were
            np.testing.assert_array_equal(kept.poses().x_um[:place], before.x_um)
    assert _off_px(kept.poses(), made) < 0.5
    assert not kept.shows_all(made.fields)
    bring_up_to_date(dataset, RESULT, REGISTERED)
    grown = kept.poses()
    assert kept.shows_all(made.fields)

    at_once = make_dataset(tmp_path / "at_once.wafer", made)
    add_surfaces(at_once, made, range(len(made.fields)))
    bring_up_to_date(at_once, RESULT, REGISTERED)
    whole = Dataset.open(at_once).result(RESULT).poses()
    pixel_um = made.heights[0].pixel_um
    assert np.abs(grown.x_um - whole.x_um).max() < 0.11 * pixel_um  # what moved by less stayed where it was drawn
    assert np.abs(grown.z_um - whole.z_um).max() < 0.02


def test_nothing_new_leaves_the_mosaic_alone(dataset, made):
    kept = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    files = {file: file.stat().st_mtime_ns for file in kept.mosaic_path.rglob("*/0/c/*/*")}
    assert files
    info = bring_up_to_date(dataset, RESULT, REGISTERED)
    assert {file: file.stat().st_mtime_ns for file in kept.mosaic_path.rglob("*/0/c/*/*")} == files
    assert info.n_fields == 4


def test_a_field_made_again_is_shown_as_it_is_now(dataset, made):
    kept = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    first = made.heights[0]
    higher = dataclasses.replace(first, z_um=first.z_um + 50, z_raw_um=first.z_raw_um + 50)
    kept.save_surface(made.fields[0], higher)
    bring_up_to_date(dataset, RESULT, REGISTERED)
    poses = kept.poses()
    assert poses.z_um[0] - np.median(poses.z_um[1:]) == pytest.approx(50, abs=8)


def test_what_was_broken_off_is_made_anew(dataset, made):
    kept = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    whole = kept.mosaic().window()
    kept.begin_mosaic_update(kept.poses())  # and its process was killed, with a part drawn
    for file in kept.mosaic_path.rglob("z_um/0/c/*/*"):
        file.unlink()
    assert kept.broken_off
    assert not kept.shows_all(made.fields)
    bring_up_to_date(dataset, RESULT, REGISTERED)
    assert not kept.broken_off
    _assert_same(whole, kept.mosaic().window())


def test_a_stopped_job_leaves_the_mosaic_that_there_was(dataset, made):
    kept = add_surfaces(dataset, made, range(4))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    before = kept.mosaic().window()
    add_surfaces(dataset, made, [4])
    with pytest.raises(ComputeError, match="stopped"):
        bring_up_to_date(dataset, RESULT, REGISTERED, should_stop=lambda: True)
    _assert_same(before, kept.mosaic().window())


def test_a_torn_surface_is_named_and_left_out(dataset, made):
    kept = add_surfaces(dataset, made, range(4))
    torn = next(kept.path.rglob(f"{made.fields[2].name}.npz"))
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
    kept = add_surfaces(dataset, made, range(4))
    kept.save_surface(made.fields[1], made.heights[7])
    cropped = made.heights[3].crop(slice(0, 100), slice(0, 100))
    kept.save_surface(made.fields[3], cropped)
    info = bring_up_to_date(dataset, RESULT, REGISTERED)
    assert info.n_fields == 2
    assert [note.split(":")[0] for note in info.recipe_notes if "left out" in note] == [
        "Field 2 is left out",
        "Field 4 is left out",
    ]
