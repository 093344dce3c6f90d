"""A worker that is set on a field while its frames are still being taken."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.support.datasets.samples import make_frame, make_job, make_plan
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.session.surface.worker_tasks import reconstruct_field, reconstruct_live
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter

ROWS, COLS, FRAMES = 64, 96, 14


@pytest.fixture
def scan(tmp_path):
    """A scan of two fields of which the first is taken and has its heights."""
    job = make_job(n_frames=FRAMES)
    plan = make_plan(job, ROWS, COLS)
    writer = DatasetWriter.create(tmp_path / "scan.wafer", plan, job)
    for k in range(FRAMES):
        writer.frame(frame(plan, Shot(1, k)))
    Dataset.open(writer.path).result().save_recipe(Recipe())
    reconstruct_field(writer.path, 1, "default", Recipe())
    yield writer, plan
    writer.close()


def frame(plan, shot):
    spread = 5 + 60 * np.exp(-((shot.k - 4 - shot.field) ** 2) / 3)
    image = np.random.default_rng([shot.field, shot.k]).normal(128, spread, (ROWS, COLS))
    return make_frame(shot, plan, image.clip(0, 255).astype(np.uint8))


def asked_each_time(*acts: Callable[[], object]) -> Callable[[], bool]:
    """What the task asks between two looks at the dataset; here something happens each time."""
    coming = iter(acts)

    def should_stop() -> bool:
        act = next(coming, None)
        return act is None or act() is True

    return should_stop


def test_its_heights_are_those_of_the_finished_field(scan):
    writer, plan = scan
    shots = [Shot(2, k) for k in reversed(range(FRAMES))]
    frames = [lambda shot=shot: writer.frame(frame(plan, shot)) for shot in shots]
    assert reconstruct_live(writer.path, 2, "default", should_stop=asked_each_time(*frames))
    data = Dataset.open(writer.path)
    settled = data.result().settled()
    assert settled is not None
    live, complete = data.result().surface(data.field(2)), reconstruct(data.stack(2), settled)
    assert live.measured.mean() > 0.5
    for layer in ("z_um", "z_raw_um", "confidence", "origin", "all_in_focus"):
        np.testing.assert_array_equal(getattr(live, layer), getattr(complete, layer), layer)


def test_it_lets_go_when_the_scan_stops_or_misses_a_frame(scan):
    writer, plan = scan
    some = [lambda k=k: writer.frame(frame(plan, Shot(2, k))) for k in range(6)]
    assert not reconstruct_live(writer.path, 2, "default", should_stop=asked_each_time(*some, lambda: True))
    missed = [lambda: writer.missed(Shot(2, 6), 6, "nothing came")]
    assert not reconstruct_live(writer.path, 2, "default", should_stop=asked_each_time(*missed, lambda: False))
    data = Dataset.open(writer.path)
    assert data.result().surfaces_done(data.fields) == {1}


def test_it_needs_what_an_earlier_field_settled(tmp_path):
    job = make_job(n_frames=FRAMES)
    with DatasetWriter.create(tmp_path / "new.wafer", make_plan(job, ROWS, COLS), job) as writer:
        assert not reconstruct_live(writer.path, 1, "default")
