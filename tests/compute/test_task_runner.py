"""Crews: the same work in this process, on threads, and on workers that may be killed."""

from __future__ import annotations

import os
import threading
from contextlib import closing

import psutil
import pytest
from distributed.comm import CommClosedError

from tests.support.datasets import worker_tasks
from wafer_viewer.compute import dask_cluster
from wafer_viewer.compute.compute_client import Compute
from wafer_viewer.compute.crews import crew_for
from wafer_viewer.compute.messages import Progressed, WarmUp
from wafer_viewer.compute.task_runner import DaskRunner, LocalRunner
from wafer_viewer.compute.worker_environment import FORKS
from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.session.surface.kernel_build import WARM_UP


@pytest.fixture(scope="module")
def cluster():
    with crew_for(workers=2) as crew:
        yield crew


@pytest.fixture(params=["serial", "threads", pytest.param("cluster", marks=pytest.mark.slow)])
def crew(request):
    match request.param:
        case "serial":
            return LocalRunner()
        case "threads":
            return LocalRunner(threads=3)
        case _:
            return request.getfixturevalue("cluster")


def items(count):
    return [(number,) for number in range(count)]


def test_every_item_is_done_once(crew):
    done = list(crew.each(worker_tasks.square, items(50)))
    assert sorted((d.index, d.value) for d in done) == [(i, i * i) for i in range(50)]
    assert list(crew.each(worker_tasks.square, [])) == []


def test_a_fault_is_the_items_own(crew):
    done = {d.index: d for d in crew.each(worker_tasks.square_or_fault, items(7))}
    assert {i for i, d in done.items() if d.fault} == {0, 3, 6}
    assert isinstance(done[3].fault, DatasetError)
    assert str(done[3].fault) == "3 is divisible by three."
    assert [done[i].value for i in (1, 2, 4, 5)] == [1, 4, 16, 25]


def test_a_stopped_run_reports_its_progress_and_starts_no_tasks(crew, tmp_path):
    some = [(tmp_path, number) for number in range(1000)]
    seen = []
    with pytest.raises(ComputeError, match=r"stopped at \d+ of 1000"):
        seen.extend(crew.each(worker_tasks.keep, some, should_stop=lambda: len(list(tmp_path.iterdir())) > 5))
    left = len(list(tmp_path.iterdir()))
    assert 5 < left < 100
    assert next(crew.each(worker_tasks.square, items(1))).value == 0
    assert len(list(tmp_path.iterdir())) == left


def test_a_runner_without_a_consumer_stops(crew, tmp_path):
    with closing(crew.each(worker_tasks.keep, [(tmp_path, number) for number in range(1000)])) as outcomes:
        next(outcomes)
    left = len(list(tmp_path.iterdir()))
    assert left < 100
    assert next(crew.each(worker_tasks.square, items(1))).value == 0
    assert len(list(tmp_path.iterdir())) == left


@pytest.mark.slow
def test_a_worker_keeps_freed_memory_for_the_next_array(cluster):
    (done,) = cluster.each(worker_tasks.said_to_the_process, [("MALLOC_TRIM_THRESHOLD_",)])
    assert int(done.value) > 2**20


@pytest.mark.slow
def test_workers_are_set_up_alike_beside_another_cluster_which_keeps_its_settings(monkeypatch):
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")  # as another dask cluster of this process leaves it
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    with crew_for(workers=2) as crew:
        asked = [("MALLOC_TRIM_THRESHOLD_",), ("OMP_NUM_THREADS",)]
        told = {done.index: done.value for done in crew.each(worker_tasks.said_to_the_process, asked)}
    assert told == {0: str(256 * 2**20), 1: "1"}
    assert os.environ["MALLOC_TRIM_THRESHOLD_"] == "65536"
    assert "OMP_NUM_THREADS" not in os.environ


@pytest.mark.slow
def test_a_bug_ends_its_task_on_a_worker_and_everything_here(cluster):
    assert "TypeError: seven" in str(next(cluster.each(worker_tasks.square_or_fault, [(7,)])).fault)
    with pytest.raises(TypeError):
        list(LocalRunner().each(worker_tasks.square_or_fault, [(7,)]))


