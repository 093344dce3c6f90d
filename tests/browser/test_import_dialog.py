"""The import dialog shows what the files hold, where it comes from and what has to be settled, before it imports."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.fake_exchange import looking_session, write_stack
from tests.browser.sessions.fake_session import FakeSession
from tests.browser.steps import eventually, press, text_field, type_into

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.fixture
def stack(tmp_path: Path) -> Path:
    """A folder of frames with z in their names, one missing, and a fused picture beside them."""
    return write_stack(tmp_path / "board-0142")


def test_files_are_shown_with_their_sources_before_they_are_imported(
    serve: Callable[[FakeSession], Page], stack: Path
) -> None:
    session = looking_session(fake.planned())
    page = serve(session)
    press(page, "Import…")
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("A folder of images, several files")
    expect(dialog.get_by_role("button", name="Import", exact=True)).to_be_disabled()
    type_into(page, "Path", str(stack))
    expect(dialog.locator(".wv-imp-files")).to_contain_text("a frame is missing")
    expect(dialog.locator(".wv-imp-files .off")).to_contain_text("fused.tif")
    expect(dialog.locator(".wv-imp-strip img")).to_have_count(12)
    expect(dialog.locator(".wv-imp-strip .gap")).to_have_count(2)
    importer = dialog.get_by_role("button", name=re.compile("^Import"))
    expect(dialog).to_contain_text("Not yet: the z step is missing, the pixel size is missing.")
    expect(importer).to_be_disabled()
    expect(text_field(page, "Pixel, µm")).to_have_attribute("data-tone", "attention")

    type_into(page, "Pixel, µm", "0.65")
    type_into(page, "z step, µm", "2.5")
    expect(dialog.locator(".wv-imp-source").first).to_have_text("typed")
    expect(dialog).to_contain_text("The pictures support this order.")
    expect(dialog).to_contain_text("1 frame is missing at +15.0\u202fµm.")
    expect(dialog).to_contain_text("130 × 104\u202fµm")
    expect(dialog.locator("code")).to_contain_text("--z-step-um 2.5 --pixel-um 0.65 -o board-0142.wafer")
    expect(importer).to_have_text("Import with the gap")
    assert all(name != "import_images" for name, _, _ in session.asked), "nothing is imported before the button"

    dialog.get_by_text("No frame is missing").click()
    expect(importer).to_have_text("Import as listed")
    importer.click()
    eventually(lambda: any(name == "import_images" for name, _, _ in session.asked), "the import begins")
    (sources, options) = next(args for name, args, _ in session.asked if name == "import_images")
    assert (sources, options.pixel_um, options.as_listed) == ((stack,), 0.65, True)


def test_a_look_is_stopped_when_the_dialog_is_closed_and_the_page_answers_meanwhile(
    serve: Callable[[FakeSession], Page], stack: Path
) -> None:
    session = FakeSession(fake.planned())
    page = serve(session)
    press(page, "Import…")
    type_into(page, "Path", str(stack))
    expect(page.get_by_role("dialog")).to_contain_text("Reading the files …")
    press(page, "Cancel")
    eventually(lambda: len(session.exchange.stopped) == len(session.exchange.looked) > 0, "each look is stopped", 20)


def test_a_file_dropped_on_the_page_opens_the_dialog(serve: Callable[[FakeSession], Page], stack: Path) -> None:
    session = FakeSession(fake.planned())
    page = serve(session)
    dropped = """text => {
      const carried = new DataTransfer();
      carried.items.add(new File([text], 'scan.csv'));
      document.body.dispatchEvent(new DragEvent('drop', { dataTransfer: carried, bubbles: true, cancelable: true }));
    }"""
    page.evaluate(dropped, "x,y,z\n0,0,1\n")
    expect(page.get_by_role("dialog")).to_contain_text("scan.csv was sent and is chosen.")
    eventually(lambda: bool(session.exchange.looked), "the file is looked at")
    (sent,), _ = session.exchange.looked[-1]
    assert sent.name == "scan.csv"


@pytest.mark.campaign
def test_several_files_dropped_on_the_page_are_a_stack(serve: Callable[[FakeSession], Page], stack: Path) -> None:
    session = looking_session(fake.planned())
    page = serve(session)
    images = sorted(stack.glob("img_*.tif"))[:9]
    dropped = """files => {
      const carried = new DataTransfer();
      for (const [name, base64] of files) {
        carried.items.add(new File([Uint8Array.from(atob(base64), c => c.charCodeAt(0))], name));
      }
      document.body.dispatchEvent(new DragEvent('drop', { dataTransfer: carried, bubbles: true, cancelable: true }));
    }"""
    contents = [[path.name, base64.b64encode(path.read_bytes()).decode()] for path in reversed(images)]
    page.evaluate(dropped, contents)
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("the z step is missing")
    (sources, _), *others = session.exchange.looked
    assert not others, "they are looked at when the last has arrived"
    assert [path.name for path in sources] == [path.name for path in images]
    expect(dialog.locator(".wv-imp-strip img")).to_have_count(9)


@pytest.mark.campaign
def test_the_lines_of_a_text_are_chosen_in_the_dialog(serve: Callable[[FakeSession], Page], tmp_path: Path) -> None:
    text = tmp_path / "heights.txt"
    text.write_text("\n".join(f"{k} {k % 3} {k % 5} {k % 4}" for k in range(12)))
    session = looking_session(fake.planned())
    page = serve(session)
    press(page, "Import…")
    dialog = page.get_by_role("dialog")
    type_into(page, "Path", str(text))
    expect(dialog).to_contain_text("take matrix under Lines if they are rows of heights")
    dialog.get_by_label("Lines").click()
    page.get_by_role("option", name="rows of a matrix").click()
    type_into(page, "Pixel, µm", "2")
    type_into(page, "z unit", "um")
    expect(dialog.locator("code")).to_contain_text("--table matrix")
    expect(dialog.locator(".wv-imp-shown")).to_contain_text("4 × 12 points")


@pytest.mark.campaign
def test_a_grid_of_running_numbers_is_drawn_and_mirrored_with_one_click(
    serve: Callable[[FakeSession], Page], tmp_path: Path
) -> None:
    folder = tmp_path / "grid"
    folder.mkdir()
    for n in range(6):
        tifffile.imwrite(folder / f"t{n}.tif", np.full((4, 24, 32), 10 * n, np.uint8), photometric="minisblack")
    session = looking_session(fake.planned())
    page = serve(session)
    press(page, "Import…")
    dialog = page.get_by_role("dialog")
    type_into(page, "Path", str(folder))
    type_into(page, "Pixel, µm", "0.5")
    type_into(page, "z step, µm", "2")
    type_into(page, "Pattern", "t{n}.tif")
    expect(dialog.locator(".wv-imp-place rect")).to_have_count(6)
    type_into(page, "Columns", "3")
    expect(dialog.locator(".wv-imp-place")).to_contain_text("45 × 23\u202fµm")
    dialog.get_by_text("Mirror x").click()
    expect(dialog.locator("code")).to_contain_text("--columns 3 --mirror x -o grid.wafer")
    type_into(page, "Columns", "0.2")
    expect(dialog).to_contain_text("Not read")
    expect(dialog).to_contain_text("The number of columns is 0: it must be")


@pytest.mark.campaign
def test_single_images_of_a_grid_are_stitched_to_one_picture(
    serve: Callable[[FakeSession], Page], tmp_path: Path
) -> None:
    folder = tmp_path / "grid"
    folder.mkdir()
    for n in range(6):
        tifffile.imwrite(folder / f"r{n // 3}_c{n % 3}.tif", np.full((24, 32), 40 * n, np.uint8))
    session = looking_session(fake.planned())
    page = serve(session)
    press(page, "Import…")
    dialog = page.get_by_role("dialog")
    type_into(page, "Path", str(folder))
    type_into(page, "Pixel, µm", "0.5")
    type_into(page, "Pattern", "r{row}_c{col}.tif")
    expect(dialog.locator(".wv-imp-place rect")).to_have_count(6)
    expect(dialog.locator(".wv-imp-strip img")).to_have_count(6)
    expect(dialog.locator(".wv-imp-foot")).to_contain_text("6 images, one a field → grid.ome.tif")
    expect(dialog.locator("code")).to_contain_text("wafer-viewer stitch-images")
    dialog.get_by_role("button", name="Stitch to one picture").click()
    eventually(lambda: any(name.endswith("stitch_images") for name, _, _ in session.asked), "the work begins")
    (sources, options) = next(args for name, args, _ in session.asked if name.endswith("stitch_images"))
    assert (sources, options.pixel_um, options.pattern) == ((folder,), 0.5, "r{row}_c{col}.tif")
