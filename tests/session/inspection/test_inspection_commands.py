"""Defects of the open dataset: kept with it, judged with undo, and never shown as of a surface that is another now."""

from __future__ import annotations

from concurrent.futures import Future

import pytest

from tests.support.datasets.compared_datasets import two_datasets
from tests.support.datasets.inspections import defect, inspection
from wafer_viewer.model.errors import DatasetError, DiesNotFound, MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.inspection.lot import WaferComparison
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.background_work import BackgroundWork, Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.inspection.inspection_commands import DefectController
from wafer_viewer.session.inspection.inspection_job import inspect_dataset, mosaic_mark
from wafer_viewer.session.state.inspection_state import DefectFilesState
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.records.inspection_records import read_inspection, write_inspection

FOUND = inspection(defect(1, "0,0", 100.0, 80.0), defect(2, "1,0", 400.0, 300.0))


class Hired:
    """A compute host that does what a test says, when it says so."""

    def __init__(self) -> None:
        self.done: Future[object] = Future()
        self.asked: list[tuple[object, ...]] = []
        self.cancelled: list[str] = []

    def lead(self, *requested: object) -> Future[object]:
        self.asked.append(requested)
        return self.done

    def cancel(self, work: str) -> None:
        self.cancelled.append(work)


class Bench:
    """The parts of a session that keep defects, on its thread."""

    def __init__(self, folder, path) -> None:
        self.command_queue = CommandQueue(Snapshot())
        self.library = Library(self.command_queue, folder)
        self.hired = Hired()
        self.controller = DefectController(
            self.command_queue,
            self.library,
            BackgroundWork(self.command_queue, Notifications(self.command_queue), self.hired),
            None,
            None,
        )
        self.do(self.controller.watch)
        self.open(path)

    def do(self, command, *args):
        return self.command_queue.do(command, *args).result(20)

    def open(self, path) -> None:
        self.do(self.library.open, path)
        self.do(self.controller.open)

    @property
    def state(self):
        return self.command_queue.snapshot.inspection

    def close(self) -> None:
        self.do(self.library.close)
        self.command_queue.close()


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    return two_datasets(tmp_path_factory.mktemp("inspected"))


@pytest.fixture
def result(pair):
    stored = Dataset.open(pair[0]).result("default")
    write_inspection(stored.path, replace(FOUND, mark=mosaic_mark(stored)))
    return stored


@pytest.fixture
def bench(pair, result):
    made = Bench(pair[0].parent, pair[0])
    yield made
    made.close()


@pytest.mark.slow
def test_what_was_found_is_read_again_with_its_dataset_and_belongs_to_it(bench, pair):
    assert bench.state.defects == FOUND.defects
    assert not bench.state.stale
    bench.open(pair[1])
    assert bench.state.inspection is None


def test_a_judgement_is_kept_at_once_and_can_be_undone(bench, result):
    first = bench.state.defects[0].number
    bench.do(bench.controller.judge, first, "nuisance", None, None)
    bench.do(bench.controller.judge, first, None, "pit", " dust ")
    stored = bench.state.defect(first)
    assert (stored.judgement, stored.seen_as, stored.note, bool(stored.judged_at)) == ("nuisance", "pit", "dust", True)
    assert stored.kind == FOUND.defects[0].kind
    assert read_inspection(result.path).defects == bench.state.defects
    bench.do(bench.controller.undo)
    assert bench.state.defect(first).judgement == "nuisance"
    assert bench.state.defect(first).judged_kind is None
    bench.do(bench.controller.redo)
    assert bench.state.defect(first).note == "dust"
    with pytest.raises(DatasetError, match="There is no defect 9999"):
        bench.do(bench.controller.judge, 9999, "real", None, None)


def test_several_defects_are_judged_at_once_and_taken_back_at_once(bench, result):
    numbers = tuple(defect.number for defect in FOUND.defects)
    bench.controller.judge(numbers, judgement="nuisance", kind="pit").result(20)
    assert {(d.judgement, d.seen_as) for d in bench.state.defects} == {("nuisance", "pit")}
    assert read_inspection(result.path).defects == bench.state.defects
    bench.do(bench.controller.undo)
    assert bench.state.defects == FOUND.defects
    assert not bench.state.can_undo
    with pytest.raises(DatasetError, match=r"There is no defect 77, 99: "):
        bench.controller.judge((99, *numbers, 77), judgement="real").result(20)


