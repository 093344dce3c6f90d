"""A command is declared once: on which queue it runs, who may give it, and what its caller gets."""

from __future__ import annotations

import inspect
import threading
from concurrent.futures import Future

import pytest

from wafer_viewer.model.errors import ControlHeldError, WaferViewerError
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, forwarded, observer_command, query, restricted_session
from wafer_viewer.session.measurement.results import NotebookController
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import Browser, ControlState, Snapshot

ANNA, BEN = Browser("a", "Anna"), Browser("b", "Ben")
REFUSED = r"^Anna holds the controls\. Ask for control first: you are only watching\.$"


class Counter:
    """A controller of a number."""

    def __init__(self, command_queue: CommandQueue) -> None:
        self._command_queue = command_queue
        self.value, self.threads = 0, set[str]()

    @command
    def add(self, n: int, times: int = 1) -> int:
        """Add a number."""
        self.threads.add(threading.current_thread().name)
        self.value += n * times
        return self.value

    @command
    def add_two(self) -> int:
        self.add.run(1)
        return self.add.run(1)

    @command
    def later(self, answer: Future[int]) -> Future[int]:
        return answer

    @command
    def refuse(self) -> None:
        raise WaferViewerError("It is too late.")

    @observer_command
    def write(self) -> int:
        return self.value

    @query
    def read(self) -> str:
        return threading.current_thread().name


class SessionStandIn:
    """A session with one part."""

    add = forwarded(Counter.add, lambda session: session.counter)
    write = forwarded(Counter.write, lambda session: session.counter)
    read = forwarded(Counter.read, lambda session: session.counter)

    def __init__(self, command_queue: CommandQueue) -> None:
        self.counter, self._command_queue = Counter(command_queue), command_queue

    @property
    def snapshot(self) -> Snapshot:
        return self._command_queue.snapshot


@pytest.fixture
def command_queue():
    made = CommandQueue(Snapshot(control=ControlState(browsers=(ANNA, BEN), holder="a")))
    yield made
    made.close()


@pytest.fixture
def session(command_queue):
    return SessionStandIn(command_queue)


def test_commands_run_in_order_on_the_thread_of_the_queue(session):
    counter = session.counter
    answers = [counter.add(1), counter.add(2, times=3), session.add(3), counter.add_two(), counter.add(n=4)]
    assert [answer.result(10) for answer in answers] == [1, 7, 10, 12, 16]
    assert {name.split("_")[0] for name in counter.threads} == {"session"}
    assert counter.read() == threading.current_thread().name


def test_an_exception_and_a_future_reach_the_caller(session):
    with pytest.raises(WaferViewerError, match="too late"):
        session.counter.refuse().result(10)
    inner: Future[int] = Future()
    answer = session.counter.later(inner)
    session.add(1).result(10)
    assert not answer.done()
    inner.set_result(5)
    assert answer.result(10) == 5
    with pytest.raises(TypeError):
        session.counter.add().result(10)


def test_an_observer_is_refused_what_changes_anything_and_may_read(command_queue, session):
    session.notebook = NotebookController(command_queue, None)  # a group of the session's own
    watcher, holder = restricted_session(session, lambda: "b"), restricted_session(session, lambda: "a")
    stranger = restricted_session(session, lambda: "")
    for refused in (watcher.add(1), watcher.notebook.undo(), watcher.notebook.open(), stranger.add(1)):
        with pytest.raises(ControlHeldError, match=REFUSED):
            refused.result(10)
    assert holder.add(2).result(10) == 2
    assert watcher.read() == threading.current_thread().name
    assert watcher.write().result(10) == 2
    assert watcher.snapshot is command_queue.snapshot


def test_help_shows_a_command_as_its_caller_sees_it(session):
    for verb in (session.add, session.counter.add):
        assert str(inspect.signature(verb)) == "(n: 'int', times: 'int' = 1) -> 'Future[int]'"
        assert verb.__doc__ == "Add a number."
    assert str(inspect.signature(Counter.later)).endswith("-> 'Future[int]'")
    assert inspect.signature(Session.edit_job).return_annotation == "Future[None]"
