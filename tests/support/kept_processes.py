"""Workers and render process that outlive a session of the tests, for the next one in the same environment.

Starting them costs 4 to 6 s of processor time, whatever a test asks of them. After the loss of one a session starts its
own; so do sessions in a process of their own, as those of the command line. Every session has a rig process of its own.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from wafer_viewer.compute.child_process import ChildProcess
from wafer_viewer.compute.compute_client import Compute
from wafer_viewer.compute.messages import ComputeUp, ComputeWarm, Progressed, WarmUp
from wafer_viewer.session.rendering import render_process
from wafer_viewer.session.rendering.render_process import Painter

_hosts: list[tuple[object, ChildProcess, list[Any]]] = []
"""The host without a session, its environment, and what it has reported of its workers."""
_pools: list[tuple[object, ProcessPoolExecutor]] = []
_new_pool = render_process._new_pool
CHANGING = "PYTEST_CURRENT_TEST", "TCM_ENABLE"
"""Variables that change without a test: the second one is set by the threading library that numba loads."""
END_S = 5.0
"""Longest wait for works that were told to stop; a host that still has some is ended with its session."""
_sessions = count(1)


def _environment() -> object:
    """Return what a process gets from the one that starts it."""
    variables = {name: value for name, value in os.environ.items() if name not in CHANGING}
    return variables, list(sys.path), Path.cwd()


class KeptCompute(Compute):
    """Client of a compute host that may have served another session: works are named with the number of theirs."""

    def __init__(self, scheduler: str | None, warm_up: WarmUp, on_event: Any, on_exit: Any) -> None:
        super().__init__(scheduler, warm_up, self._hear, on_exit)
        self._tell, self._prefix, self._is_own = on_event, f"{next(_sessions)} ", scheduler is None
        self._news: list[Any] = []
        self._works: dict[Future[Any], str] = {}

    def start(self) -> ChildProcess:
        if self._link is None and self._is_own and _hosts:
            environment, link, news = _hosts.pop()
            if link.alive and environment == _environment():
                link._on_event, link._on_exit = self._on_event, self._on_exit
                self._link = link
                for event in list(news):
                    self._hear(event)
            else:
                link.close()
        elif self._link is None or not self._link.alive:
            self._news.clear()
        return super().start()

    def _note(self, event: Any) -> None:
        """Note what the next session is to know, too, between two sessions."""
        if isinstance(event, (ComputeUp, ComputeWarm)):
            self._news.append(event)

    def _hear(self, event: Any) -> None:
        self._note(event)
        if not isinstance(event, Progressed):
            self._tell(event)
        elif event.work.startswith(self._prefix):
            self._tell(replace(event, work=event.work.removeprefix(self._prefix)))

    def run(self, work: str, task: Any, *args: Any) -> Future[Any]:
        return self._named(work, super().run(self._prefix + work, task, *args))

    def lead(self, work: str, task: Any, *args: Any) -> Future[Any]:
        return self._named(work, super().lead(self._prefix + work, task, *args))

    def _named(self, work: str, answer: Future[Any]) -> Future[Any]:
        self._works[answer] = work
        answer.add_done_callback(lambda done: self._works.pop(done, None))
        return answer

    def cancel(self, work: str) -> None:
        super().cancel(self._prefix + work)

    def close(self) -> None:
        """Stop what is at work; a host that has nothing to do any more is left to the next session."""
        link = self._link
        if link is not None and link.alive and self._is_own and not _hosts:
            for work in set(self._works.values()):
                self.cancel(work)
            if not wait(list(self._works), END_S).not_done and link.alive:
                link._on_event, link._on_exit = self._note, lambda _: None
                _hosts.append((_environment(), link, self._news))
                return
        super().close()


class KeptPainter(Painter):
    """Client of a render process that may have served another session."""

    def close(self) -> None:
        if _pools or self._pool._broken:
            super().close()
            return
        for rendering in list(self._pending.values()):
            rendering.future.cancel()
        _pools.append((_environment(), self._pool))


def _kept_pool() -> ProcessPoolExecutor:
    if _pools:
        environment, pool = _pools.pop()
        if environment == _environment() and not pool._broken:
            return pool
        pool.shutdown(wait=False, cancel_futures=True)
    return _new_pool()


@pytest.fixture(scope="session", autouse=True)
def kept_processes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wafer_viewer.session.surface.reconstruction_queue.Compute", KeptCompute)
        patch.setattr(render_process, "Painter", KeptPainter)
        patch.setattr(render_process, "_new_pool", _kept_pool)
        yield
        for _, link, _ in _hosts:
            link.close()
        for _, pool in _pools:
            pool.shutdown(cancel_futures=True)
