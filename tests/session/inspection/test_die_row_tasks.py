"""Rows of dies compared by other runner: the same to the last bit, whoever takes them and whoever dies meanwhile."""

from __future__ import annotations

import os
from dataclasses import replace as with_fields

import msgspec
import numpy as np
import psutil
import pytest

from tests.support.datasets.patterned_dataset import PLANTED, patterned_dataset
from wafer_viewer.compute.crews import crew_for
from wafer_viewer.compute.task_runner import Done, LocalRunner, TaskRunner
from wafer_viewer.measure.defects.golden_die import ReferenceDie
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.defects.matched_filters import BINS
from wafer_viewer.measure.defects.noise_model import NoiseModel
from wafer_viewer.measure.dies import die_cells
from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection
from wafer_viewer.session.inspection import inspection_job
from wafer_viewer.session.inspection.inspection_job import GivenDies, in_order, inspect_dataset, inspected, wafer_of
from wafer_viewer.session.surface.headless import LocalOrCluster
from wafer_viewer.store.dataset.dataset import Dataset

DULL = DefectRecipe(sensitivity=0.25)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("rows") / "patterned.wafer"
    return path, patterned_dataset(path)


@pytest.fixture(scope="module")
def alone(made):
    return by(made, None)


def by(made, crew, **more) -> Inspection:
    path, wafer = made
    return inspect_dataset(path, "default", DULL, wafer.grid, crew=crew, **more)


def stored(made):
    return Dataset.open(made[0]).result("default")


class Elsewhere:
    """Hands that are no part of this process, as far as anybody sees; they finish the last item first."""

    n_slots, threads_each = 2, 1

    def __init__(self) -> None:
        self.seen: list[tuple[object, ...]] = []

    def require_sight(self, dataset):
        pass

    def each(self, task, items, *, should_stop):
        self.seen += items
        for index in reversed(range(len(items))):
            yield Done(index, task(*items[index]))


@pytest.mark.campaign
def test_the_number_of_workers_makes_no_difference(made, alone):
    assert len(alone.found) == len(PLANTED)
    for crew in (LocalRunner(1), LocalRunner(3), Elsewhere()):
        assert msgspec.to_builtins(by(made, crew)) == msgspec.to_builtins(alone)


@pytest.mark.slow
def test_what_rows_are_compared_with_goes_by_a_file_that_is_gone_afterwards(made):
    crew = Elsewhere()
    by(made, crew)
    (work, reference, row), *others = crew.seen
    assert len(row) == 4
    assert len(others) == 2
    assert work.golden.z_um.size == 0
    assert reference.parent == stored(made).path
    assert not list(reference.parent.glob(".inspection-*"))


def test_what_a_killed_inspection_left_behind_is_swept_away(tmp_path):
    left = tmp_path / ".inspection-1f.npz"
    left.touch()
    quiet = NoiseModel({}, {}, {}, np.zeros((2, 2), np.uint8), np.ones(BINS, np.float32))
    with inspection_job.stored_golden(tmp_path, golden := ReferenceDie.nothing((2, 2), 1.0, 1.0), quiet):
        assert left.exists()  # another one is at work
    os.utime(left, (0, 0))
    with inspection_job.stored_golden(tmp_path, golden, quiet) as own:
        assert list(tmp_path.iterdir()) == [own]


def test_a_reference_that_is_gone_or_damaged_is_reported(made, tmp_path):
    torn = tmp_path / "torn.npz"
    torn.write_bytes(b"PK")
    for path in (torn, tmp_path / "gone.npz"):
        with pytest.raises(DatasetError, match="cannot be read"):
            inspection_job.compare_row(None, path, ())


def test_the_first_fault_of_a_row_ends_the_inspection():
    with pytest.raises(DatasetError, match="torn"):
        list(in_order([Done(1, "b"), Done(0, fault=DatasetError("a shard is torn"))]))
    assert list(in_order([Done(1, "b"), Done(2, "c"), Done(0, "a")])) == ["a", "b", "c"]


@pytest.mark.campaign
def test_a_stopped_inspection_says_so_and_leaves_nothing(made):
    reported: list[float] = []
    for crew in (None, Elsewhere()):
        reported.clear()
        with pytest.raises(ComputeError, match="The inspection was stopped"):
            by(made, crew, progress=reported.append, should_stop=lambda: len(reported) >= 1)
        assert not list(stored(made).path.glob(".inspection-*"))


@pytest.mark.slow
def test_no_more_than_a_strip_is_read_at_a_time(made, monkeypatch):
    wafer = made[1]
    monkeypatch.setattr(die_cells, "FORM_POINTS", 10_000)
    mosaic, rows = stored(made).mosaic(), []
    complete = type(mosaic).read
    monkeypatch.setattr(
        type(mosaic),
        "read",
        lambda self, name, level, r, c: rows.append((level, r.stop - r.start)) or complete(self, name, level, r, c),
    )
    inspect(mosaic, wafer.grid, DULL)
    pitch_px = wafer.grid.pitch_y_um / mosaic.pixel_um
    assert max(n for level, n in rows if level == 0) <= max(pitch_px + 20, 140)


@pytest.mark.slow
def test_workers_find_the_same_and_one_may_die(made, alone):
    with crew_for(workers=2) as crew:
        runner = Mortal(crew)
        found = by(made, runner)
    assert runner.killed
    assert msgspec.to_builtins(found) == msgspec.to_builtins(alone)


@pytest.mark.campaign
def test_the_command_lines_workers_find_the_same(made):
    path, wafer = made
    grid = wafer.grid
    given = GivenDies((grid.pitch_x_um, grid.pitch_y_um), (grid.x0_um, grid.y0_um), (grid.width_um, grid.height_um))
    one, two = (
        inspected(wafer_of(path, "default"), DULL, given, None, "dies", lambda _: None, LocalOrCluster(workers=n))
        for n in (1, 2)
    )
    assert len(one.found) == len(PLANTED)
    assert msgspec.to_builtins(one) == msgspec.to_builtins(two)


class Mortal:
    """A cluster, of which a worker is killed when it has done the first row."""

    threads_each = 1

    def __init__(self, crew: TaskRunner) -> None:
        self.crew, self.killed = crew, 0

    @property
    def n_slots(self):
        return self.crew.n_slots

    def require_sight(self, dataset):
        self.crew.require_sight(dataset)

    def each(self, task, items, *, should_stop):
        for done in self.crew.each(pid_with, [(task, item) for item in items], should_stop=should_stop):
            pid, value = done.value
            if not self.killed:
                self.killed = pid
                psutil.Process(pid).kill()
            yield with_fields(done, value=value)


def pid_with(task, item):
    """The process that did it, and what came of it."""
    return psutil.Process().pid, task(*item)
