"""The first field chooses the recipe for all others, whatever is killed and however many workers there are."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from tests.support.datasets.samples import make_job, make_plan
from wafer_viewer.compute.child_process import ChildDied
from wafer_viewer.compute.messages import ComputeUp, ComputeWarm
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.session.surface.reconstruction_queue import Reconstruction
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.dataset.writer import DatasetWriter

RESULT = "default"


class Workers:
    """Compute that notes which fields it was given, and answers when it is told to."""

    def __init__(self) -> None:
        self.given: dict[int, Future[Any]] = {}

    def start(self) -> None:
        """Start a host."""

    def run(self, work: str, task: object, path: Path, number: int, *_: object) -> Future[Any]:
        return self.given.setdefault(number, Future())

    def lead(self, *_: object) -> Future[Any]:
        return Future()

    def cancel(self, work: str) -> None:
        """Stop nothing."""


class Bench:
    """A reconstruction of a dataset of 4 fields with 2 workers."""

    def __init__(self, folder: Path) -> None:
        job = make_job(cols=4)
        DatasetWriter.create(folder / "scan.wafer", make_plan(job), job).close()
        self.command_queue = CommandQueue(Snapshot(data_folder=folder))
        self.library = Library(self.command_queue, folder)
        self.workers = Workers()
        self.reconstruction = Reconstruction(
            self.command_queue, Notifications(self.command_queue), self.library, None, lambda: None
        )
        self.reconstruction.compute = self.workers  # pyright: ignore[reportAttributeAccessIssue]

    def begin(self, recipe: Recipe) -> None:
        def begin() -> None:
            self.library.open(self.library._folder / "scan.wafer")
            self.reconstruction.begin(recipe, RESULT, (1, 2, 3, 4))

        self.command_queue.do(begin).result()
        self.host_is_up()

    def host_is_up(self) -> None:
        self.reconstruction._heard(ComputeUp(n_workers=2))
        self.reconstruction._heard(ComputeWarm())
        self.wait()

    def answer(self, number: int, fault: Exception | None = None) -> None:
        done = self.workers.given.pop(number)
        done.set_result(None) if fault is None else done.set_exception(fault)
        self.wait()

    def wait(self) -> None:
        self.command_queue.do(lambda: None).result()

    @property
    def busy(self) -> list[int]:
        return sorted(self.workers.given)

    @property
    def result(self) -> Result:
        return self.library.dataset.result(RESULT)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.command_queue.do(bench.library.close).result()
    bench.command_queue.close()


def test_the_first_field_is_made_alone_until_it_has_chosen(bench: Bench) -> None:
    bench.begin(Recipe())
    assert bench.busy == [1]
    bench.result.save_settled(Recipe())
    bench.answer(1)
    assert bench.busy == [2, 3]


def test_it_is_made_first_again_when_the_host_was_killed(bench: Bench) -> None:
    bench.begin(Recipe())
    bench.reconstruction._gone(-9)
    bench.answer(1, ChildDied("The process ended."))
    bench.host_is_up()
    assert bench.busy == [1]


def test_the_next_one_chooses_alone_when_the_first_cannot(bench: Bench) -> None:
    bench.begin(Recipe())
    bench.answer(1, ComputeError("The frames have no structure."))
    assert bench.busy == [2]
    bench.answer(2)
    assert bench.busy == [3], "too little of field 2 was measured to choose by"
    bench.result.save_settled(Recipe())
    bench.answer(3)
    assert bench.busy == [4]


def test_nobody_waits_for_a_recipe_that_was_chosen_before(bench: Bench) -> None:
    bench.command_queue.do(bench.library.open, bench.library._folder / "scan.wafer").result()
    bench.result.save_recipe(Recipe())
    bench.result.save_settled(Recipe())
    bench.begin(Recipe())
    assert bench.busy == [1, 2]
