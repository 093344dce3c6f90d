"""Frames that are removed after their time, by whom and when; holds; and a removal that is broken off."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.store.dataset.test_damaged_frames import take
from tests.support.datasets.samples import make_job, make_plan
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.damaged_frames import find_damage
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.retention import append_line, hold_end_line, hold_line, remove_frames
from wafer_viewer.store.dataset.scan_record import JOURNAL
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.records.manifest import deviations


@pytest.fixture
def scan(tmp_path):
    job = make_job(cols=3, n_frames=6)
    with DatasetWriter.create(tmp_path / "a.wafer", make_plan(job), job) as writer:
        take(writer)
    return tmp_path / "a.wafer"


def frames(path):
    return sorted(file.name for file in (path / "frames").iterdir())


def faults(path):
    return [fault for _, found in deviations(path) for fault in found]


def test_frames_go_and_everything_else_stays(scan):
    before = {p: p.read_bytes() for p in scan.iterdir() if p.name in ("scan.json", "flat-field.json")}
    journal, size = (scan / JOURNAL).read_bytes(), Dataset.open(scan).frame_bytes()
    told = []
    assert remove_frames(Dataset.open(scan), "Ann", 90, "disk full", told.append) == size
    assert told[-1] == 1.0
    assert frames(scan) == []
    assert {p: p.read_bytes() for p in before} == before
    assert (scan / JOURNAL).read_bytes().startswith(journal)
    assert faults(scan) == []
    data = Dataset.open(scan)
    assert (data.removed.by, data.removed.days, data.removed.n_files, data.removed.n_bytes) == ("Ann", 90, 3, size)
    report = data.check()
    assert report.ok
    assert (report.n_good, report.n_removed) == (0, 3)
    assert (report.missing, report.damaged, report.faults) == ((), (), ())
    assert find_damage(data) == []
    assert data.finished


def test_nothing_works_with_removed_frames_and_says_who_removed_them(scan):
    remove_frames(Dataset.open(scan), "Ann", 90)
    why = r"The frames of a\.wafer were removed by Ann on 20\d\d-\d\d-\d\d, after 90 days\."
    for use in (
        lambda: Dataset.open(scan).stack(1),
        lambda: DatasetWriter.resume(scan),
        lambda: Dataset.open(scan).compress(),
        lambda: hold_line(Dataset.open(scan), "Ann", "a reason"),
    ):
        with pytest.raises(DatasetError, match=why):
            use()
    assert frames(scan) == [], "a continued scan would have made the files anew"


def test_without_the_line_missing_files_are_lost(scan):
    (scan / "frames" / "r0000c0001.tif").unlink()
    report = Dataset.open(scan).check()
    assert not report.ok
    assert report.n_removed == 0


def test_a_killed_removal_is_known_and_finished_by_the_next(scan):
    size = Dataset.open(scan).frame_bytes()
    code = (
        "import os, signal, sys\n"
        "from wafer_viewer.store.dataset.dataset import Dataset\n"
        "from wafer_viewer.store.dataset.retention import remove_frames\n"
        "die = lambda done: os.kill(os.getpid(), signal.SIGKILL)\n"
        "remove_frames(Dataset.open(sys.argv[1]), 'Ann', 90, 'first', die)\n"
    )
    killed = subprocess.run([sys.executable, "-c", code, str(scan)], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert frames(scan) == ["r0000c0001.tif", "r0000c0002.tif"]
    half = Dataset.open(scan).check()
    assert half.ok
    assert (half.n_good, half.n_removed) == (12, 1)
    assert faults(scan) == []

    assert remove_frames(Dataset.open(scan), "Bob", 90, "second") == 2 * size // 3
    assert frames(scan) == []
    assert Dataset.open(scan).removed.by == "Ann", "it is recorded once, by who began it"
    assert (scan / JOURNAL).read_text().count("frames_removed") == 1
    assert faults(scan) == []


def test_a_stopped_removal_goes_on(scan):
    with pytest.raises(DatasetError, match="stopped at 1 of 3 files"):
        remove_frames(Dataset.open(scan), "Ann", 90, should_stop=lambda: len(frames(scan)) == 2)
    remove_frames(Dataset.open(scan), "Ann", 90)
    assert frames(scan) == []


def test_a_hold_keeps_the_frames_until_it_ends(scan):
    data = Dataset.open(scan)
    with pytest.raises(DatasetError, match="needs a reason"):
        hold_line(data, "Ann", "  ")
    with pytest.raises(DatasetError, match="is not held"):
        hold_end_line(data, "Ann", "a reason")
    append_line(data, hold_line(data, "Ann", "complaint\n 7"))
    assert (data.held.by, data.held.why) == ("Ann", "complaint 7")
    assert Dataset.open(scan).held == data.held
    assert faults(scan) == []
    for use in (lambda: remove_frames(Dataset.open(scan), "Bob", 90), lambda: hold_line(data, "Bob", "too")):
        with pytest.raises(DatasetError, match=r"a\.wafer is held by Ann.*: complaint 7"):
            use()
    append_line(data, hold_end_line(data, "Ann", "settled"))
    assert Dataset.open(scan).held is None
    remove_frames(Dataset.open(scan), "Bob", 90)
    assert frames(scan) == []


def test_an_unfinished_one_or_one_in_use_is_left_alone(scan, tmp_path):
    job = make_job(n_frames=6)
    with DatasetWriter.create(tmp_path / "b.wafer", make_plan(job), job):
        pass
    with pytest.raises(DatasetError, match="unfinished"):
        remove_frames(Dataset.open(tmp_path / "b.wafer"), "Ann", 90)
    lock = Lock.take(scan)
    with pytest.raises(DatasetError):
        remove_frames(Dataset.open(scan), "Ann", 90)
    lock.release()
    assert len(frames(scan)) == 3


def test_what_was_altered_before_is_not_signed_by_a_hold(scan):
    data = Dataset.open(scan)
    record = (scan / "scan.json").read_bytes()
    (scan / "scan.json").write_bytes(record.replace(b'"bits": 8', b'"bits": 9'))
    assert faults(scan) != []
    with pytest.raises(DatasetError):
        append_line(data, hold_line(data, "Ann", "a reason"))
    assert faults(scan) != []
