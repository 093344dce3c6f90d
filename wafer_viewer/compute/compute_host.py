"""Compute host: separate process that runs the cluster client, submits tasks to workers and reports to the viewer.

The cluster is dask.distributed, which reruns the tasks of a killed worker. A work of many tasks is led from here, on a
separate thread, because a worker may be killed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future as LocalFuture
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

from distributed import CancelledError, Client, Event, Future

from wafer_viewer.compute.child_process import ChildConnection, Request
from wafer_viewer.compute.dask_cluster import client_of
from wafer_viewer.compute.messages import (
    PROGRESS_TOPIC,
    Cancel,
    ComputeAbsent,
    ComputeUp,
    ComputeWarm,
    Progressed,
    RunLedTask,
    RunTask,
    WarmUp,
    run_watched,
    stop_sign,
    throttled,
)
from wafer_viewer.compute.task_runner import COUNT_EVERY_S, DaskRunner, n_local_workers
from wafer_viewer.model.errors import ComputeError, WaferViewerError

RUN_PRIORITY = 10
"""Priority of single tasks, such as a field of the running scan, over the tasks of a led work."""


def run_compute(end: ChildConnection, scheduler: str | None, warm_up: WarmUp, *, forked: bool = False) -> None:
    """Run the compute host until the pipe ends. forked: see `client_of`."""
    with ExitStack() as until_end:
        try:
            client = until_end.enter_context(client_of(scheduler, n_local_workers(), forked))
        except ComputeError as fault:
            end.tell(ComputeAbsent(str(fault)))
            return
        Host(client, end, warm_up).work()


class Host:
    """Dispatcher between the pipe and the cluster."""

    def __init__(self, client: Client, end: ChildConnection, warm_up: WarmUp) -> None:
        self._client, self._end, self._warm_up_with = client, end, warm_up
        self._futures: dict[int, Future[Any]] = {}
        self._warming: list[Future[Any]] = []
        self._leader = ThreadPoolExecutor(1, "lead")  # one after the other: two could write to the same mosaic
        self._stops: dict[str, threading.Event] = {}
        self._closing = threading.Event()
        self._do = {RunTask: self._run, RunLedTask: self._lead, Cancel: self._cancel}
        client.subscribe_topic(PROGRESS_TOPIC, self._progressed)

    def work(self) -> None:
        """Handle requests until the pipe ends; kernels are loaded meanwhile."""
        self._warm_up(list(self._client.scheduler_info(n_workers=-1)["workers"]))
        threading.Thread(target=self._count, name="count workers", daemon=True).start()
        try:
            for request in self._end.requests():
                self._do[type(request.command)](request)
        finally:
            self._closing.set()
            for stop in list(self._stops.values()):
                stop.set()
            self._leader.shutdown(cancel_futures=True)

    def _count(self) -> None:
        """Report the number of workers whenever it changes."""
        crew, reported = DaskRunner(self._client), 0
        with suppress(ComputeError):
            while not self._closing.is_set():
                if (now := crew.n_slots) != reported:
                    self._end.tell(ComputeUp(now))
                    reported = now
                self._closing.wait(COUNT_EVERY_S)

    def _run(self, request: Request) -> None:
        command: RunTask = request.command
        key = f"{command.task.__name__}-{command.work}-{request.number}"
        future = self._client.submit(
            run_watched, command.work, command.task, command.args, key=key, pure=False, priority=RUN_PRIORITY
        )
        self._futures[request.number] = future
        future.add_done_callback(lambda done: self._done(request, done))

    def _lead(self, request: Request) -> None:
        command: RunLedTask = request.command
        stop = self._stops[command.work] = threading.Event()
        progress, crew = throttled(partial(self._tell, command.work)), DaskRunner(self._client)
        led = self._leader.submit(command.task, *command.args, crew=crew, progress=progress, should_stop=stop.is_set)
        led.add_done_callback(partial(self._led, request))

    def _led(self, request: Request, done: LocalFuture[Any]) -> None:
        self._stops.pop(request.command.work, None)
        if done.cancelled() or done.exception() is not None:
            self._end.refuse(request, _sentence(request.command, done))
        else:
            self._end.answer(request, done.result())

    def _cancel(self, request: Request) -> None:
        if stop := self._stops.get(request.command.work):
            stop.set()
        Event(stop_sign(request.command.work), client=self._client).set()
        self._end.answer(request)

    def _progressed(self, event: tuple[float, dict[str, Any]]) -> None:
        _, progress = event
        self._tell(progress["work"], progress["fraction"])

    def _tell(self, work: str, fraction: float) -> None:
        self._end.tell(Progressed(work, fraction))

    def _done(self, request: Request, done: Future[Any]) -> None:
        self._futures.pop(request.number)
        if done.status == "finished":
            self._end.answer(request, done.result())
        else:
            self._end.refuse(request, _sentence(request.command, done))

    def _warm_up(self, addresses: list[str]) -> None:
        """Load what the first tasks need on one worker, which is enough to begin, then everything on all."""
        warm_up, first, others = self._warm_up_with, addresses[0], addresses[1:]

        def warmed(_: Future[Any]) -> None:
            self._end.tell(ComputeWarm())
            self._warming += [self._warm_up_one(warm_up.complete, address) for address in (*others, first)]

        self._warming = [self._warm_up_one(warm_up.first, first)]
        self._warming[0].add_done_callback(warmed)

    def _warm_up_one(self, warm_up: Callable[[], None], address: str) -> Future[Any]:
        return self._client.submit(warm_up, workers=[address], pure=False)


def _sentence(command: RunTask | RunLedTask, done: Future[Any] | LocalFuture[Any]) -> WaferViewerError:
    """Return the failure of a task as an error that the viewer can show."""
    fault = None if done.cancelled() else done.exception()
    if isinstance(fault, WaferViewerError):
        return fault
    if fault is None or isinstance(fault, CancelledError):
        return ComputeError("The work stopped because the compute cluster ended.")
    return ComputeError(f"{command.task.__name__} failed: {type(fault).__name__}: {fault}.")
