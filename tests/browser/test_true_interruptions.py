"""A scan goes on over a reload of the page, and is continued after its program was killed or its stage was lost."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import eventually, notes, press, set_numbers, title_is
from tests.session.conftest import small_job
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.session.session import Session
from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 240
"""Long enough for a machine that does other things too; a free one needs a tenth of it."""


@pytest.fixture
def session(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Session]:
    opened = Session(tmp_path / "wafers", getattr(request, "param", RigConfig()))
    yield opened
    opened.close()


@pytest.mark.campaign
def test_a_scan_goes_on_while_its_page_is_loaded_again(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, WORK_S)
    session.edit_job(small_job(cols=4, n_frames=60, z_step_um=1.0)).result()
    press(page, "Start scan")
    begun = session.wait_until(lambda now: now.scan is not None and now.scan.frames_done > 0, WORK_S)
    assert begun.scanning
    page.reload()
    title_is(page, re.compile("field|The scan is done"))
    title_is(page, "The scan is done")
    done = session.wait_until(lambda now: now.surface_is_whole, WORK_S)
    assert done.scan.frames_done == done.scan.frames_total == 240
    assert Dataset.open(done.dataset.path).check().ok
    expect(page.get_by_role("button", name="Look at the surface")).to_be_visible()
    assert notes(page).count() == 0


@pytest.mark.campaign
@pytest.mark.parametrize("session", [RigConfig(faults=Faults(stage_lost=(25,)))], indirect=True)
def test_scan_whose_stage_is_lost_is_reported_and_continued(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, WORK_S)
    session.edit_job(small_job(cols=2)).result()
    press(page, "Start scan")
    title_is(page, "The scan is unfinished")
    note = notes(page).filter(has_text="The scan stopped")
    expect(note).to_contain_text("The stage failed (No such device): check its cable and its power")
    session.wait_until(lambda now: now.rig.state == "absent", WORK_S)
    press(page, "Continue the scan")
    title_is(page, "The scan is done")
    assert Dataset.open(session.snapshot.dataset.path).check().ok


@pytest.fixture
def serve_folder(tmp_path: Path) -> Iterator[Callable[[], tuple[subprocess.Popen[str], str]]]:
    """Starts the program on one data folder, as a process; returns it with its address."""
    with ExitStack() as at_end:

        def begin() -> tuple[subprocess.Popen[str], str]:
            command = [sys.executable, "-m", "wafer_viewer", "serve", "--port", "0", "--data", str(tmp_path / "wafers")]
            program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            at_end.callback(kill, program)
            address = re.search(r"http\S+", program.stdout.readline())
            assert address is not None
            return program, address.group()

        yield begin


def kill(program: subprocess.Popen[str]) -> None:
    """SIGKILL, as from a lack of memory; what it started ends by itself."""
    started = psutil.Process(program.pid).children(recursive=True) if program.poll() is None else []
    program.kill()
    program.wait()
    program.stdout.close()
    _, alive = psutil.wait_procs(started, timeout=WORK_S)
    assert not alive


@pytest.mark.campaign
def test_a_scan_is_continued_after_its_program_was_killed(
    look_at: Callable[[str], Page], serve_folder: Callable[[], tuple[subprocess.Popen[str], str]], tmp_path: Path
):
    program, address = serve_folder()
    page = look_at(address)
    page.locator("[data-pick=tour]").click(timeout=1000 * WORK_S)  # offered once the rig answers
    page.keyboard.press("Escape")  # its plan stays
    set_numbers(page, "Columns, rows", 4, 1)
    expect(page.get_by_text(re.compile("^4 fields · "))).to_be_visible()
    press(page, "Start scan")
    title_is(page, re.compile("field 2"))
    kill(program)
    page.close()
    (path,) = (tmp_path / "wafers").glob("*.wafer")
    assert not Dataset.open(path).finished

    _, address = serve_folder()
    page = look_at(address)
    page.get_by_role("button", name="Acquire", exact=True).click()
    title_is(page, "The scan is unfinished")
    page.get_by_role("button", name="It is this sample").click()
    press(page, "Continue the scan")
    expect(page.locator(".wv-title > span:first-child").first).to_have_text("The scan is done", timeout=1000 * WORK_S)
    expect(page.get_by_role("button", name="Look at the surface")).to_be_visible(timeout=1000 * WORK_S)
    eventually(lambda: Dataset.open(path).finished, "the scan is finished on the disk")
    assert not Dataset.open(path).missing()
    assert Dataset.open(path).check().ok
    page.goto("about:blank")
