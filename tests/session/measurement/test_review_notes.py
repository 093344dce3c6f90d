"""The notebook: views kept, renamed, deleted, judgements; undo; on the disk at every change."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.job import SavedView
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.files.file_jobs import Documents
from wafer_viewer.session.measurement.results import NotebookController
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.store.records.inspection_records import read_notebook

VIEW = SavedView(position_mm=(0.0, -3.0, 2.0), look_at_mm=(0.0, 0.0, 0.0), range_um=(-1.5, 9.0))


class Bench:
    """A desk, a library with one open dataset, and the notebook on it."""

    def __init__(self, folder, read_only=None):
        self.command_queue = CommandQueue(Snapshot(dataset=object()))
        self.folder = folder
        shown = SimpleNamespace(read_only=read_only, path=folder / "coupon.wafer")
        self.library = SimpleNamespace(result=SimpleNamespace(path=folder / "result"), shown=shown)
        self.open()

    def open(self):
        self.verbs = NotebookController(self.command_queue, self.library)
        self.command_queue.do(self.verbs.open).result()

    @property
    def names(self):
        return [(v.number, v.name) for v in self.command_queue.snapshot.notebook.book.views]


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.command_queue.close()


def test_views_are_numbered_named_and_there_again_after_opening(bench):
    bench.verbs.save_view(VIEW).result()
    bench.verbs.rename_view(1, "  The edge ").result()
    bench.verbs.save_view(VIEW).result()
    assert bench.names == [(1, "The edge"), (2, "View 2")]
    bench.open()
    assert bench.names == [(1, "The edge"), (2, "View 2")]
    assert bench.command_queue.snapshot.notebook.book.views[0].range_um == (-1.5, 9.0)


def test_a_deleted_view_leaves_its_number_and_comes_back_with_undo(bench):
    for _ in range(3):
        bench.verbs.save_view(VIEW).result()
    bench.verbs.delete_view(2).result()
    assert [n for n, _ in bench.names] == [1, 3]
    bench.verbs.undo().result()
    assert [n for n, _ in bench.names] == [1, 2, 3]
    bench.verbs.redo().result()
    assert bench.verbs.save_view(VIEW).result().number == 2
    assert not bench.command_queue.snapshot.notebook.can_redo


def test_a_judgement_keeps_its_note_when_the_verdict_changes(bench):
    bench.verbs.judge("result 3", "accepted", " burr at the left ").result()
    bench.verbs.judge("result 3", "rejected").result()
    judged = bench.command_queue.snapshot.notebook.book.judgement("result 3")
    assert (judged.verdict, judged.note) == ("rejected", "burr at the left")
    assert bench.command_queue.snapshot.notebook.book.judgement("result 4").verdict == "open"
    stored = read_notebook(bench.folder / "result").judgements
    assert stored == (judged,)


def test_the_same_judgement_twice_is_one_step_of_undo(bench):
    for _ in range(2):
        bench.verbs.judge("result 1", "accepted").result()
    bench.verbs.undo().result()
    assert not bench.command_queue.snapshot.notebook.can_undo


def test_what_can_only_be_read_is_not_written_to(tmp_path):
    bench = Bench(tmp_path, read_only="another Wafer Viewer holds it.")
    with pytest.raises(DatasetError, match="another Wafer Viewer"):
        bench.verbs.save_view(VIEW).result()
    assert not (tmp_path / "result").exists()
    bench.command_queue.close()


def test_a_notebook_that_is_none_is_reported_by_its_name(bench):
    bench.verbs.save_view(VIEW).result()
    (bench.folder / "result" / "notebook.json").write_text(json.dumps({"views": 3}))
    with pytest.raises(DatasetError, match=r"notebook.json"):
        read_notebook(bench.folder / "result")


def test_pictures_are_numbered_next_to_the_dataset(bench):
    papers = Documents(bench.command_queue, bench.library, None)
    first, second = (papers.keep_picture(png).result() for png in (b"one", b"two"))
    assert (first.name, second.name) == ("coupon-picture-1.png", "coupon-picture-2.png")
    assert second.read_bytes() == b"two"