@pytest.mark.campaign
def test_a_task_that_ends_its_workers_is_named_and_those_beside_it_are_done(cluster):
    done = {d.index: d for d in cluster.each(worker_tasks.square_or_die, items(12))}
    assert "square_or_die of item 6 of 12 ended its worker 4 times" in str(done.pop(5).fault)
    assert {i: d.value for i, d in done.items()} == {i: i * i for i in range(12) if i != 5}


@pytest.mark.slow
def test_a_killed_worker_costs_nothing_but_time(cluster):
    killed = []
    for done in cluster.each(worker_tasks.work_a_while, items(100)):
        assert done.fault is None
        if not killed:
            killed.append(done.value)
            psutil.Process(done.value).kill()
    assert killed


def test_a_cluster_whose_worker_ends_while_it_starts_is_one_sentence(monkeypatch):
    def ended(**_):
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr(dask_cluster, "LocalCluster", ended)
    sentence = r"no cluster at this machine: Nanny failed to start\. Try again"
    with pytest.raises(ComputeError, match=sentence), dask_cluster.client_of(None, 2):
        pass


class Answering:
    """Client of a cluster whose workers answer every question as given."""

    def __init__(self, *answers):
        self._answers = dict(enumerate(answers))

    def run(self, *_, **__):
        return self._answers


def test_a_worker_that_ended_while_it_was_asked_hides_no_other_that_does_not_fit():
    crew = DaskRunner(Answering(CommClosedError("Stream is closed"), "bench-2 runs version 0.0.1"))
    with pytest.raises(ComputeError, match=r"^bench-2 runs version 0\.0\.1$"):
        crew.require_same_program()


def test_a_worker_of_a_version_that_cannot_answer_is_told():
    crew = DaskRunner(Answering(ModuleNotFoundError("No module named 'wafer_viewer.compute.dask_worker'")))
    with pytest.raises(ComputeError, match=r"cannot say whether it fits .*: install the same version there"):
        crew.require_same_program()


def test_an_open_scheduler_is_refused():
    with pytest.raises(ComputeError, match="must begin with tls://"), crew_for("tcp://127.0.0.1:8786"):
        pass


@pytest.mark.campaign
def test_a_work_is_led_by_the_host_while_single_tasks_go_first(patience_s):
    heard, moving = [], threading.Event()

    def hear(event):
        heard.append(event)
        if isinstance(event, Progressed) and event.work == "endless":
            moving.set()

    compute = Compute(None, WARM_UP, hear, lambda code: None)
    try:
        assert compute.lead("squares", worker_tasks.lead_squares, 200).result(patience_s) == sum(
            i * i for i in range(200)
        )
        assert Progressed("squares", 1.0) in heard
        endless = compute.lead("endless", worker_tasks.lead_for_ever)
        assert moving.wait(patience_s)
        waiting = compute.lead("waiting", worker_tasks.lead_squares, 3)
        compute.run("single", worker_tasks.lead_squares_alone, 4).result(patience_s)
        assert not waiting.done()
        compute.cancel("endless")
        with pytest.raises(ComputeError, match="was stopped at"):
            endless.result(patience_s)
        assert waiting.result(patience_s) == 5
    finally:
        compute.close()


@pytest.mark.campaign
@pytest.mark.skipif(not FORKS, reason="workers begin with nothing here")
def test_workers_of_a_session_begin_with_what_was_loaded_once(patience_s):
    loaded = "wafer_viewer.session.surface.stitching_job"
    warm_up = WarmUp(compile=print, first=print, complete=print, loaded=WARM_UP.loaded)
    compute = Compute(None, warm_up, lambda event: None, lambda code: None)
    try:
        host = psutil.Process(compute.start().process.pid)
        ask = worker_tasks.lead_everywhere, worker_tasks.began_with, [(loaded,)] * 40
        told = set(compute.lead("first", *ask).result(patience_s))
        for worker, was_there, niceness, trim in told:
            assert (was_there, niceness, trim) == (True, host.nice(), str(256 * 2**20))
            assert psutil.Process(worker).parent().ppid() == host.pid
        psutil.Process(next(iter(told))[0]).kill()
        again = set(compute.lead("again", *ask).result(patience_s))
        assert all(was_there for _, was_there, *_ in again)
    finally:
        compute.close()
    assert not host.is_running()
