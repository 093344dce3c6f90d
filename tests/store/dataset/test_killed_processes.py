"""What killed processes leave behind: a folder that is no dataset yet, and parts of files that were being written."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.datasets.samples import make_job, make_plan
from wafer_viewer.model.errors import DatasetError, DiskFullError
from wafer_viewer.session.planning.revision_trial import stored_verdict_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io import atomic_files
from wafer_viewer.store.io.atomic_files import DEAD_AFTER_S, atomic_write, require_free, write_text

MAKING = """
import sys, pathlib, time
from wafer_viewer.store.dataset import writer
from tests.support.datasets.samples import make_job, make_plan
writer.write_record = lambda *_: time.sleep(600)
job = make_job()
writer.DatasetWriter.create(pathlib.Path(sys.argv[1]), make_plan(job), job)
"""


WRITING = """
import sys, pathlib, time
from wafer_viewer.store.io.atomic_files import atomic_write
with atomic_write(pathlib.Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    print("begun", flush=True)
    time.sleep(600)
"""


def killed_while_writing(path):
    """The part that a process left of a file, which was killed just now."""
    writer = subprocess.Popen([sys.executable, "-c", WRITING, str(path)], stdout=subprocess.PIPE)
    with writer:
        assert writer.stdout.readline() == b"begun\n"
        writer.kill()
    (part,) = path.parent.glob(f".{path.name}.*.part")
    return part


def aged(path, seconds=DEAD_AFTER_S + 60):
    then = time.time() - seconds
    os.utime(path, (then, then))


def create(path):
    job = make_job()
    return DatasetWriter.create(path, make_plan(job), job)


def no_space(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def half_made(tmp_path):
    """A folder whose maker is stopped before the record is written, and the maker."""
    path = tmp_path / "a.wafer"
    maker = subprocess.Popen([sys.executable, "-c", MAKING, str(path)])
    try:
        until = time.monotonic() + 60
        while len(list(path.glob("frames/*.tif"))) < 2 and time.monotonic() < until:
            time.sleep(0.05)
        time.sleep(0.2)
        yield path, maker
    finally:
        maker.kill()
        maker.wait()


@pytest.mark.slow
def test_a_name_is_free_again_after_its_maker_was_killed(half_made):
    path, maker = half_made
    aged(path)
    with pytest.raises(DatasetError, match="is being written by process"):
        create(path)
    maker.send_signal(signal.SIGKILL)
    maker.wait()
    aged(path)
    create(path).close()
    assert len(Dataset.open(path).fields) == 2


@pytest.mark.campaign
def test_a_name_is_free_at_once_after_its_maker_was_killed(half_made):
    path, maker = half_made
    maker.send_signal(signal.SIGKILL)
    maker.wait()
    os.utime(path)
    create(path).close()
    assert len(Dataset.open(path).fields) == 2


def test_a_folder_with_anything_of_somebody_is_never_removed(tmp_path):
    for name in ("notes.txt", "results/default", "scan.json"):
        path = tmp_path / f"{name.replace('/', '-')}.wafer"
        path.mkdir()
        (path / "frames").mkdir()
        (path / name).mkdir(parents=True)
        aged(path)
        with pytest.raises(DatasetError, match="exists already"):
            create(path)
        assert (path / name).exists()
    counted = tmp_path / "counted.wafer"
    counted.mkdir()
    (counted / "journal.jsonl").write_text("{}\n")
    aged(counted)
    with pytest.raises(DatasetError, match="exists already"):
        create(counted)


def test_dead_parts_are_removed_by_whoever_takes_the_dataset_next(tmp_path):
    create(tmp_path / "a.wafer").close()
    result = tmp_path / "a.wafer" / "results" / "default"
    (result / "surfaces").mkdir(parents=True)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    dead = result / f".mosaic.zarr.{gone.pid}-0a1b2c.part"
    dead_file = result / "surfaces" / f".r0000c0000.npz.{gone.pid}-0a1b2c.part"
    young = result / f".poses.npz.{gone.pid}-0a1b2c.part"
    alive = result / f".surface.json.{os.getpid()}-0a1b2c.part"
    (dead / "z_um" / "0").mkdir(parents=True)
    (dead / "z_um" / "0" / "zarr.json").write_text("{}")
    for path in (dead_file, young, alive):
        path.write_text("half")
    for path in (dead / "z_um" / "0" / "zarr.json", dead / "z_um" / "0", dead / "z_um", dead, dead_file, alive):
        aged(path)
    Lock.take(tmp_path / "a.wafer").release()
    assert not dead.exists()
    assert not dead_file.exists()
    assert young.exists(), "it may be that of a machine that works on the dataset, too"
    assert alive.exists()


def test_what_a_process_of_this_machine_left_is_removed_as_soon_as_it_is_gone(tmp_path):
    left = killed_while_writing(tmp_path / "a.ply")
    write_text(tmp_path / "a.ply", "whole")
    assert not left.exists()
    create(tmp_path / "a.wafer").close()
    taken = Lock.take(tmp_path / "a.wafer")
    left = killed_while_writing(tmp_path / "a.wafer" / "extra.json")
    taken.release()
    assert not left.exists(), "whoever works with a dataset has workers that may be killed meanwhile"


def test_a_lock_on_a_full_disk_is_refused_with_a_sentence_and_not_held(tmp_path, monkeypatch):
    create(tmp_path / "a.wafer").close()
    write = os.write

    def full(descriptor, content):
        if content:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, content)

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(DiskFullError, match=r"lock cannot be written: the disk is full: free some space"):
        Lock.take(tmp_path / "a.wafer")
    monkeypatch.undo()
    Lock.take(tmp_path / "a.wafer").release()


def test_a_lock_is_released_on_a_disk_that_does_not_take_an_empty_text(tmp_path, monkeypatch):
    create(tmp_path / "a.wafer").close()
    lock = Lock.take(tmp_path / "a.wafer")
    with monkeypatch.context() as full:
        full.setattr(os, "write", no_space)
        lock.release()
    assert not lock.held
    Lock.take(tmp_path / "a.wafer").release()


def test_a_verdict_that_finds_no_space_ends_with_a_sentence(tmp_path, monkeypatch):
    create(tmp_path / "a.wafer").close()
    monkeypatch.setattr(os, "write", no_space)
    with pytest.raises(DiskFullError, match=r"lock cannot be written: the disk is full: free some space"):
        stored_verdict_of(tmp_path / "a.wafer", "default")


@pytest.mark.parametrize("is_there", [False, True])
def test_a_folder_whose_name_does_not_reach_the_disk_is_not_there(tmp_path, monkeypatch, is_there):
    folder = tmp_path / "fields.ome.zarr"
    if is_there:
        folder.mkdir()
        (folder / "zarr.json").write_text("old")

    def write():
        with atomic_write(folder) as part:
            part.mkdir()
            (part / "zarr.json").write_text("new")

    with monkeypatch.context() as full:
        full.setattr(atomic_files, "to_disk", lambda path: no_space() if path == tmp_path else None)
        with pytest.raises(DiskFullError, match=r"fields\.ome\.zarr cannot be written: the disk is full"):
            write()
    assert [path.read_text() for path in tmp_path.rglob("*.json")] == ["old"] * is_there
    assert len(list(tmp_path.iterdir())) == is_there


def test_a_folder_whose_name_does_not_reach_a_disk_that_refuses_all_renames_is_not_there_either(tmp_path, monkeypatch):
    folder, renamed = tmp_path / "fields.ome.zarr", Path.rename
    with monkeypatch.context() as full:
        full.setattr(atomic_files, "to_disk", lambda path: no_space() if path == tmp_path else None)
        full.setattr(Path, "rename", lambda path, to: no_space() if path == folder else renamed(path, to))
        with (
            pytest.raises(DiskFullError, match=r"fields\.ome\.zarr cannot be written: the disk is full"),
            atomic_write(folder) as part,
        ):
            part.mkdir()
    assert not list(tmp_path.iterdir())


def test_what_is_left_of_a_killed_export_is_removed_by_the_next_one(tmp_path):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    dead, young = (tmp_path / f".[1] a.ply.{gone.pid}-{n}a1b2c.part" for n in "01")
    other, alive = tmp_path / f".b.ply.{gone.pid}-0a1b2c.part", tmp_path / f".[1] a.ply.{os.getpid()}-0a1b2c.part"
    for path in (dead, young, other, alive):
        path.write_text("half")
    for path in (dead, other, alive):
        aged(path)
    write_text(tmp_path / "[1] a.ply", "whole")
    assert {path.name for path in tmp_path.iterdir()} == {"[1] a.ply", young.name, other.name, alive.name}


def test_what_is_left_of_a_killed_export_is_removed_where_a_later_one_was_whole(tmp_path):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    whole, dead = tmp_path / "a.ome.zarr", tmp_path / f".a.ome.zarr.{gone.pid}-0a1b2c.part"
    whole.mkdir()
    dead.write_text("half")
    aged(dead)
    with pytest.raises(DatasetError, match=r"a\.ome\.zarr exists already: give the name of a new folder"):
        require_free(whole)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ome.zarr"]
