from __future__ import annotations

import threading
from concurrent.futures import Future
from pathlib import Path

import pytest

from wafer_viewer.model.errors import PlanError, WaferViewerError
from wafer_viewer.session.core.command_queue import ANNOUNCE_EVERY_S, CommandQueue
from wafer_viewer.session.state.snapshot import Snapshot


@pytest.fixture
def command_queue():
    made = CommandQueue(Snapshot())
    yield made
    made.close()


def test_verbs_run_in_order_on_one_thread(command_queue):
    observed = []
    requested = [command_queue.do(lambda i=i: observed.append((i, threading.get_ident()))) for i in range(50)]
    for answer in requested:
        answer.result(5)
    assert [i for i, _ in observed] == list(range(50))
    assert len({thread for _, thread in observed}) == 1


def test_an_error_of_a_verb_comes_out_of_its_result_and_the_next_verb_still_runs(command_queue):
    def refuse():
        raise PlanError("no")

    failed, fine = command_queue.do(refuse), command_queue.do(lambda: 7)
    with pytest.raises(PlanError, match="no"):
        failed.result(5)
    assert fine.result(5) == 7


def test_a_verb_that_answers_with_a_future_is_done_when_that_is(command_queue):
    later = Future()
    answer = command_queue.do(lambda: later)
    command_queue.do(lambda: None).result(5)
    assert not answer.done()
    later.set_result("there")
    assert answer.result(5) == "there"


def test_a_chained_command_gets_the_value_or_the_error(command_queue):
    first, failing = Future(), Future()
    assert not (then := command_queue.then(first, lambda value: value + 1)).done()
    first.set_result(1)
    assert then.result(5) == 2
    after = command_queue.then(failing, lambda value: pytest.fail("must not run"))
    failing.set_exception(PlanError("stopped"))
    with pytest.raises(PlanError):
        after.result(5)


def test_listeners_hear_the_last_change_of_a_burst_and_not_every_one(command_queue):
    heard, last = [], threading.Event()

    def listen(snapshot):
        heard.append(snapshot)
        if snapshot.data_folder == Path("99"):
            last.set()

    leave = command_queue.subscribe(listen)
    for i in range(100):
        command_queue.do(command_queue.change, data_folder=Path(str(i))).result(5)
    assert last.wait(10 * ANNOUNCE_EVERY_S + 5)
    assert len(heard) < 100
    leave()
    before = len(heard)
    command_queue.do(command_queue.change, data_folder=Path("left")).result(5)
    assert len(heard) == before


def test_a_snapshot_is_frozen_and_versions_rise(command_queue):
    before = command_queue.snapshot
    command_queue.do(command_queue.change, compute_ready=True).result(5)
    assert not before.compute_ready
    assert command_queue.snapshot.compute_ready
    assert command_queue.snapshot.version == before.version + 1


def test_waiting_times_out_with_a_message(command_queue):
    with pytest.raises(TimeoutError, match=r"within 0\.01 s"):
        command_queue.wait_until(lambda snapshot: snapshot.compute_ready, 0.01)


def test_a_closed_desk_refuses(command_queue):
    command_queue.close()
    with pytest.raises(WaferViewerError, match="closed"):
        command_queue.do(lambda: None).result(5)
