"""The file dialog on a true session: a dataset, images, a certificate and an export, chosen from the list by hand."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile
from playwright.sync_api import Locator, Page, expect
from scipy import ndimage

from tests.browser.gauge_blocks import CERTIFICATE_TOML
from tests.browser.steps import eventually, go_to, press, set_numbers, text_field, title_is
from tests.browser.test_exchange import a_part
from wafer_viewer.session.session import Session
from wafer_viewer.store.exporters import export
from wafer_viewer.store.readers import read_surface

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 240.0


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = tmp_path / "wafers"
    for name in ("stacks/lot 5/coupon", "exports"):
        (folder / name).mkdir(parents=True)
    write_stack(folder / "stacks" / "lot 5" / "coupon")
    export(a_part(), folder / "part.x3p")
    return folder


@pytest.fixture
def session(data: Path) -> Iterator[Session]:
    opened = Session(data)
    yield opened
    opened.close()


def write_stack(folder: Path) -> None:
    """Eleven pictures of a tilted, textured plane, sharp where the plane crosses their z."""
    texture = np.random.default_rng(1).integers(40, 215, (96, 128)).astype(float)
    levels = [ndimage.gaussian_filter(texture, 0.1 + 0.7 * k) for k in range(12)]
    crossing = np.linspace(2, 8, 128)[None, :] * np.ones((96, 1))
    for k in range(11):
        image = np.choose(np.abs(crossing - k).round().astype(int), levels).round().astype(np.uint8)
        tifffile.imwrite(folder / f"z{k:02d}.tif", image)


def row(page: Page, name: str) -> Locator:
    return page.get_by_role("option", name=name)


def answer(page: Page, name: str) -> None:
    page.get_by_role("dialog").last.get_by_role("button", name=name, exact=True).click()


def test_images_are_imported_and_a_surface_exported_without_a_typed_path(page: Page, session: Session, data: Path):
    press(page, "Import images…")
    row(page, "stacks").dblclick()
    row(page, "lot 5").dblclick()
    look = row(page, "coupon").locator(".wv-file-look")
    expect(row(page, "coupon")).to_contain_text("11 images")
    expect(look).to_have_css("background-image", re.compile('^url."?data:image/jpeg'))
    row(page, "coupon").click()
    expect(text_field(page, "Path")).to_have_value(str(data / "stacks" / "lot 5" / "coupon"))
    set_numbers(page, "z step, µm", 4)
    set_numbers(page, "Pixel, µm", 0.5)
    answer(page, "Import")
    session.wait_until(lambda now: now.surface_is_whole, WORK_S)
    title_is(page, "Surface")
    expect(page.locator(".wv-pill")).to_have_text("Imported · no rig")
    expect(page.locator(".wv-hd")).not_to_contain_text("SIMULATED")
    page.keyboard.press("Shift+P")
    expect(page.locator(".wv-pill")).to_contain_text("SIMULATED")
    page.keyboard.press("Shift+S")
    title_is(page, "Surface")
    page.keyboard.press("Shift+E")
    expect(page.get_by_role("dialog")).to_contain_text("free on this disk")
    row(page, "exports").dblclick()
    expect(page.get_by_role("dialog")).to_contain_text(f"Saved in {data / 'exports'}")
    answer(page, "Export")
    target = data / "exports" / "coupon.npz"
    eventually(target.exists, "the surface is written")
    info = session.snapshot.surface
    assert info is not None
    assert read_surface(target).shape == (info.rows, info.cols)
    target.write_text("older")
    page.keyboard.press("Shift+E")
    row(page, "exports").dblclick()
    row(page, "coupon.npz").click()
    answer(page, "Export")
    expect(page.get_by_role("dialog", name="Replace coupon.npz?")).to_be_visible()
    answer(page, "Cancel")
    expect(page.get_by_role("dialog", name="Export the surface")).to_be_visible()
    answer(page, "Export")
    answer(page, "Replace coupon.npz")
    eventually(lambda: target.stat().st_size > 1000, "the file is replaced")
    expect(page.get_by_role("dialog")).to_have_count(0)


def test_a_dataset_and_a_certificate_are_opened_by_the_keyboard_alone(page: Page, session: Session, data: Path):
    session.exchange.import_surface(data / "part.x3p").result(WORK_S)
    session.wait_until(lambda now: now.surface is not None, WORK_S)
    session.close_dataset().result(WORK_S)
    (data / "blocks.toml").write_text(CERTIFICATE_TOML.format(expires="2099-03-14"))
    os.utime(data / "part.wafer")
    page.keyboard.press("Control+o")
    expect(row(page, "part.wafer")).to_be_visible()
    files = page.get_by_role("listbox")
    files.focus()
    while row(page, "stacks").get_attribute("aria-selected") != "true":
        page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    expect(row(page, "lot 5")).to_be_visible()
    expect(files).to_be_focused()
    page.keyboard.press("Backspace")
    expect(row(page, "part.wafer")).to_be_visible()
    field = text_field(page, "Path")
    field.fill("part.w")
    expect(page.get_by_role("option")).to_have_count(1)
    field.press("Tab")
    expect(field).to_have_value(str(data / "part.wafer"))
    field.press("Enter")
    expect(page.locator(".wv-mark small")).to_have_text("part")
    eventually(lambda: session.snapshot.surface is not None, "the surface is known")

    go_to(page, "Gauge check")
    press(page, "Load the certificate…")
    row(page, "blocks.toml").dblclick()
    expect(page.get_by_role("dialog")).to_have_count(0)
    eventually(lambda: session.snapshot.gauge.certificate is not None, "the certificate is taken")


def test_a_path_outside_of_what_may_be_shown_is_refused_with_the_way_out(page: Page, tmp_path: Path):
    (tmp_path / "elsewhere").mkdir()
    press(page, "Open a dataset…")
    text_field(page, "Path").fill(str(tmp_path / "elsewhere"))
    answer(page, "Open")
    expect(page.get_by_role("dialog")).to_contain_text("start the viewer with --browse")
