"""Questions of a page: the newest answer stands until a newer one comes, and only the newest question is computed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from typing import Any

import pytest

from tests.support.patience import until
from wafer_viewer.gui.widgets.ask import Ask
from wafer_viewer.model.errors import WaferViewerError


class Page:
    def __init__(self) -> None:
        self.drawn, self.told = 0, list[str]()
        self._last = list[Callable[[], None]]()

    def redraw(self) -> None:
        self.drawn += 1

    def on_close(self, last: Callable[[], None]) -> None:
        self._last.append(last)

    def tell(self, fault: Any) -> None:
        self.told.append(fault.title)

    def say(self, title: str, text: str, tone: Any = "good") -> None:
        self.told.append(title)

    def close(self) -> None:
        for last in self._last:
            last()


@pytest.fixture
def page() -> Iterator[Page]:
    page = Page()
    yield page
    page.close()


def answered(ask: Ask, name: str) -> Any:
    until(lambda: not ask.known(name).computing)
    return ask.known(name).value


def test_an_answer_is_computed_once_for_a_stamp_and_draws_the_page(page: Page):
    ask, computed = Ask(page), list[int]()

    def compute() -> int:
        computed.append(1)
        return 7

    assert ask("height", "a", compute, "Failed").value is None
    assert answered(ask, "height") == 7
    assert page.drawn == 1
    assert ask("height", "a", compute, "Failed").value == 7
    assert computed == [1]


def test_an_older_answer_stands_until_the_new_one_comes(page: Page):
    ask, going = Ask(page), threading.Event()
    ask("height", 1, lambda: 1, "Failed")
    assert answered(ask, "height") == 1
    moved = ask("height", 2, lambda: going.wait(5) and 2, "Failed")
    assert (moved.value, moved.computing) == (1, True)
    going.set()
    assert answered(ask, "height") == 2


def test_an_answer_about_another_subject_is_never_shown(page: Page):
    ask, going = Ask(page), threading.Event()
    ask("measure", 1, lambda: going.wait(5) and "step", "Failed", about="step")
    assert ask("measure", 2, lambda: "angle", "Failed", about="angle").value is None
    going.set()
    assert answered(ask, "measure") == "angle"


def test_questions_between_the_running_and_the_newest_are_left_out(page: Page):
    ask, going, computed = Ask(page), threading.Event(), list[int]()

    def question(number: int) -> Callable[[], int]:
        def compute() -> int:
            computed.append(number)
            going.wait(5)
            return number

        return compute

    ask("drag", 0, question(0), "Failed")
    until(lambda: computed == [0])
    for number in (1, 2, 3):
        ask("drag", number, question(number), "Failed")
    going.set()
    assert answered(ask, "drag") == 3
    assert computed == [0, 3]


def test_an_expected_error_is_the_problem_of_the_answer_and_any_other_is_told(page: Page):
    ask = Ask(page)

    def fail(fault: Exception) -> Any:
        raise fault

    ask("faces", 1, lambda: fail(WaferViewerError("No face is seen.")), "The faces were not found")
    assert answered(ask, "faces") is None
    assert ask.known("faces").problem == "No face is seen."
    assert page.told == []
    ask("faces", 2, lambda: fail(KeyError("x")), "The faces were not found")
    until(lambda: page.told == ["The faces were not found"])
    assert ask.known("faces").problem == ""


def test_without_anything_to_ask_there_is_no_answer(page: Page):
    ask = Ask(page)
    ask("height", 1, lambda: 1, "Failed")
    assert answered(ask, "height") == 1
    assert ask("height", 2, None, "Failed").value is None


def test_an_answer_that_comes_when_nothing_is_asked_any_more_is_not_shown(page: Page):
    ask, begun, going, ended = Ask(page), *(threading.Event() for _ in range(3))

    def late() -> int:
        begun.set()
        going.wait(5)
        return 1

    ask("height", 1, late, "Failed", about="step")
    assert begun.wait(5)
    ask("height", 2, None, "Failed", about="step")
    ask._questions["height"].worker.ask(ended.set)  # after the late one, on its thread
    going.set()
    assert ended.wait(5)
    assert (ask.known("height").value, ask.known("height").computing) == (None, False)


def test_a_forgotten_answer_is_asked_again_and_stands_meanwhile(page: Page):
    ask, computed = Ask(page), list[int]()
    ask("contents", 1, lambda: computed.append(1), "Failed")
    answered(ask, "contents")
    ask.forget("contents")
    ask("contents", 1, lambda: computed.append(2), "Failed")
    answered(ask, "contents")
    assert computed == [1, 2]


def test_a_task_is_busy_until_it_ends_and_the_page_shows_both(page: Page):
    ask, task = Ask(page), Future[None]()
    assert not ask.busy("report")
    ask.begin("report", task)
    assert ask.busy("report")
    assert page.drawn == 1
    task.set_result(None)
    assert not ask.busy("report")
    assert page.drawn == 2


def test_a_cancelled_answer_leaves_the_former_one_and_is_asked_again(page: Page):
    ask, asked = Ask(page), list[int]()

    def cancelled() -> int:
        asked.append(1)
        raise CancelledError

    ask("height", "a", lambda: 7, "Failed")
    assert answered(ask, "height") == 7
    ask("height", "b", cancelled, "Failed")
    until(lambda: page.drawn == 2)
    assert (ask.known("height").value, page.told) == (7, [])
    ask("height", "b", lambda: 8, "Failed")
    assert answered(ask, "height") == 8
    assert asked == [1]
