"""Locks on disks that have none of the operating system, of killed processes, and of machines that were renamed."""

from __future__ import annotations

import errno
import fcntl
import json
import multiprocessing
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import pytest

from tests.support.datasets.samples import make_job, make_plan
from tests.support.paths import ROOT
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Spec
from wafer_viewer.store.dataset.integrity import KINDS
from wafer_viewer.store.dataset.lock import Holder, Lock, holder_of
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io import file_lock
from wafer_viewer.store.io.file_lock import Process, is_locked, locked, this_process, try_lock
from wafer_viewer.store.records.signed_log import append_record, read_log

UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
TAKE = (
    "import os, sys, pathlib; from wafer_viewer.store.dataset.lock import Lock; Lock.take(pathlib.Path(sys.argv[1])); "
)
KILLED = "os.kill(os.getpid(), 9)"
RENAMED = "import socket; socket.gethostname = lambda: 'box1'; "
WITHOUT_LOCKS = (
    "import errno, fcntl\ndef refuse(*_): raise OSError(errno.ENOLCK, 'No locks available')\nfcntl.flock = refuse\n"
)
NO_FLOCK = """
#include <errno.h>
int flock(int descriptor, int operation) { (void)descriptor; (void)operation; errno = ENOLCK; return -1; }
"""


class Entry(Spec, frozen=True, kw_only=True):
    error: ClassVar[type[WaferViewerError]] = DatasetError
    n: int


def refuse_with(number):
    def flock(*_):
        raise OSError(number, os.strerror(number))

    return flock


@pytest.fixture(params=UNSUPPORTED, ids=errno.errorcode.get)
def without_locks(request, monkeypatch):
    """A disk whose locks are refused in one of the ways that there are."""
    monkeypatch.setattr(fcntl, "flock", refuse_with(request.param))


def run(code, folder, **more):
    return subprocess.run([sys.executable, "-c", code, str(folder)], check=False, cwd=ROOT, timeout=120, **more)


def test_disk_without_locks_is_written_by_one_process_at_a_time(tmp_path, without_locks):
    append_record(tmp_path / "log.jsonl", Entry(n=1))
    lock = Lock.take(tmp_path)
    assert holder_of(tmp_path).pid == os.getpid()
    with pytest.raises(DatasetError, match=f"is being written by process {os.getpid()} on "):
        Lock.take(tmp_path)
    lock.release()
    assert holder_of(tmp_path) is None
    Lock.take(tmp_path).release()
    assert [path.name for path in tmp_path.iterdir() if "held" in path.name] == []


def test_other_faults_of_a_lock_are_not_taken_for_another_process(tmp_path, monkeypatch):
    monkeypatch.setattr(fcntl, "flock", refuse_with(errno.EIO))
    with pytest.raises(DatasetError, match=r"lock cannot be written: input/output error"):
        Lock.take(tmp_path)
    monkeypatch.setattr(fcntl, "flock", refuse_with(errno.EWOULDBLOCK))
    with (
        pytest.raises(DatasetError, match="is held by another program: wait until it is done"),
        locked(tmp_path / "x.lock", most_s=0.1),
    ):
        pass


def test_killed_process_keeps_no_lock_of_a_disk_without_locks(tmp_path, without_locks):
    assert run(WITHOUT_LOCKS + TAKE + KILLED, tmp_path).returncode == -9
    assert [path for path in tmp_path.iterdir() if path.name.startswith("lock.held-")]
    assert holder_of(tmp_path) is None
    Lock.take(tmp_path).release()


@pytest.mark.campaign(at_least_one=True)
def test_name_is_free_again_after_its_maker_was_killed_on_a_disk_without_locks(tmp_path, without_locks):
    folder = tmp_path / "a.wafer"
    folder.mkdir()
    assert run(WITHOUT_LOCKS + TAKE + KILLED, folder).returncode == -9
    (folder / "frames").mkdir()
    job = make_job()
    with DatasetWriter.create(folder, make_plan(job), job):
        unknown = [name for name in names_in(folder) if not any(kind.pattern.fullmatch(name) for kind in KINDS)]
        assert unknown == []


def names_in(folder):
    return [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]


