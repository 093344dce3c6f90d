"""Control handover between browsers: the first browser has control, others request it.

A disconnected browser does not block others. A handover stops nothing: a running scan continues.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.roles import Person
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import observer_command
from wafer_viewer.session.core.people import engineers_of, listed_people, signed_in, tidy_name
from wafer_viewer.session.core.private_file import WINDOW_S, AttemptLimit
from wafer_viewer.session.state.snapshot import Browser, ControlState

ANSWER_S = 15.0
"""Time in seconds in which the holder can answer a request; after that, control passes to the requester."""
GRACE_S = 20.0
"""Time in seconds in which a disconnected browser can return; a reload takes seconds, on a busy machine many."""
Later = Callable[[float, Callable[[], None]], Callable[[], None]]
"""Function that schedules a call after a number of seconds and returns a function that cancels it."""


def after(wait_s: float, then: Callable[[], None]) -> Callable[[], None]:
    """Call `then` after `wait_s` seconds, on a separate thread; return the function that cancels it."""
    timer = threading.Timer(wait_s, then)
    timer.daemon = True
    timer.start()
    return timer.cancel


class Control:
    """Commands that change `Snapshot.hands`; each can be called from any thread.

    A browser is identified by its key and may have several windows; it has gone when the last of them has closed.
    """

    def __init__(self, command_queue: CommandQueue, later: Later = after) -> None:
        self._command_queue, self._later = command_queue, later
        self._limit = AttemptLimit()
        self._verifier = ThreadPoolExecutor(1, thread_name_prefix="sign-in")  # an attempt costs 128 MB and some 0.1 s
        self._windows: Counter[str] = Counter()
        self._expected: dict[str, Callable[[], None]] = {}
        self._waiting: Callable[[], None] | None = None
        self._came = 0

    @property
    def _folder(self) -> Path:
        return self._command_queue.now.data_folder

    def _free(self, name: str) -> str:
        """Return a name that a browser may give itself; empty for that of a listed person, who has to sign in."""
        tidy = tidy_name(name)
        listed = {person.name.casefold() for person in listed_people(self._folder)}
        return "" if tidy.casefold() in listed else tidy

    @property
    def _control(self) -> ControlState:
        return self._command_queue.now.control

    def _show(self, **changes: Any) -> None:
        self._command_queue.change(control=replace(self._control, **changes))

    @observer_command
    def arrive(self, key: str, name: str = "") -> None:
        """Register a new window of a browser; the very first browser gets control."""
        self._windows[key] += 1
        self._show(engineers=engineers_of(listed_people(self._folder)))
        if (call_off := self._expected.pop(key, None)) is not None:
            call_off()
        browser = self._control.browser(key)
        if browser is None:
            self._came += 1
            browser = Browser(key, self._free(name) or f"Browser {self._came}")
        self._put(replace(browser, present=True))
        if self._control.holder is None and len(self._control.browsers) == 1:
            self._pass_to(key)

    @observer_command
    def leave(self, key: str) -> None:
        """Register a closed window; control becomes free if the browser does not return soon."""
        browser = self._control.browser(key)
        if self._windows[key] < 1 or browser is None:
            return
        self._windows[key] -= 1
        if self._windows[key] > 0:
            return
        self._put(replace(browser, present=False))
        self._expected[key] = self._later(GRACE_S, lambda: self._command_queue.note(self._gone, key))

    def _gone(self, key: str) -> None:
        """Remove a browser that did not return.

        If it held control, the requester gets it; without a requester, the only browser still connected gets it, else
        control is free.
        """
        if self._expected.pop(key, None) is None:
            return
        del self._windows[key]
        control = self._control
        self._show(browsers=tuple(b for b in control.browsers if b.key != key))
        if control.requester == key:
            self._end_request()
        if control.holder == key:
            heirs = [b.key for b in self._control.browsers if b.present]
            requester = self._control.requester
            self._pass_to(requester if requester is not None else heirs[0] if len(heirs) == 1 else None)

    @observer_command
    def rename(self, key: str, name: str) -> None:
        """Change the name of a browser at which nobody is signed in."""
        browser = self._control.browser(key)
        if browser is not None and browser.role is None and self._free(name):
            self._put(replace(browser, name=self._free(name)))

    @observer_command
    def sign_in(self, key: str, name: str, password: str) -> Future[Person]:
        """Sign a listed person in at a browser: it has the name and the role of the person from then on.

        The future fails with WaferViewerError if name or password are wrong, or after too many attempts.
        """
        if self._control.browser(key) is None:
            raise WaferViewerError("That browser has disconnected: nobody was signed in.")
        if not listed_people(self._folder):
            raise WaferViewerError("Nobody is listed here, and everyone is an engineer: wafer-viewer people add NAME.")
        if not self._limit.admit(key):
            raise WaferViewerError(f"Too many attempts: try again in {WINDOW_S:.0f} s.")
        verified = self._verifier.submit(signed_in, self._folder, name, password)
        return self._command_queue.then(verified, lambda person: self._signed_in(key, person))

    def _signed_in(self, key: str, person: Person) -> Person:
        self._limit.forget(key)
        if (browser := self._control.browser(key)) is not None:
            self._put(replace(browser, name=person.name, role=person.role))
        self._show(engineers=engineers_of(listed_people(self._folder)))
        return person

    @observer_command
    def sign_out(self, key: str) -> None:
        """Sign out the person at a browser; control stays where it is, and its commands wait for the next person."""
        if (browser := self._control.browser(key)) is not None and browser.role is not None:
            number = 1 + self._control.browsers.index(browser)
            self._put(replace(browser, name=f"Browser {number}", role=None))

    @observer_command
    def ask(self, key: str) -> None:
        """Take control if it is free, else request it from the holder, who has `ANSWER_S` seconds to refuse."""
        control = self._control
        if control.browser(key) is None or control.holds(key):
            return
        if control.holder is None:
            self._pass_to(key)
            return
        if control.requester == key:
            return
        if control.requester is not None:
            raise WaferViewerError(
                f"{control.name_of(control.requester)} asks for the controls already: wait for the answer."
            )
        self._show(requester=key, requested_at=time.time(), answer_s=ANSWER_S, refused=None)
        self._waiting = self._later(ANSWER_S, lambda: self._command_queue.note(self._unanswered, key))

    def _unanswered(self, key: str) -> None:
        if self._control.requester == key:
            self._pass_to(key)

    @observer_command
    def hand_over(self, key: str, to: str) -> None:
        """Pass control to another browser. Raises WaferViewerError if `key` does not hold it."""
        self._require_holder(key)
        if self._control.browser(to) is None:
            raise WaferViewerError("That browser has disconnected: control was not handed over.")
        self._pass_to(to)

    @observer_command
    def keep(self, key: str) -> None:
        """Refuse the pending request."""
        self._require_holder(key)
        requester = self._control.requester
        self._end_request()
        self._show(refused=requester)

    def _pass_to(self, key: str | None) -> None:
        self._end_request()
        self._show(holder=key, refused=None)

    def _end_request(self) -> None:
        if self._waiting is not None:
            self._waiting()
            self._waiting = None
        self._show(requester=None)

    def _require_holder(self, key: str) -> None:
        if (why := self._control.why_not(key)) is not None:
            raise WaferViewerError(f"{why} Ask for control first.")

    def _put(self, browser: Browser) -> None:
        """Add a browser, or replace its earlier entry."""
        others = self._control.browsers
        if self._control.browser(browser.key) is None:
            self._show(browsers=(*others, browser))
        else:
            self._show(browsers=tuple(browser if b.key == browser.key else b for b in others))
