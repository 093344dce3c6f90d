"""A lost connection as an operator meets it: the bar, and how the page comes back, on the shipped program."""

from __future__ import annotations

import re
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.steps import eventually
from wafer_viewer.gui.app import start

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
HIT = """element => {
  const box = element.getBoundingClientRect();
  return element.contains(document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2));
}"""
BAR = ".wv-bar-over"
RED, GREEN, AMBER = "rgb(180, 35, 24)", "rgb(24, 121, 78)", "rgb(255, 241, 214)"
Start = Callable[[], tuple[subprocess.Popen[str], str]]


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Start]:
    """Starts the shipped program on one folder and one port; gives it with the address it prints."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "wafer_viewer", "serve", "--data", str(tmp_path), "--port", str(port)]
    running: list[subprocess.Popen[str]] = []

    def begin() -> tuple[subprocess.Popen[str], str]:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        running.append(process)
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found is not None
        return process, found[0]

    yield begin
    for process in running:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(60)
        process.stdout.close()


@pytest.mark.campaign
def test_an_open_page_comes_back_by_itself_after_the_program_was_killed(
    program: Start, look_at: Callable[[str], Page], tmp_path: Path
):
    process, address = program()
    token = tmp_path / ".wafer-viewer" / "token"
    assert stat.S_IMODE(token.stat().st_mode) == 0o600
    page = look_at(address)
    page.get_by_role("button", name="Use the sample on the stage").click()  # there once the rig has looked
    expect(page.locator("[data-dock-region=right]")).to_contain_text("Predicted time")
    memory = tmp_path / ".wafer-viewer" / "session.json"
    eventually(lambda: memory.exists() and '"job":' in memory.read_text(), "the plan is remembered")
    page.evaluate("window.stillTheSame = true")

    process.kill()
    process.wait(60)
    bar = page.locator(BAR)
    expect(bar).to_have_css("background-color", RED)
    expect(bar).to_contain_text(re.compile(r"No contact with the instrument for 0:\d\d"))
    expect(bar).to_contain_text(re.compile(r"Last word at \d\d:\d\d:\d\d: "))
    expect(bar).to_contain_text("Stop on this page does not reach the rig.")
    assert page.evaluate("document.getElementById('root').inert")
    expect(page.locator("[data-dock-region=right]")).to_have_css("opacity", "0.5")

    _, again = program()
    assert again == address
    expect(bar).to_have_css("background-color", AMBER)
    expect(bar).to_contain_text(re.compile(r"The instrument was restarted at \d\d:\d\d:\d\d"))
    expect(bar).to_contain_text("Nothing moves before the sample is confirmed.")
    for seen in (page.locator(".wv-nav button").first, page.locator(".wv-tools").first):
        eventually(lambda at=seen: at.evaluate(HIT), "the bar lies over neither the steps nor the tools")
    bar.get_by_role("button", name="Look, and confirm the sample").click()
    expect(bar).to_be_hidden()
    expect(page.get_by_text("You hold the controls")).to_be_visible()  # before that a command is refused with a note
    page.locator("[data-pick=confirm-sample]").click()
    expect(page.get_by_role("button", name="Start scan")).to_be_enabled()
    assert page.evaluate("window.stillTheSame === true")  # it was not reloaded, nor opened anew


@pytest.mark.campaign
def test_contact_that_comes_back_to_the_same_program_says_what_went_on(look_at: Callable[[str], Page]):
    session = fake.FakeSession(fake.scanning())
    first = start(session)
    port = int(re.search(r":(\d+)/", first.address)[1])
    page = look_at(first.address)
    page.locator(".wv-contact").wait_for(state="attached")
    page.set_viewport_size({"width": 1024, "height": 768})
    first.stop()
    bar = page.locator(BAR)
    expect(bar).to_have_css("background-color", RED)
    expect(bar).to_contain_text(": scanning, field 5.")
    box = bar.bounding_box()
    assert box["width"] == 1024
    assert box["height"] >= 56
    token = first.address.partition("token=")[2]
    second = start(session, port=port, token=token)
    try:
        expect(bar).to_have_css("background-color", GREEN)
        expect(bar).to_contain_text(
            "The scan continued without this page: frame 274 of 540, 1 missing, taken again later."
        )
        stop = page.get_by_role("button", name="Stop", exact=True)
        shown, place = bar.bounding_box(), stop.bounding_box()
        assert shown["x"] + shown["width"] <= place["x"]  # Stop works again, and is in sight
        assert not page.evaluate("document.getElementById('root').inert")
        expect(bar).to_be_hidden()
    finally:
        page.goto("about:blank")
        second.stop()