def test_announcement_of_another_machine_is_believed_and_the_way_out_is_named(tmp_path, without_locks):
    foreign = tmp_path / "lock.held-7-aaaa"
    foreign.write_text(json.dumps({"pid": 7, "host": "elsewhere", "boot": "another"}))
    with pytest.raises(DatasetError, match=rf"is held by .*: when that process is gone, delete the file {foreign}"):
        Lock.take(tmp_path)
    with (
        pytest.raises(DatasetError, match=f"held by process 7 on elsewhere: .* delete {foreign}"),
        locked(tmp_path / "lock", most_s=0.1),
    ):
        pass
    foreign.write_text("torn")
    assert try_lock(tmp_path / "lock") is None
    foreign.unlink()
    Lock.take(tmp_path).release()


def test_lock_of_the_operating_system_gives_way_to_an_announcement(tmp_path):
    (tmp_path / "lock.held-1-aaaa").write_text(json.dumps({"pid": 1, "host": "elsewhere", "boot": "another"}))
    assert try_lock(tmp_path / "lock") is None
    assert is_locked(tmp_path / "lock")


def append_without_locks(path, first):
    fcntl.flock = refuse_with(errno.ENOLCK)
    for n in range(first, first + 10):
        append_record(path, Entry(n=n))


@pytest.mark.slow
def test_programs_without_locks_wait_for_each_other(tmp_path):
    path = tmp_path / "log.jsonl"
    append_record(path, Entry(n=0))
    start = multiprocessing.get_context("spawn").Process
    processes = [start(target=append_without_locks, args=(path, n)) for n in (10, 20, 30)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(120)
        assert process.exitcode == 0
    assert sorted(entry.n for entry in read_log(path, Entry).records) == [0, *range(10, 40)]


def test_program_on_a_disk_without_flock_takes_and_leaves_its_lock(tmp_path):
    library, source = tmp_path / "noflock.so", tmp_path / "noflock.c"
    source.write_text(NO_FLOCK)
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source], check=True, timeout=120)
    environment = {**os.environ, "LD_PRELOAD": str(library)}
    look = "print(sorted(p.name[:10] for p in pathlib.Path(sys.argv[1]).glob('lock*')))"
    folder = tmp_path / "data"
    folder.mkdir()
    done = run(TAKE + look, folder, env=environment, capture_output=True, text=True)
    assert done.stdout.strip() == "['lock', 'lock.held-']", done.stderr
    assert holder_of(folder) is None
    Lock.take(folder).release()


def test_dead_lock_of_a_machine_that_was_renamed_is_taken_over(tmp_path):
    assert run(RENAMED + TAKE + KILLED, tmp_path).returncode == -9
    left = json.loads((tmp_path / "lock").read_text())
    assert (left["host"], left["boot"]) == ("box1", this_process().boot)
    assert holder_of(tmp_path) is None
    Lock.take(tmp_path).release()


def test_live_lock_of_a_machine_that_was_renamed_is_kept(tmp_path):
    code = RENAMED + TAKE + "print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", code, tmp_path], stdin=-1, stdout=-1, cwd=ROOT) as other:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(DatasetError, match=f"is being written by process {other.pid} on box1"):
            Lock.take(tmp_path)
        other.kill()


def test_lock_of_another_boot_is_believed_on_another_host_only(tmp_path):
    before = {"pid": 7, "host": "box1", "since": "then", "boot": "another", "start": "1"}
    (tmp_path / "lock").write_text(json.dumps(before))
    assert holder_of(tmp_path) == Holder(**before)
    with pytest.raises(DatasetError, match=r"held by process 7 on box1.*delete the file"):
        Lock.take(tmp_path)
    (tmp_path / "lock").write_text(json.dumps({**before, "host": socket.gethostname()}))
    Lock.take(tmp_path).release()


def test_process_is_gone_when_its_number_belongs_to_another_one():
    own = this_process()
    assert not own.is_gone
    assert Process(pid=own.pid, host=own.host, boot=own.boot, space=own.space, start="1").is_gone
    with subprocess.Popen([sys.executable, "-c", "pass"]) as ended:
        ended.wait()
    assert Process(pid=ended.pid, host="x", boot=own.boot, space=own.space, start="1").is_gone
    for unknown in ({"boot": "another"}, {"space": "pid:[1]"}, {"start": ""}, {"boot": ""}):
        facts = {"pid": ended.pid, "host": "x", "boot": own.boot, "space": own.space, "start": "1", **unknown}
        assert not Process(**facts).is_gone, unknown


def test_lock_says_whether_the_disk_has_locks(tmp_path):
    lock = try_lock(tmp_path / "x")
    assert lock is not None
    assert lock.announcement is None
    lock.release()
    assert file_lock.announced(Path(tmp_path / "x")) == {}
