"""The file dialog on a true session: a dataset, images, a certificate and an export, chosen from the list by hand."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile
from playwright.sync_api import Locator, Page, expect
from scipy import ndimage

from tests.browser.sessions.fake_session import a_job
from tests.browser.sessions.gauge_blocks import CERTIFICATE_TOML
from tests.browser.steps import eventually, go_to, press, set_numbers, text_field, title_is
from tests.browser.test_exchange import a_part
from tests.support.datasets.grid_dataset import REGISTERED, RESULT, add_surfaces, make_dataset
from tests.truth.field_grid import SMALL, make
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.region import Region
from wafer_viewer.session.planning.job_releases import read_job
from wafer_viewer.session.session import Session
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.formats.conversion import export, read_surface
from wafer_viewer.store.records.golden_dies import save_golden

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


@pytest.mark.campaign
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


@pytest.mark.campaign
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
    expect(row(page, "stacks")).to_be_visible()
    text_field(page, "Path").fill(str(tmp_path / "elsewhere"))
    answer(page, "Open")
    expect(page.get_by_role("dialog")).to_contain_text("start the viewer with --browse")


def saved(page: Page, button: str, folder: str, name: str) -> None:
    """Save a file by its dialog into a folder of the list, under a name."""
    press(page, button)
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("free on this disk")
    row(page, folder).dblclick()
    expect(dialog).to_contain_text(f"/{folder}.")
    field = text_field(page, "File name")
    field.fill(name)
    field.press("Enter")


@pytest.mark.campaign
def test_plan_results_and_report_are_saved_where_a_person_chose(page: Page, session: Session, data: Path):
    session.exchange.import_surface(data / "part.x3p").result(WORK_S)
    session.wait_until(lambda now: now.surface is not None, WORK_S)
    line = Region.line(2010.0, -350.0, 2090.0, -350.0)
    session.keep(session.measure("profile", (line,))).result(WORK_S)
    session.edit_job(a_job()).result(WORK_S)
    go_to(page, "Plan")
    saved(page, "Save plan…", "exports", "monday")
    eventually((data / "exports" / "monday.toml").exists, "the plan is saved")
    assert read_job(data / "exports" / "monday.toml") == a_job()

    go_to(page, "Measure")
    press(page, "CSV…")
    expect(text_field(page, "File name")).to_have_value("part-results.csv")
    answer(page, "Save")
    eventually((data / "part-results.csv").exists, "the results are saved in the data folder")
    (data / "exports" / "part-results.csv").write_text("older")
    saved(page, "CSV…", "exports", "part-results")
    answer(page, "Replace part-results.csv")
    eventually(lambda: "Profile" in (data / "exports" / "part-results.csv").read_text(), "the results are replaced")
    expect(page.get_by_role("dialog")).to_have_count(0)
    press(page, "CSV…")
    text_field(page, "File name").fill("part.wafer/kept")
    answer(page, "Save")
    expect(page.get_by_role("dialog")).to_contain_text("lies inside of a dataset")
    answer(page, "Cancel")

    go_to(page, "Report")
    press(page, "Save report as…")
    expect(text_field(page, "File name")).to_have_value("part-report-1.html")
    answer(page, "Cancel")
    saved(page, "Save report as…", "exports", "for Anna")
    eventually((data / "exports" / "for Anna.html").exists, "the report is saved", WORK_S)
    link = page.get_by_role("link", name="Open the report")
    expect(page.locator(".wv-note.good")).to_contain_text(str(data / "exports" / "for Anna.html"))
    with page.context.expect_page() as opened:
        link.click()
    expect(opened.value.locator("h1").first).to_contain_text("part")
    assert not list(data.glob("*-report-*.html"))


def test_a_surface_is_compared_with_a_file_from_the_list(page: Page, session: Session, data: Path):
    part = a_part()
    export(dataclasses.replace(part, z_um=part.z_um + 3, z_raw_um=part.z_raw_um + 3), data / "exports" / "second.x3p")
    session.exchange.import_surface(data / "part.x3p").result(WORK_S)
    session.wait_until(lambda now: now.surface is not None, WORK_S)
    go_to(page, "Surface")
    page.locator("[data-pick=compare-new]").click()
    press(page, "From a file…")
    row(page, "exports").dblclick()
    row(page, "second.x3p").dblclick()
    session.wait_until(lambda now: len(now.comparisons) == 1, WORK_S)
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.locator("tr[data-pick=compare-look].sel")).to_contain_text("second")
    expect(page.get_by_role("button", name="Close comparison")).to_be_visible()


@pytest.mark.campaign
def test_a_golden_die_is_chosen_from_a_file_and_kept_on_the_shelf(page: Page, session: Session, data: Path):
    layer = np.zeros((24, 24), np.float32)
    header = GoldenHeader(product="", pixel_um=0.5, width_um=12.0, height_um=12.0, dies=9, made_of="other")
    save_golden(GoldenDie(header, layer, layer + 1, layer, layer + 1), data / "exports" / "lx7")
    session.exchange.import_surface(data / "part.x3p").result(WORK_S)
    session.wait_until(lambda now: now.surface is not None, WORK_S)
    go_to(page, "Review")
    page.get_by_label("Compare", exact=True).click()
    page.get_by_role("option", name="Die to golden die").click()
    page.locator("[data-pick=defect-golden-file]").click()
    row(page, "exports").dblclick()
    row(page, "lx7.1.golden.npz").click()
    answer(page, "Use this golden die")
    chosen = page.locator("tr[data-pick=defect-golden]")
    expect(chosen).to_have_attribute("aria-pressed", "true")
    expect(chosen).to_contain_text("lx7")
    assert (data / "golden" / "lx7.1.golden.npz").exists()


@pytest.mark.campaign
def test_the_fields_of_a_stitched_surface_are_exported_as_images_in_place(page: Page, session: Session, data: Path):
    made = make(SMALL)
    dataset = make_dataset(data / "grid.wafer", made)
    add_surfaces(dataset, made, range(len(made.fields)))
    bring_up_to_date(dataset, RESULT, REGISTERED)
    session.open_dataset(dataset).result(WORK_S)
    session.wait_until(lambda now: now.surface is not None, WORK_S)
    go_to(page, "Surface")
    page.keyboard.press("Control+k")
    page.get_by_placeholder("Search").fill("export the fields")
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog", name="Export the fields")
    expect(dialog).to_contain_text("Each field as an image in its solved place")
    expect(text_field(page, "File name")).to_have_value("grid.ome.zarr")
    row(page, "exports").dblclick()
    expect(dialog).to_contain_text(f"Saved in {data / 'exports'}")
    answer(page, "Save")
    scene = data / "exports" / "grid.ome.zarr"
    eventually(scene.exists, "the scene is written")
    images = [path.name for path in scene.iterdir() if path.is_dir()]
    assert sorted(images) == sorted(field.name for field in made.fields)
    expect(page.get_by_text("Fields exported")).to_be_visible()
