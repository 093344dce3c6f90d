"""Turns: pages of those who look on draw one after the other, those who work do not wait for them."""

from __future__ import annotations

import itertools
import threading
import time
from typing import Any

import pytest

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.fake_session import FakeSession
from tests.support.patience import until
from tests.support.plain_browser import PlainBrowser
from wafer_viewer.gui.app import start
from wafer_viewer.gui.page.page import DrawingTurns, Page


def test_only_one_page_of_those_who_look_on_draws_at_a_time() -> None:
    turns, lock, inside, most = DrawingTurns(), threading.Lock(), 0, 0

    def draw() -> None:
        nonlocal inside, most
        with lock:
            inside += 1
            most = max(most, inside)
        time.sleep(0.01)
        with lock:
            inside -= 1

    pages = [threading.Thread(target=turns.draw, args=(draw, lambda: False)) for _ in range(6)]
    for page in pages:
        page.start()
    for page in pages:
        page.join(30)
    assert most == 1


@pytest.mark.slow
def test_no_page_is_drawn_again_while_another_waits() -> None:
    turns, order, n_pages = DrawingTurns(), list[int](), 5

    def draw_again_and_again(page: int) -> None:
        for _ in range(20):
            turns.draw(lambda: (order.append(page), time.sleep(0.002)), lambda: False)

    pages = [threading.Thread(target=draw_again_and_again, args=(page,)) for page in range(n_pages)]
    for page in pages:
        page.start()
    for page in pages:
        page.join(30)
    all_wait = order[2 * n_pages : -n_pages]
    rounds = [all_wait[n : n + n_pages] for n in range(len(all_wait) - n_pages)]
    assert all(len(set(drawn)) == n_pages for drawn in rounds)


def test_a_page_that_has_to_hurry_draws_during_the_turn_of_another() -> None:
    turns, begun, end = DrawingTurns(), threading.Event(), threading.Event()

    def slowly() -> None:
        begun.set()
        assert end.wait(30)

    slow = threading.Thread(target=turns.draw, args=(slowly, lambda: False))
    slow.start()
    assert begun.wait(30)
    drawn = list[str]()
    turns.draw(lambda: drawn.append("at once"), lambda: True)
    hurries = threading.Event()
    waits = threading.Thread(target=turns.draw, args=(lambda: drawn.append("clicked"), hurries.is_set))
    waits.start()
    time.sleep(0.1)
    assert drawn == ["at once"]
    hurries.set()
    waits.join(30)
    assert drawn == ["at once", "clicked"]
    end.set()
    slow.join(30)


@pytest.mark.slow
def test_after_a_turn_twice_the_time_that_it_took_is_left_to_others() -> None:
    turns, ends = DrawingTurns(), list[tuple[float, float]]()

    def draw() -> None:
        begun = time.monotonic()
        time.sleep(0.05)
        ends.append((begun, time.monotonic()))

    for _ in range(3):
        turns.draw(draw, lambda: False)
    assert all(later[0] - earlier[1] >= 1.9 * (earlier[1] - earlier[0]) for earlier, later in itertools.pairwise(ends))


def test_an_error_ends_the_turn() -> None:
    turns = DrawingTurns()

    def fails() -> None:
        raise ValueError("cannot draw")

    with pytest.raises(ValueError, match="cannot draw"):
        turns.draw(fails, lambda: False)
    drawn = list[int]()
    turns.draw(lambda: drawn.append(1), lambda: False)
    assert drawn == [1]


@pytest.mark.campaign
def test_while_states_come_fast_one_browser_that_looks_on_is_drawn_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    lock, drawing, most = threading.Lock(), set[int](), 0
    n_of_holder, hurried = 0, dict[int, bool]()
    drawn, hurries = Page._draw, Page._hurries

    def asked(page: Page) -> bool:
        hurried[id(page)] = hurries(page)
        return hurried[id(page)]

    def counted(page: Page) -> None:
        nonlocal most, n_of_holder
        looks_on = not hurried.get(id(page), False)
        with lock:
            n_of_holder += not looks_on
            drawing.update({id(page)} if looks_on else ())
            most = max(most, len(drawing))
        try:
            drawn(page)
        finally:
            with lock:
                drawing.discard(id(page))

    session: Any = FakeSession(fake.scanning())
    running, browsers = start(session), list[PlainBrowser]()
    try:
        for _ in range(4):
            browsers.append(PlainBrowser(running.address))
            until(lambda: len([b for b in session.snapshot.control.browsers if b.present]) == len(browsers))
        time.sleep(2.0)  # all are drawn
        monkeypatch.setattr(Page, "_hurries", asked)
        monkeypatch.setattr(Page, "_draw", counted)
        for _ in range(30):
            session.change(draft=session.snapshot.draft)
            time.sleep(0.05)
    finally:
        for browser in browsers:
            browser.close()
        running.stop()
    assert most == 1
    assert n_of_holder >= 10
