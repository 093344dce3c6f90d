"""The process that hosts the compute cluster, apart from the viewer: it hands tasks to workers and reports.

The cluster is dask.distributed: it reruns what a killed worker had in hand. A local one talks TLS with certificates
of its own, made at the start, so that no other program of this machine can run code in it.
"""

from __future__ import annotations

import os
from contextlib import ExitStack
from multiprocessing.connection import Connection
from typing import Any

import dask.config
from distributed import CancelledError, Client, Event, Future, LocalCluster, Security

from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.session.link import Ask, ChildEnd, live_in_the_background
from wafer_viewer.session.messages import Cancel, ComputeAbsent, ComputeUp, ComputeWarm, Progressed, Run
from wafer_viewer.session.tasks import PROGRESS_TOPIC, run_watched, stop_sign, warm_up

NICENESS = 5
WORKER_MEMORY = "3GiB"
PATIENCE_S = 20.0
_SETTINGS = {
    # The stacks that workers read are memory-mapped and count as theirs, though the system can drop them at any time.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.comm.timeouts.connect": PATIENCE_S,
    "distributed.scheduler.allowed-failures": 3,
    "distributed.admin.tick.limit": "1 hour",
    # No pages of dask's own: they would be open to every program of this machine.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}


def run_compute(pipe: Connection, scheduler: str | None) -> None:
    """Live as the compute host until the pipe ends."""
    live_in_the_background(NICENESS)
    end = ChildEnd(pipe)
    with ExitStack() as until_end, dask.config.set(_SETTINGS):
        try:
            client = _join(scheduler, until_end) if scheduler else _own_cluster(until_end)
        except (OSError, TimeoutError, ValueError) as fault:
            end.tell(ComputeAbsent(f"There is no cluster at {scheduler or 'this machine'}: {_line(fault)}."))
            return
        client.subscribe_topic(
            PROGRESS_TOPIC, lambda event: end.tell(Progressed(event[1]["work"], event[1]["fraction"]))
        )
        Host(client, end).work()


def n_local_workers() -> int:
    """One worker a processor, two at least, so that one that is busy or was killed does not stop the others."""
    return min(8, max(2, (os.cpu_count() or 2) - 1))


class Host:
    """Between the pipe and the cluster."""

    def __init__(self, client: Client, end: ChildEnd) -> None:
        self._client, self._end = client, end
        self._futures: dict[int, Future[Any]] = {}
        self._warming: list[Future[Any]] = []
        self._do = {Run: self._run, Cancel: self._cancel}
        client.subscribe_topic(PROGRESS_TOPIC, self._progressed)

    def work(self) -> None:
        """Take verbs until the pipe ends; kernels are compiled meanwhile."""
        addresses = list(self._client.scheduler_info(n_workers=-1)["workers"])
        self._end.tell(ComputeUp(len(addresses)))
        self._warm_up(addresses)
        for ask in self._end.verbs():
            self._do[type(ask.verb)](ask)

    def _run(self, ask: Ask) -> None:
        verb: Run = ask.verb
        key = f"{verb.task.__name__}-{verb.work}-{ask.number}"
        future = self._client.submit(run_watched, verb.work, verb.task, verb.args, key=key, pure=False)
        self._futures[ask.number] = future
        future.add_done_callback(lambda done: self._done(ask, done))

    def _cancel(self, ask: Ask) -> None:
        Event(stop_sign(ask.verb.work), client=self._client).set()
        self._end.answer(ask)

    def _progressed(self, event: tuple[float, dict[str, Any]]) -> None:
        _, told = event
        self._end.tell(Progressed(told["work"], told["fraction"]))

    def _done(self, ask: Ask, done: Future[Any]) -> None:
        self._futures.pop(ask.number)
        if done.status == "finished":
            self._end.answer(ask, done.result())
        else:
            self._end.refuse(ask, _sentence(ask.verb, done))

    def _warm_up(self, addresses: list[str]) -> None:
        """One worker compiles, which is enough to begin; the others then load what it left in the cache."""
        first, *others = addresses

        def warmed(_: Future[Any]) -> None:
            self._end.tell(ComputeWarm())
            self._warming += [self._warm_up_one(address) for address in others]

        self._warming = [self._warm_up_one(first)]
        self._warming[0].add_done_callback(warmed)

    def _warm_up_one(self, address: str) -> Future[Any]:
        return self._client.submit(warm_up, workers=[address], pure=False)


def _own_cluster(until_end: ExitStack) -> Client:
    cluster = LocalCluster(
        n_workers=n_local_workers(),
        threads_per_worker=1,
        host="127.0.0.1",
        protocol="tls://",
        security=Security.temporary(),
        memory_limit=WORKER_MEMORY,
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address=None,
        silence_logs=50,
    )
    until_end.enter_context(cluster)
    return until_end.enter_context(Client(cluster))


def _join(scheduler: str, until_end: ExitStack) -> Client:
    """A cluster that runs already; its certificates come from dask's own configuration."""
    security = Security()
    if not (security.tls_ca_file and security.tls_client_cert):
        raise ValueError("dask's configuration names no certificates: set distributed.comm.tls.ca-file and .client")
    client = until_end.enter_context(Client(scheduler, security=security, timeout=PATIENCE_S))
    client.wait_for_workers(1, timeout=PATIENCE_S)
    return client


def _line(fault: BaseException) -> str:
    return " ".join(str(fault).split()).rstrip(".")


def _sentence(verb: Run, done: Future[Any]) -> WaferViewerError:
    """What went wrong with a task, as an error that the viewer can show."""
    if done.status == "cancelled":
        return ComputeError("The work was given up, because the compute cluster ended.")
    fault = done.exception()
    if isinstance(fault, WaferViewerError):
        return fault
    if isinstance(fault, CancelledError):
        return ComputeError("The work was given up, because the compute cluster ended.")
    return ComputeError(f"{verb.task.__name__} failed: {type(fault).__name__}: {fault}.")
