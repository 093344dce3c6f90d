"""The list of results from its prompt: kept with small pictures, taken back and done again, opened again."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import pytest

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import PointHeight, Profile
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Region
from wafer_viewer.session.measurement.results import ResultsStore
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.store.dataset.result import Result


class Desk:
    """The desk's snapshot without its thread."""

    def __init__(self):
        self.now = Snapshot(dataset=SimpleNamespace(read_only=None))

    def change(self, **fields):
        self.now = dataclasses.replace(self.now, **fields)


@pytest.fixture
def command_queue():
    return Desk()


@pytest.fixture
def results_store(command_queue, tmp_path):
    return opened(command_queue, tmp_path)


def opened(command_queue, folder):
    library = SimpleNamespace(result=Result.of(folder, "default"), shown=command_queue.now.dataset)
    made = ResultsStore(command_queue, library)
    made.open()
    return made


def point(z_um=1.0, name=""):
    place = Region.point(3.0, 4.0)
    return PointHeight(name=name, place=place, height=Length(value_um=z_um), points=9)


def names(command_queue):
    return [f.name for f in command_queue.now.findings]


def test_every_kind_is_counted_by_itself_and_named(results_store, command_queue):
    line = Region.line(0, 0, 5, 0)
    nothing = Length(value_um=0.0)
    for finding in (point(), point(), Profile(line=line, length_um=5.0, pt=nothing, rise=nothing, measured_fraction=1)):
        results_store.keep.run(finding)
    results_store.keep.run(point(name="top of the bump"))
    assert names(command_queue) == ["Point 1", "Point 2", "Profile 1", "top of the bump"]
    results_store.delete.run(1)
    results_store.keep.run(point())
    assert names(command_queue) == ["Point 2", "Profile 1", "top of the bump", "Point 1"], "no two bear the same name"


def test_what_was_undone_can_be_done_again_until_something_else_is_done(results_store, command_queue, tmp_path):
    results_store.keep.run(point())
    results_store.rename.run(1, "left bump")
    assert (command_queue.now.findings_undo, command_queue.now.findings_redo) == (True, False)
    results_store.undo.run()
    assert names(command_queue) == ["Point 1"]
    assert command_queue.now.findings_redo
    results_store.redo.run()
    assert names(command_queue) == ["left bump"]
    assert not command_queue.now.findings_redo
    results_store.undo.run()
    results_store.keep.run(point())
    assert not command_queue.now.findings_redo
    again = Desk()
    opened(again, tmp_path)
    assert names(again) == names(command_queue), "what is on the list is on the disk"
    assert (again.now.findings_undo, again.now.findings_redo) == (False, False)


def test_a_small_picture_outlives_a_deletion_that_is_undone(results_store, command_queue, tmp_path):
    result = Result.of(tmp_path, "default")
    first = results_store.keep.run(point(), b"\xff\xd8 first").number
    results_store.delete.run(first)
    second = results_store.keep.run(point(), b"\xff\xd8 second").number
    results_store.undo.run()
    results_store.undo.run()
    assert [f.number for f in command_queue.now.findings] == [first]
    assert result.thumbnail(first) == b"\xff\xd8 first"
    assert result.thumbnail(second) == b"\xff\xd8 second"


def test_a_result_without_a_picture_has_none_though_a_deleted_one_had(results_store, command_queue, tmp_path):
    results_store.delete.run(results_store.keep.run(point(), b"\xff\xd8 old").number)
    later = opened(command_queue, tmp_path).keep.run(point())
    assert Result.of(tmp_path, "default").thumbnail(later.number) is None


def test_a_dataset_that_others_hold_keeps_nothing(results_store, command_queue, tmp_path):
    command_queue.now.dataset.read_only = "process 7 holds it."
    with pytest.raises(MeasureError, match="cannot be kept: process 7 holds it"):
        results_store.keep.run(point(), b"\xff\xd8")
    with pytest.raises(MeasureError, match="cannot be kept"):
        results_store.redo.run()
    assert Result.of(tmp_path, "default").thumbnail(1) is None
