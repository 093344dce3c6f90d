"""Frames are compressed once their heights are made, if the plan says so; the dataset is ours again afterwards."""

from __future__ import annotations

from concurrent.futures import Future
from typing import get_args

import numpy as np
import pytest

from tests.support.datasets.samples import all_shots, make_frame, make_job, make_plan
from tests.support.patience import PATIENCE_S
from wafer_viewer.model.errors import DatasetError, PlanError
from wafer_viewer.model.job import Compression, Job
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.files.frame_check import FrameCompression
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_pages import CODECS
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.writer import DatasetWriter

SLOPE = np.add.outer(np.arange(60), np.arange(80)).astype(np.uint8)


class Worker:
    """Background work that waits until a test lets it run."""

    def run(self, title, task, *args, ended):
        self.title, self._task, self._args, self._ended = title, task, args, ended

    def work(self, should_stop=lambda: False):
        done: Future = Future()
        try:
            done.set_result(self._task(*self._args, should_stop=should_stop))
        except DatasetError as fault:
            done.set_exception(fault)
        self._ended(done)


class Bench:
    def __init__(self, folder, codec, finish=True):
        job = replace(make_job(n_frames=12), compression=codec)
        plan = make_plan(job, 60, 80)
        with DatasetWriter.create(folder / "scan.wafer", plan, job) as writer:
            for shot in all_shots(plan)[: None if finish else -1]:
                writer.frame(make_frame(shot, plan, SLOPE + np.uint8(shot.k)))
            if finish:
                writer.finish()
        self.path, self.worker = folder / "scan.wafer", Worker()
        self.queue = CommandQueue(Snapshot(data_folder=folder))
        self.library = Library(self.queue, folder)
        self.compression = FrameCompression(self.library, self.worker, Notifications(self.queue))
        self.library.open(self.path)

    @property
    def shown(self):
        return self.queue.now.dataset


@pytest.fixture
def bench(tmp_path):
    opened = []

    def make(codec="zstd", finish=True):
        opened.append(Bench(tmp_path, codec, finish))
        return opened[-1]

    yield make
    for made in opened:
        made.library.close()
        made.queue.close()


def test_frames_are_compressed_as_the_plan_says_and_the_saved_bytes_are_shown(bench):
    made = bench()
    before = made.library.dataset.stack(1).images.copy()
    made.compression.begin()
    with pytest.raises(DatasetError, match="scan are being compressed: cancel that"):
        made.compression.require_over(made.path)
    made.worker.work()
    made.compression.require_over(made.path)
    assert made.shown.storage.saved_bytes > made.shown.storage.raw_bytes / 2
    assert made.shown.storage.stored_bytes == Dataset.open(made.path).frame_bytes()
    assert made.shown.read_only is None
    with pytest.raises(DatasetError, match="being written by"):
        Lock.take(made.path)
    np.testing.assert_array_equal(made.library.dataset.stack(1).images, before)


def test_a_stopped_compression_says_so_and_gives_the_dataset_back(bench):
    made = bench()
    made.compression.begin()
    made.worker.work(should_stop=lambda: True)
    assert "stopped at 0 of 2 fields" in made.queue.now.faults[-1].text
    assert made.shown.read_only is None
    assert Dataset.open(made.path).check().ok


@pytest.mark.parametrize(("codec", "finish"), [("none", True), ("zstd", False)])
def test_nothing_is_compressed_without_the_choice_or_before_the_scan_is_finished(bench, codec, finish):
    made = bench(codec, finish)
    made.compression.begin()
    assert not hasattr(made.worker, "title")
    assert made.shown.storage is None


def test_another_dataset_may_be_opened_meanwhile(bench):
    made = bench()
    made.compression.begin()
    made.library.close()
    made.worker.work()
    assert made.queue.now.dataset is None
    assert Dataset.open(made.path).scan.is_compressed


def test_a_plan_names_a_compression_that_the_store_has():
    assert get_args(Compression) == tuple(CODECS)
    job = make_job()
    assert decode(encode(job).replace('compression = "none"\n', ""), Job, "plan.toml").compression == "none", (
        "as in older plans"
    )
    with pytest.raises(PlanError, match="compression"):
        replace(job, compression="zip")


@pytest.mark.campaign
def test_a_scan_of_the_session_ends_with_compressed_frames(session, job, surfaced):
    session.edit_job(replace(job(cols=1, n_frames=12), compression="zstd")).result(PATIENCE_S)
    path = session.start_scan("pressed").result(PATIENCE_S)
    now = session.wait_until(lambda s: s.dataset is not None and s.dataset.storage is not None, PATIENCE_S)
    assert surfaced(session.wait_until(surfaced, PATIENCE_S))
    assert now.dataset.storage.saved_bytes > 0
    assert now.dataset.read_only is None
    assert Dataset.open(path).check().ok