def test_an_inspection_of_a_surface_that_is_another_now_is_stale(bench, result):
    write_inspection(result.path, replace(FOUND, mark="of an older surface"))
    bench.do(bench.controller.open)
    assert bench.state.stale


def test_judgements_survive_a_new_inspection(bench, result):
    first = bench.state.defects[0].number
    bench.do(bench.controller.judge, first, "real", None, None)
    before = bench.state
    found = bench.controller.inspect(DefectRecipe(sensitivity=0.7), None, "dies")
    bench.do(lambda: None)
    assert bench.state.work
    assert bench.hired.asked[0][2:5] == (bench.library.dataset.path, "default", DefectRecipe(sensitivity=0.7))
    with pytest.raises(DatasetError, match="searched for already"):
        bench.do(bench.controller.inspect, DefectRecipe(), None, "dies")
    bench.hired.done.set_result(replace(FOUND, threshold_sigma=3.0, mark=mosaic_mark(result)))
    found.result(20)
    assert (bench.state.work, bench.state.inspection.threshold_sigma) == ("", 3.0)
    assert bench.state.defect(first).judgement == "real"
    assert read_inspection(result.path).threshold_sigma == 3.0
    assert bench.state.search == before.search + 1, "numbers of defects are those of one search"
    assert bench.command_queue.snapshot.works == ()


def test_a_comparison_with_an_earlier_inspection_ends_with_a_new_one(bench, result):
    compared = WaferComparison(first="w1", second="w2", added=(2,))
    bench.do(lambda: bench.command_queue.change(defect_files=DefectFilesState(earlier=compared)))
    found = bench.controller.inspect(DefectRecipe(), None, "dies")
    bench.do(lambda: None)
    assert bench.command_queue.snapshot.defect_files.earlier == compared
    bench.hired.done.set_result(replace(FOUND, mark=mosaic_mark(result)))
    found.result(20)
    assert bench.command_queue.snapshot.defect_files.earlier is None, "its numbers are of other defects"


def test_a_failed_inspection_gives_its_reason_instead_of_the_list(bench, result):
    (result.path / "defects.json").unlink()
    bench.do(bench.controller.open)
    found = bench.controller.inspect(DefectRecipe(), None, "dies")
    bench.hired.done.set_exception(MeasureError("The surface has no period: give the dies."))
    with pytest.raises(MeasureError):
        found.result(20)
    assert (bench.state.inspection, bench.state.problem) == (None, "The surface has no period: give the dies.")


def test_an_inspection_that_cannot_be_read_is_no_clean_surface(bench, result):
    (result.path / "defects.json").write_text("{")
    bench.do(bench.controller.open)
    assert bench.state.inspection is None
    assert "defects.json" in bench.state.problem


def test_a_dataset_that_is_held_elsewhere_is_looked_at_and_not_judged(pair, result):
    lock = Lock.take(pair[0])
    bench = Bench(pair[0].parent, pair[0])
    try:
        assert bench.state.defects == FOUND.defects
        with pytest.raises(DatasetError, match="Defects were not changed"):
            bench.do(bench.controller.judge, bench.state.defects[0].number, "real", None, None)
        with pytest.raises(DatasetError, match="Defects were not changed"):
            bench.do(bench.controller.inspect, DefectRecipe(), None, "dies")
    finally:
        bench.close()
        lock.release()


@pytest.mark.slow
def test_a_bump_on_a_surface_is_found_by_the_work_and_belongs_to_its_surface(pair):
    reported: list[float] = []
    found = inspect_dataset(pair[1], "default", DefectRecipe(), None, "form", progress=reported.append)
    assert found.mark == mosaic_mark(Dataset.open(pair[1]).result("default"))
    assert found.inspected_mm2 > 0.2
    assert found.simulated
    assert reported == sorted(reported)
    with pytest.raises(WaferViewerError, match="stopped"):
        inspect_dataset(pair[1], "default", DefectRecipe(), None, "form", should_stop=lambda: True)
    with pytest.raises(DatasetError, match="no golden die 'G'"):
        inspect_dataset(pair[1], "default", DefectRecipe(golden="G"), None, "form")


@pytest.mark.slow
def test_a_surface_without_dies_is_refused_and_compared_with_the_form_if_asked(pair):
    with pytest.raises(DiesNotFound, match="give pitch, origin and size of the dies instead"):
        inspect_dataset(pair[1], "default", DefectRecipe())
    found = inspect_dataset(pair[1], "default", DefectRecipe(), against="form")
    assert found.reference == "form"
    assert found.notes[0].startswith("Only what stands out of the fitted form is seen")
