"""A dataset with an index of its journal is the dataset that its journal tells of."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.datasets.samples import SUMMARY, all_shots, make_frame, make_job, make_plan
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset import dataset as dataset_module
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_lines import INDEX, JournalIndex
from wafer_viewer.store.dataset.integrity import check_files
from wafer_viewer.store.dataset.scan_record import (
    JOURNAL,
    FaultNoted,
    Finished,
    FocusAtEnd,
    FrameKept,
    JournalWriter,
    Missed,
    PassBegun,
    PassEnded,
    ScanRecord,
    WindowChanged,
    write_record,
)
from wafer_viewer.store.dataset.writer import DatasetWriter

FIELDS, FRAMES = 3, 4


def make_record(path):
    job = make_job(cols=FIELDS, n_frames=FRAMES)
    path.mkdir()
    write_record(path, ScanRecord(software_version="test", taken="2026-01-01T00:00:00", job=job, plan=make_plan(job)))
    return path


def random_lines(rng, n):
    """Lines of passes as they come: frames taken twice, misses, changed windows, passes that were broken off."""
    lines = []
    for i in range(n):
        shot = Shot(int(rng.integers(1, FIELDS + 1)), int(rng.integers(FRAMES)))
        frame = FrameKept(shot, i, 1.5 * i, -0.1 * i, 0.3 * i, 100.0, 1000 * i, int(rng.integers(2**32)))
        others = (
            Missed(shot, i, f"why {i}"),
            PassBegun(i, "z", FRAMES, "now", bool(rng.random() < 0.7)),
            PassEnded(i, SUMMARY, "now"),
            FaultNoted(f"fault {i}", "now"),
            FocusAtEnd(shot.field, True, bool(rng.random() < 0.5)),
            WindowChanged(shot.field, float(i), int(rng.choice([3, 4])), i, "now"),
            Finished("now"),
        )
        p = np.array([0.1, 0.1, 0.1, 0.03, 0.03, 0.04, 0.03])
        lines.append(frame if rng.random() > p.sum() else others[rng.choice(len(p), p=p / p.sum())])
    return lines


def append(path, lines):
    journal = JournalWriter(path / JOURNAL)
    for line in lines:
        journal.write(line)
    journal.close()


def state_of(data):
    """All that a dataset tells of its journal."""
    return {
        "scan": data.scan,
        "kept": data.kept(),
        "arrived": data.arrived(),
        "missing": data.missing(),
        "missed": data.missed(),
        "ever missed": data.ever_missed(),
        "complete": data.complete_fields(),
        "faults": data.faults,
        "focus": data.focus_at_end(),
        "finished": data.finished,
        "lines": {field.number: data.journal_lines(field) for field in data.fields},
    }


@pytest.mark.parametrize("seed", range(12))
def test_an_index_changes_nothing_wherever_it_was_made(tmp_path, monkeypatch, seed):
    rng = np.random.default_rng(seed)
    path = make_record(tmp_path / "a.wafer")
    n_indexed = 0
    for _ in range(6):
        append(path, random_lines(rng, 25))
        with monkeypatch.context() as patch:
            patch.setattr(dataset_module, "LONG_LINES", 1)
            indexed = Dataset.open(path)
            again = Dataset.open(path)
        n_indexed += JournalIndex.read(path / JOURNAL) is not None
        with monkeypatch.context() as patch:
            patch.setattr(JournalIndex, "read", lambda _: None)
            plain = Dataset.open(path)
        assert state_of(indexed) == state_of(plain)
        assert state_of(again) == state_of(plain)
    assert n_indexed > 0


@pytest.fixture
def indexed(tmp_path, monkeypatch):
    monkeypatch.setattr(dataset_module, "LONG_LINES", 5)
    job = make_job()
    plan = make_plan(job)
    with DatasetWriter.create(tmp_path / "a.wafer", plan, job) as writer:
        for shot in all_shots(plan):
            writer.frame(make_frame(shot, plan))
    Dataset.open(tmp_path / "a.wafer")
    assert (tmp_path / "a.wafer" / INDEX).exists()
    return tmp_path / "a.wafer"


def test_frames_are_read_and_checked_by_the_index(indexed):
    data = Dataset.open(indexed)
    with_index = data.stack(1)
    (indexed / INDEX).unlink()
    plain = Dataset.open(indexed).stack(1)
    np.testing.assert_array_equal(with_index.images, plain.images)
    np.testing.assert_array_equal(with_index.z_um, plain.z_um)
    assert with_index.checksum == plain.checksum
    report = Dataset.open(indexed).check()
    assert report.ok
    assert report.n_good == len(data.kept())
    assert [kind.n_good for kind in report.files if kind.title == "Index of the journal"] == [1]


def test_a_damaged_line_is_named_in_spite_of_the_index(indexed):
    content = bytearray((indexed / JOURNAL).read_bytes())
    content[content.index(b'"frame"') + 2] ^= 1
    (indexed / JOURNAL).write_bytes(content)
    with pytest.raises(DatasetError, match="is damaged in line"):
        Dataset.open(indexed)


def test_a_damaged_index_is_not_read_and_check_says_what_to_do(indexed):
    before = state_of(Dataset.open(indexed))
    content = bytearray((indexed / INDEX).read_bytes())
    content[len(content) // 2] ^= 1
    (indexed / INDEX).write_bytes(content)
    assert JournalIndex.read(indexed / JOURNAL) is None
    sentences = [sentence for kind in check_files(indexed) for sentence in kind.damaged]
    assert len(sentences) == 1
    assert sentences[0].endswith("journal.index.npz is damaged, its checksum differs: remove it: it is made again from "
                                 "the journal.")  # fmt: skip
    assert state_of(Dataset.open(indexed)) == before
    assert JournalIndex.read(indexed / JOURNAL) is not None


def test_a_journal_that_was_cut_has_no_index(indexed):
    lines = (indexed / JOURNAL).read_bytes().splitlines(keepends=True)
    (indexed / JOURNAL).write_bytes(b"".join(lines[:-3]))
    assert JournalIndex.read(indexed / JOURNAL) is None
    assert len(Dataset.open(indexed).kept()) < 8


def test_short_journals_have_no_index_and_folders_that_take_none_are_opened(tmp_path, monkeypatch, indexed):
    path = make_record(tmp_path / "b.wafer")
    append(path, [PassBegun(0, "z", FRAMES, "now"), *[FrameKept(Shot(1, 0), 0, 0.0, 0.0, 0.0, 1.0, 0, 0)] * 3])
    assert Dataset.open(path).kept() == {Shot(1, 0)}
    assert not (path / INDEX).exists()

    def full(*_):
        raise DatasetError("the disk is full")

    monkeypatch.setattr(JournalIndex, "write", full)
    (indexed / INDEX).unlink()
    assert len(Dataset.open(indexed).kept()) == 8
    assert not (indexed / INDEX).exists()
