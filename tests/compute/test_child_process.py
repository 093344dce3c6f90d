"""A process beside this one works on its own and ends with what it helps; a pipe that fails ends its child."""

from __future__ import annotations

import os
import time
from concurrent.futures import Future
from functools import partial
from multiprocessing import Pipe
from pathlib import Path

import pytest

from wafer_viewer.compute import child_process
from wafer_viewer.compute.child_process import ChildConnection, ChildDied, ChildProcess, Reply, Request, alongside


def write_own_number(path: Path) -> None:
    path.with_suffix(".new").write_text(str(os.getpid()))
    path.with_suffix(".new").replace(path)


def write_and_never_end(path: Path) -> None:
    write_own_number(path)
    while True:
        time.sleep(60)


def test_work_alongside_runs_in_another_process_and_ends_with_the_block(tmp_path, patience_s):
    told = tmp_path / "number"
    with alongside(partial(write_and_never_end, told)):
        give_up = time.monotonic() + patience_s
        while not told.exists() and time.monotonic() < give_up:
            time.sleep(0.01)
        number = int(told.read_text())
        assert number != os.getpid()
        os.kill(number, 0)
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


def double(pipe):
    """Reply to each request twice, and once to one that was never sent."""
    end = ChildConnection(pipe)
    end.tell("ready")
    for request in end.requests():
        end.answer(request, 2 * request.command)
        end.answer(request, "again")
        end.tell(Reply(request.number + 1000, "unasked"))


def deaf_child(pipe):
    ChildConnection(pipe).tell("ready")
    time.sleep(600)


def test_second_reply_and_unknown_request_number_are_ignored(patience_s, caplog):
    child = ChildProcess("doubled", double, (), lambda event: None, lambda code: None)
    try:
        assert [child.ask(n).result(patience_s) for n in (1, 2, 3)] == [2, 4, 6]
        assert child.alive
    finally:
        child.close()
    assert "replied to request 1 twice" in caplog.text


def test_reader_that_fails_counts_as_a_dead_child(patience_s, monkeypatch, caplog):
    monkeypatch.setattr(child_process, "PATIENCE_S", 0.1)
    gone = Future()
    child = ChildProcess("unheard", deaf_child, (), {}.__getitem__, gone.set_result)
    assert gone.result(patience_s) is not None
    assert not child.process.is_alive()
    with pytest.raises(ChildDied):
        child.ask(1).result(patience_s)
    assert "could not be dealt with" in caplog.text
    child.close()


def test_requests_that_came_early_are_not_lost_and_the_end_is_seen():
    ours, theirs = Pipe()
    end = ChildConnection(theirs)
    assert not end.is_closed()
    for number in (1, 2):
        ours.send(Request(number, "do"))
        assert not end.is_closed()
    ours.send(None)
    assert end.is_closed()
    assert [request.number for request in end.requests()] == [1, 2]


def test_end_of_the_viewer_is_seen():
    ours, theirs = Pipe()
    end = ChildConnection(theirs)
    ours.close()
    assert end.is_closed()
    assert list(end.requests()) == []
