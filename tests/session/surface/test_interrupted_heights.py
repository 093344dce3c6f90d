"""Heights whose making was interrupted, or that the disk has no space for."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.datasets.samples import all_shots, make_frame, make_job, make_plan
from wafer_viewer.model.errors import DiskFullError
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.surface.headless import make_surface
from wafer_viewer.session.surface.worker_tasks import reconstruct_field
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.dataset.writer import DatasetWriter

ROWS, COLS, FRAMES = 64, 96, 14


@pytest.fixture
def data(tmp_path):
    job = make_job(n_frames=FRAMES)
    plan = make_plan(job, ROWS, COLS)
    with DatasetWriter.create(tmp_path / "scan.wafer", plan, job) as writer:
        for shot in all_shots(plan):
            spread = 5 + 60 * np.exp(-((shot.k - 4 - shot.field) ** 2) / 3)
            image = np.random.default_rng([shot.field, shot.k]).normal(128, spread, (ROWS, COLS))
            writer.frame(make_frame(shot, plan, image.clip(0, 255).astype(np.uint8)))
    return Dataset.open(tmp_path / "scan.wafer")


def test_an_interruption_after_the_first_field_has_chosen_changes_nothing(data, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    for name in ("whole", "cut"):
        data.result(name).save_recipe(Recipe())
    reconstruct_field(data.path, 1, "whole", Recipe())
    monkeypatch.setattr(Result, "save_surface", interrupted)
    with pytest.raises(KeyboardInterrupt):
        reconstruct_field(data.path, 1, "cut", Recipe())
    monkeypatch.undo()
    assert data.result("cut").settled() == data.result("whole").settled()
    reconstruct_field(data.path, 1, "cut", Recipe())
    whole, cut = (data.result(name).path / "surfaces" / "r0000c0000.npz" for name in ("whole", "cut"))
    assert cut.read_bytes() == whole.read_bytes()


def test_a_full_disk_ends_the_work_with_one_sentence(data, monkeypatch):
    tried, warned = [], []

    def full(_, field, surface):
        tried.append(field.number)
        raise DiskFullError("The disk is full.")

    monkeypatch.setattr(Result, "save_surface", full)
    with pytest.raises(DiskFullError, match=r"The disk is full\."):
        make_surface(data.path, Recipe(), "default", again=False, tell=lambda _: None, warn=warned.append)
    assert (tried, warned) == ([1], [])
