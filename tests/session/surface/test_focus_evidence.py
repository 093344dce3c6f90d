"""Why a pixel of a dataset has its height: which field is asked, by which settings, and what cannot be answered."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries
from wafer_viewer.session.surface.focus_evidence import focus_curve
from wafer_viewer.session.surface.worker_tasks import reconstruct_field
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.stack_import import import_dataset

ROWS, COLS, FRAMES = 64, 96, 9
BEST = {1: 3, 2: 5}
"""The frame in which each field is sharp."""


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """Two fields side by side that share a quarter, the left one sharp at z 6, the right one at z 10."""
    folder = tmp_path_factory.mktemp("taken")
    noise = np.random.default_rng(1)
    for col in (0, 1):
        for k in range(FRAMES):
            spread = 5 + 60 * np.exp(-((k - BEST[col + 1]) ** 2) / 3)
            image = noise.normal(128, spread, (ROWS, COLS)).clip(0, 255).astype(np.uint8)
            tifffile.imwrite(folder / f"r0_c{col}_k{k}.tif", image)
    out = folder / "taken.wafer"
    import_dataset(folder, out, 2.0, 1.0, pattern="r{row}_c{col}_k{k}.tif", overlap_fraction=0.25)
    return out


@pytest.mark.slow
def test_the_field_whose_centre_is_nearest_answers_unless_another_is_named(taken):
    left, right = Dataset.open(taken).fields
    shared = (left.x_um + 0.6 * (right.x_um - left.x_um), 0.0)
    assert focus_curve(taken, "default", 0, left.x_um, 0.0).field == 1
    assert focus_curve(taken, "default", 0, *shared).field == 2
    requested = focus_curve(taken, "default", 1, *shared)
    assert requested.field == 1
    assert requested.peak_z_um == pytest.approx(2.0 * BEST[1], abs=1.0)


@pytest.mark.slow
def test_the_surface_that_is_looked_at_answers_by_its_own_settings(taken):
    left, right = Dataset.open(taken).fields
    shared = (left.x_um + 0.6 * (right.x_um - left.x_um), 0.0)
    reconstruct_field(taken, 1, "sml", Recipe(focus_measure="sml", window=7))
    requested = focus_curve(taken, "sml", 0, *shared)
    assert (requested.field, requested.focus_measure, requested.window) == (1, "sml", 7)
    other = focus_curve(taken, "sml", 0, *shared, Recipe(focus_measure="glv", window=5))
    assert (other.focus_measure, other.window) == ("glv", 5)


def test_places_without_a_field_and_fields_without_frames_are_named(taken):
    with pytest.raises(DatasetError, match=r"\(900.0, 0.0\) um lies in no field of taken.wafer"):
        focus_curve(taken, "default", 0, 900.0, 0.0)
    with pytest.raises(DatasetError, match="no field 7"):
        focus_curve(taken, "default", 7, 0.0, 0.0)
    pages = taken / "frames" / f"{Dataset.open(taken).field(2).name}.tif"
    pages.rename(pages.with_suffix(".away"))
    try:
        with pytest.raises(DatasetError, match="is missing"):
            focus_curve(taken, "default", 2, Dataset.open(taken).field(2).x_um, 0.0)
    finally:
        pages.with_suffix(".away").rename(pages)


def test_the_frame_nearest_to_a_z_is_the_one_that_was_taken_there(taken):
    class Shelf:
        dataset = Dataset.open(taken)

    ask = DatasetQueries(Shelf(), lambda: None)
    np.testing.assert_array_equal(ask.frame_near(2, 10.7), ask.frame(2, 5))
    np.testing.assert_array_equal(ask.frame_near(2, -50.0), ask.frame(2, 0))
