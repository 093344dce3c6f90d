"""One browser for the whole run, a fresh context for every test; pages of a session that stands still or a true one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.browser.audit import SMALL_PICTURE
from tests.browser.screens import FLAGS, hide_viser_warning
from tests.browser.sessions.fake_session import FakeSession
from wafer_viewer.gui.app import start
from wafer_viewer.session.session import Session

PATIENCE_MS = 120_000
"""A machine without a graphics card draws slowly; no test waits that long where it does not have to."""
WINDOW = {"width": 1366, "height": 768}
LIGHT = ("--disable-gpu-compositing", "--webgl-antialiasing-mode=none")
"""Only the scene is drawn as on a graphics card: the page too would make opening it three times as dear."""
CHROMIUM = next((p for p in ("chromium", "chromium-browser", "google-chrome") if shutil.which(p)), None)


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
    """Opens an address in a context of its own, with a small picture: software draws slowly."""
    with ExitStack() as stack:

        def open_page(address: str) -> Page:
            context = stack.enter_context(browser.new_context(viewport=WINDOW))
            context.add_init_script(SMALL_PICTURE)
            hide_viser_warning(context)
            page = context.new_page()
            page.set_default_timeout(PATIENCE_MS)
            page.goto(address)
            page.locator(".wv-title").first.wait_for()
            return page

        yield open_page


@pytest.fixture
def serve(look_at: Callable[[str], Page]) -> Iterator[Callable[[FakeSession], Page]]:
    """Shows a session that stands still and opens its page."""
    with ExitStack() as stack:

        def show(session: FakeSession) -> Page:
            running = start(session)
            stack.callback(running.stop)
            return look_at(running.address)

        yield show


@pytest.fixture
def page(session: Session, look_at: Callable[[str], Page]) -> Iterator[Page]:
    """The page of the session that a module's own fixture opens; it is left before the viewer ends."""
    running = start(session)
    shown = look_at(running.address)
    yield shown
    shown.goto("about:blank")
    running.stop()


os.environ.setdefault("WAFER_VIEWER_LOG", os.devnull)
