"""Questions of a page that take their time: answered on threads of their own, the newest one only."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from wafer_viewer.gui.widgets.callbacks import ErrorSink, LatestOnlyWorker, guarded
from wafer_viewer.model.errors import WaferViewerError

T = TypeVar("T")


class AskingPage(ErrorSink, Protocol):
    """A page that can be drawn again when an answer comes."""

    def redraw(self) -> None:
        """Draw again."""
        ...

    def on_close(self, last: Callable[[], None]) -> None:
        """Register a callback for when the page closes."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Answer(Generic[T]):
    """The newest answer; without one, the reason; `computing`: a newer one is on its way."""

    value: T | None = None
    problem: str = ""
    computing: bool = False


@dataclass(slots=True)
class _Question:
    worker: LatestOnlyWorker
    about: object
    stamp: object
    answer: Answer[Any]


class Ask:
    """The questions of a page, by name, and its tasks."""

    def __init__(self, page: AskingPage) -> None:
        self._page = page
        self._questions: dict[str, _Question] = {}
        self._tasks: dict[str, Future[Any]] = {}

    def __call__(
        self, name: str, stamp: object, compute: Callable[[], T] | None, failed: str, about: object = None
    ) -> Answer[T]:
        """Return the newest answer to a question, and compute another one if it is out of date.

        Parameters
        ----------
        name : str
            Name of the question; each has a thread of its own.
        stamp : object
            All that the answer depends on.
        compute : callable or None
            Gives the answer, on the thread of the question. A WaferViewerError it raises is the problem of the answer;
            after a CancelledError the former answer stands. None: there is nothing to ask now, and no answer.
        failed : str
            Title of an unexpected failure.
        about : object, optional
            Subject of the question: an answer about another one is not shown until the new one comes.
        """
        question = self._questions.get(name)
        if question is None:
            worker = LatestOnlyWorker(name)
            self._page.on_close(worker.close)
            question = self._questions[name] = _Question(worker, about, _NEVER, Answer())
        if compute is None:  # an answer that is on its way comes too late
            question.stamp, question.about, question.answer = _NEVER, _NEVER, Answer()
        elif (question.stamp, question.about) != (stamp, about):
            shown = question.answer if question.about == about else Answer()
            question.stamp, question.about, question.answer = stamp, about, replace(shown, computing=True)
            question.worker.ask(lambda: guarded(self._page, failed)(self._answer)(question, stamp, about, compute))
        return question.answer

    def known(self, name: str) -> Answer[Any]:
        """Return the newest answer to a question without asking it."""
        question = self._questions.get(name)
        return Answer() if question is None else question.answer

    def begin(self, name: str, task: Future[T]) -> Future[T]:
        """Follow a task, so that the page shows when it begins and ends."""
        self._tasks[name] = task
        task.add_done_callback(lambda _: self._page.redraw())
        self._page.redraw()
        return task

    def busy(self, name: str) -> bool:
        """Return whether a task has begun and not ended."""
        return name in self._tasks and not self._tasks[name].done()

    def forget(self, name: str) -> None:
        """Drop an answer, so that it is asked again."""
        if (question := self._questions.get(name)) is not None:
            question.stamp = _NEVER

    def _answer(self, question: _Question, stamp: object, about: object, compute: Callable[[], Any]) -> None:
        """Answer a question; an answer that is out of date by now is still newer than the one that is shown."""
        answer: Answer[Any] = Answer()
        try:
            answer = Answer(compute())
        except WaferViewerError as fault:
            answer = Answer(problem=str(fault))
        except CancelledError:
            answer = question.answer
            if question.stamp == stamp:
                question.stamp = _NEVER
        finally:
            if question.about == about:
                question.answer = replace(answer, computing=question.stamp != stamp)
                self._page.redraw()


_NEVER = object()
