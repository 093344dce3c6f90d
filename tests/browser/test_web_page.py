"""A surface written as a web page, opened from the disk without this program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.support.surfaces import height_map
from wafer_viewer.cli.app import main
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.conversion import export

pytestmark = pytest.mark.browser

STEP_UM = 20.0
COLOURS = """() => {
  const canvas = document.querySelector('#scene'), gl = canvas.getContext('webgl2'), { width, height } = canvas;
  const pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  let drawn = 0;
  const colours = new Set();
  for (let k = 0; k < pixels.length; k += 4) {
    if (!pixels[k + 3]) continue;
    drawn++;
    colours.add(pixels.slice(k, k + 3).join());
  }
  return [drawn / (width * height), colours.size];
}"""


def a_step(simulated: bool = True) -> HeightMap:
    """60 by 80 pixels of .5 um: the right half is 20 um higher, and a corner is not measured."""
    z = np.where(np.arange(80) >= 40, STEP_UM, 0.0)[None, :].repeat(60, axis=0)
    z[:20, :30] = np.nan
    return height_map(z, pixel_um=0.5, x0_um=100.0, y0_um=50.0, simulated=simulated)


def opened(browser: Browser, path: Path) -> Page:
    page = browser.new_page(viewport={"width": 1100, "height": 700})
    page.goto(path.as_uri())
    page.wait_for_selector("html[data-drawn]", timeout=60_000)
    return page


def test_a_page_draws_the_surface_cuts_it_and_reads_its_heights(browser: Browser, tmp_path: Path) -> None:
    page = opened(browser, export(a_step(), tmp_path / "wafer 7 & <b>.html"))
    faults: list[object] = []
    page.on("pageerror", lambda fault: faults.append(fault))
    try:
        expect(page.locator("h1")).to_have_text("wafer 7 & <b>")
        expect(page.locator(".chip").first).to_have_text("SIMULATED")
        drawn, n_colours = page.evaluate(COLOURS)
        assert drawn > 0.1
        assert n_colours > 1
        expect(page.locator("#read")).to_contain_text("heights from 0.000 µm to 20.000 µm, 20.000 µm in all")
        with page.expect_download() as saved:
            page.get_by_role("button", name="Save as CSV").click()
        section = np.genfromtxt(saved.value.path(), delimiter=",", names=True)
        np.testing.assert_allclose(section["z_um"][:39], 0.0, atol=1e-3)
        np.testing.assert_allclose(section["z_um"][-39:], STEP_UM, atol=1e-3)
        np.testing.assert_allclose(section["x_um"][[0, -1]], [100.0, 139.5])
        for name in ("Points", "Picture", "From above"):
            page.get_by_role("button", name=name).click()
        box = page.locator("#scene").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 0.62 * box["width"], box["y"] + 0.5 * box["height"])
        expect(page.locator("#here")).to_contain_text("z 20.000 µm")
        page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
        expect(page.locator("#here")).to_contain_text("z 0.000 µm")
        assert not faults
    finally:
        page.close()


def test_a_line_on_the_map_is_the_section_and_gaps_stay_gaps(browser: Browser, tmp_path: Path) -> None:
    page = opened(browser, export(a_step(), tmp_path / "a.html"))
    try:
        box = page.locator("#map").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 0.05 * box["width"], box["y"] + 0.1 * box["height"])
        page.mouse.down()
        page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.1 * box["height"], steps=3)
        expect(page.locator("#read")).to_contain_text("nothing measured")
        page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.1 * box["height"], steps=3)
        page.mouse.up()
        expect(page.locator("#read")).to_contain_text("20.000 µm in all")
        chart = page.locator("#chart").bounding_box()
        assert chart is not None
        page.mouse.move(chart["x"] + chart["width"] - 30, chart["y"] + 60)
        expect(page.locator("#cross")).to_contain_text("20.000 µm")
        page.mouse.move(chart["x"] + 80, chart["y"] + 60)
        expect(page.locator("#cross")).to_contain_text("not measured")
    finally:
        page.close()


def test_it_is_written_by_the_command_and_fits_a_phone(browser: Browser, tmp_path: Path) -> None:
    export(a_step(simulated=False), tmp_path / "a.npz")
    assert main(["convert", str(tmp_path / "a.npz"), str(tmp_path / "a.html")]) == 0
    page = browser.new_page(viewport={"width": 390, "height": 800})
    try:
        page.goto((tmp_path / "a.html").as_uri())
        page.wait_for_selector("html[data-drawn]", timeout=60_000)
        expect(page.locator(".chip")).to_contain_text("uncalibrated")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
    finally:
        page.close()
