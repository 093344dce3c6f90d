"""Files from the computer of a browser: its holder of the controls sends them, a watcher cannot, by whatever means."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.fake_session import FakeSession
from wafer_viewer.gui.page import uploads

pytestmark = [pytest.mark.browser, pytest.mark.slow]
SENT = {"name": "scan.csv", "mimeType": "text/csv", "buffer": b"x,y,z\n0,0,1\n"}


@pytest.fixture
def saved(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that reached the folder of what was sent."""
    names: list[str] = []
    save = uploads.UploadFolder.save

    def listed(folder: uploads.UploadFolder, name: str, content: bytes, otherwise: str):
        names.append(name)
        return save(folder, name, content, otherwise)

    monkeypatch.setattr(uploads.UploadFolder, "save", listed)
    return names


def import_dialog(page: Page) -> Locator:
    page.keyboard.press("Shift+I")
    dialog = page.locator(".mantine-Modal-content")
    dialog.get_by_role("button", name="Send a file from this computer").wait_for()
    return dialog


def send(page: Page) -> None:
    """Send a file as a page would, enabled or not."""
    page.locator("input[type=file]").evaluate("input => { input.disabled = false }")
    page.locator("input[type=file]").set_input_files(SENT)


def test_the_holder_sends_a_file_and_a_watcher_does_not(
    serve: Callable[[FakeSession], Page], look_at: Callable[[str], Page], saved: list[str]
) -> None:
    holder = serve(FakeSession(fake.planned()))
    expect(holder.locator(".wv-strip")).to_contain_text("You hold the controls")
    watcher = look_at(holder.url)
    expect(watcher.get_by_role("status").first).to_contain_text("holds the controls.")
    button = import_dialog(watcher).get_by_role("button", name="Send a file from this computer")
    expect(button).to_be_disabled()
    send(watcher)
    expect(watcher.locator(".mantine-Notification-root", has_text="The file was not sent")).to_be_visible()
    assert saved == []
    dialog = import_dialog(holder)
    send(holder)
    expect(dialog).to_contain_text("scan.csv was sent and is chosen.")
    assert saved == ["scan.csv"]
