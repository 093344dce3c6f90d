"""One browser for the whole run, and a page that is kept: of a session that stands still or a true one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, suppress

import pytest
from playwright.sync_api import Browser, Error, Page, expect, sync_playwright

from tests.browser.kept_page import ON_THE_PAGE, PATIENCE_MS, KeptPage, a_page
from tests.browser.screens import FLAGS
from tests.browser.sessions.fake_session import FakeSession
from tests.support.kept_processes import kept_processes
from wafer_viewer.gui.app import start
from wafer_viewer.session.session import Session

__all__ = ["kept_processes"]
WINDOW = {"width": 1366, "height": 768}
LIGHT = ("--disable-gpu-compositing", "--webgl-antialiasing-mode=none")
"""Only the scene is drawn as on a graphics card: the page too would make opening it three times as dear."""
CHROMIUM = next((p for p in ("chromium", "chromium-browser", "google-chrome") if shutil.which(p)), None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add what the page showed and heard to the report of a failure: under load, presses have been lost."""
    report = yield
    kept = getattr(item, "funcargs", {}).get("kept_page")
    if report.failed and call.when == "call" and kept is not None:
        with suppress(Error):
            report.sections.append(("On the page", kept.page.evaluate(ON_THE_PAGE)))
    return report


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which(CHROMIUM), args=[*FLAGS, *LIGHT])
        yield chromium
        chromium.close()


@pytest.fixture
def look_at(browser: Browser) -> Iterator[Callable[[str], Page]]:
    """Opens an address in a browser of its own: for tests of a first sight, of several browsers and of lost contact."""
    with ExitStack() as stack:

        def open_page(address: str) -> Page:
            page = a_page(stack.enter_context(browser.new_context(viewport=WINDOW)))
            page.goto(address)
            page.locator(".wv-title").first.wait_for()
            return page

        yield open_page


@pytest.fixture(scope="session")
def kept_page(browser: Browser) -> Iterator[KeptPage]:
    with browser.new_context(viewport=WINDOW, reduced_motion="reduce") as context:
        yield KeptPage(a_page(context))


@pytest.fixture
def serve(kept_page: KeptPage) -> Iterator[Callable[[FakeSession], Page]]:
    """Shows sessions that stand still on the page that is kept, and closes them when it is left."""
    shown: list[FakeSession] = []

    def show(session: FakeSession) -> Page:
        shown.append(session)
        return kept_page.show(session)

    yield show
    kept_page.leave()
    for session in shown:
        if isinstance(session, FakeSession) and "close" in dir(session):
            session.close()


@pytest.fixture
def serve_anew(look_at: Callable[[str], Page]) -> Iterator[Callable[[FakeSession], Page]]:
    """Shows a session on a page that is opened for it: for tests that close it, listen to it or change its scripts."""
    with ExitStack() as stack:

        def show(session: FakeSession) -> Page:
            running = start(session)
            stack.callback(running.stop)
            return look_at(running.address)

        yield show


@pytest.fixture
def page(session: Session, kept_page: KeptPage) -> Iterator[Page]:
    """The page of the session that a module's own fixture opens; it is left before the session ends."""
    yield kept_page.show(session)
    kept_page.leave()


os.environ.setdefault("WAFER_VIEWER_LOG", os.devnull)
