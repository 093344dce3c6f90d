"""A browser on another machine: it is asked for the password, and then has the page as any other browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.kept_page import a_page
from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.fake_session import FakeSession
from wafer_viewer.gui.app import start
from wafer_viewer.session.core.network_access import NetworkAccess
from wafer_viewer.session.core.page_certificate import page_certificate
from wafer_viewer.session.core.private_file import PasswordHash

pytestmark = pytest.mark.browser
HOST = "127.0.0.2"
GOOD = "correct horse b\u00e4ttery"


@pytest.fixture
def page(browser: Browser, tmp_path: Path) -> Iterator[Page]:
    """The page at an address of the network, in a browser that accepted the self-signed certificate."""
    network = NetworkAccess(page_certificate(tmp_path, HOST, None, None), PasswordHash.of(GOOD))
    running = start(FakeSession(fake.empty()), HOST, network=network)
    context = browser.new_context(ignore_https_errors=True)
    page = a_page(context)
    page.goto(running.public_origin)
    yield page
    context.close()
    running.stop()


def test_the_password_opens_the_page_and_a_wrong_one_says_so(page: Page) -> None:
    page.get_by_label("Password").fill("something else")
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("alert")).to_have_text("This is not the password.")
    page.get_by_label("Password").fill(GOOD)
    page.keyboard.press("Enter")
    page.locator(".wv-title").first.wait_for()
    page.reload()
    page.locator(".wv-title").first.wait_for()
