from __future__ import annotations

import threading
from concurrent.futures import Future
from pathlib import Path

import pytest

from wafer_viewer.model.errors import PlanError, WaferViewerError
from wafer_viewer.session.core.command_queue import ANNOUNCE_EVERY_S, CommandQueue
from wafer_viewer.session.state.snapshot import Snapshot


@pytest.fixture
def desk():
    made = CommandQueue(Snapshot())
    yield made
    made.close()


def test_verbs_run_in_order_on_one_thread(desk):
    seen = []
    asked = [desk.do(lambda i=i: seen.append((i, threading.get_ident()))) for i in range(50)]
    for answer in asked:
        answer.result(5)
    assert [i for i, _ in seen] == list(range(50))
    assert len({thread for _, thread in seen}) == 1


def test_an_error_of_a_verb_comes_out_of_its_result_and_the_next_verb_still_runs(desk):
    def refuse():
        raise PlanError("no")

    failed, fine = desk.do(refuse), desk.do(lambda: 7)
    with pytest.raises(PlanError, match="no"):
        failed.result(5)
    assert fine.result(5) == 7


def test_a_verb_that_answers_with_a_future_is_done_when_that_is(desk):
    later = Future()
    answer = desk.do(lambda: later)
    desk.do(lambda: None).result(5)
    assert not answer.done()
    later.set_result("there")
    assert answer.result(5) == "there"


def test_what_comes_then_gets_the_value_or_is_left_out(desk):
    first, failing = Future(), Future()
    assert not (then := desk.then(first, lambda value: value + 1)).done()
    first.set_result(1)
    assert then.result(5) == 2
    after = desk.then(failing, lambda value: pytest.fail("must not run"))
    failing.set_exception(PlanError("stopped"))
    with pytest.raises(PlanError):
        after.result(5)


def test_listeners_hear_the_last_change_of_a_burst_and_not_every_one(desk):
    heard, last = [], threading.Event()

    def listen(snapshot):
        heard.append(snapshot)
        if snapshot.data_folder == Path("99"):
            last.set()

    leave = desk.subscribe(listen)
    for i in range(100):
        desk.do(desk.change, data_folder=Path(str(i))).result(5)
    assert last.wait(10 * ANNOUNCE_EVERY_S + 5)
    assert len(heard) < 100
    leave()
    before = len(heard)
    desk.do(desk.change, data_folder=Path("left")).result(5)
    assert len(heard) == before


def test_a_snapshot_is_frozen_and_versions_rise(desk):
    before = desk.snapshot
    desk.do(desk.change, compute_ready=True).result(5)
    assert not before.compute_ready
    assert desk.snapshot.compute_ready
    assert desk.snapshot.version == before.version + 1


def test_waiting_for_what_does_not_come_says_so(desk):
    with pytest.raises(TimeoutError, match=r"within 0\.01 s"):
        desk.wait_until(lambda snapshot: snapshot.compute_ready, 0.01)


def test_a_closed_desk_refuses(desk):
    desk.close()
    with pytest.raises(WaferViewerError, match="closed"):
        desk.do(lambda: None).result(5)
