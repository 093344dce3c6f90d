"""What belongs to an inspection, on a true session: recipe saved, golden die kept, KLARF written and laid over."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import eventually, notes, press, text_field, title_is, type_into
from tests.support.datasets.inspections import written_klarf
from tests.support.noisy_wafer import Planted, wafer
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.spec import replace
from wafer_viewer.session.session import Session
from wafer_viewer.store.formats.npz_file import write_npz
from wafer_viewer.store.records.golden_dies import open_golden
from wafer_viewer.store.records.inspection_records import readable_recipes
from wafer_viewer.store.tables.klarf import read_klarf

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
PATIENCE_S = 240.0
PLANTED = (Planted("bump", 250.0, 392.0, 30, 8), Planted("pit", 110.0, 110.0, 24, 10))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    """A surface of nine dies that was inspected for defects."""
    folder, made = tmp_path_factory.mktemp("data"), wafer(1, (3, 3), (120, 140), PLANTED)
    write_npz(made.surface, folder / "w7.npz")
    opened = Session(folder)
    opened.exchange.import_surface(folder / "w7.npz").result(PATIENCE_S)
    opened.wait_until(lambda now: now.surface is not None, PATIENCE_S)
    opened.defects.inspect(DefectRecipe(product="LX-7", sensitivity=0.25), made.grid).result(PATIENCE_S)
    yield opened
    opened.close()


def state_wafer(page: Page) -> None:
    """Type what a KLARF states into the dialog that exports it."""
    for name, value in (("Wafer centre x, µm", "0"), ("Wafer centre y, µm", "0"), ("Diameter, mm", "300")):
        type_into(page, name, value)
    type_into(page, "Process step", "METAL2")
    page.get_by_role("dialog").get_by_label("Notch").click()
    page.get_by_role("option").filter(has_text="Down").click()


def test_a_recipe_a_golden_die_and_a_klarf_are_kept_as_a_person_does(session: Session, page: Page):
    folder, dialog = session.snapshot.data_folder, page.get_by_role("dialog")
    page.keyboard.press("Shift+R")
    page.locator("[data-pick=defect-form]").press("Enter")
    expect(page.get_by_text("As the surface was inspected; not saved.")).to_be_visible()

    press(page, "Save recipe…")
    type_into(page, "Name", "night shift")
    dialog.get_by_role("button", name="Save", exact=True).click()
    expect(page.get_by_text("Recipe “night shift” of LX-7, as saved.")).to_be_visible()
    ((kept,), _) = readable_recipes(folder)
    assert (kept.product, kept.name, kept.sensitivity) == ("LX-7", "night shift", 0.25)

    page.locator("[data-pick=defect-errand][data-k=golden]").press("Enter")
    expect(dialog).to_contain_text("earlier versions are kept")
    type_into(page, "Name", "lx7")
    expect(dialog).to_contain_text("It will be version 1.")
    dialog.get_by_role("button", name="Keep", exact=True).click()
    eventually(lambda: len(session.snapshot.defect_files.golden) == 1, "the golden die is listed")
    assert open_golden(folder / "golden" / "lx7.1.golden.npz").header.made_of == "w7"

    page.locator("[data-pick=defect-errand][data-k=export]").press("Enter")
    expect(dialog).to_contain_text("It cannot hold U")
    expect(text_field(page, "File name")).to_have_value("w7-defects.klarf")
    path = folder / "w7-defects.klarf"
    dialog.get_by_role("button", name="Export", exact=True).click()
    expect(dialog).to_contain_text("A KLARF states the wafer's centre on the stage")
    state_wafer(page)
    dialog.get_by_role("button", name="Export", exact=True).click()
    eventually(path.exists, "the KLARF is written")
    n = len(session.snapshot.inspection.inspection.found)
    assert len(read_klarf(path).defects) == n

    page.locator("[data-pick=defect-errand][data-k=klarf]").press("Enter")
    type_into(page, "Path", str(path.with_name("gone.klarf")))
    dialog.get_by_role("button", name="Overlay", exact=True).click()
    expect(dialog).to_contain_text("does not exist: check the path.")
    type_into(page, "Path", str(path))
    dialog.get_by_role("button", name="Overlay", exact=True).click()
    expect(page.get_by_text(f"{n} places of another tool: {n} found here too, 0 not.")).to_be_visible()
    assert notes(page).count() == 0


@pytest.mark.campaign
def test_adders_since_an_earlier_klarf_are_listed_alone(session: Session, page: Page):
    found = session.snapshot.inspection.inspection
    assert found is not None
    new = found.found[0]
    earlier = replace(found, defects=tuple(d for d in found.defects if d.number != new.number))
    path = written_klarf(earlier, session.snapshot.data_folder / "before.klarf")
    page.keyboard.press("Shift+R")
    page.locator("[data-pick=defect-errand][data-k=earlier]").press("Enter")
    dialog = page.get_by_role("dialog")
    type_into(page, "Path", str(path))
    dialog.get_by_role("button", name="Compare", exact=True).click()
    expect(dialog).to_have_count(0)
    expect(page.get_by_text(f"1 added · 0 removed · {len(earlier.found)} common")).to_be_visible()
    expect(page.locator(".wv-alone")).to_contain_text("1 added since before.klarf alone")
    expect(page.locator(".wv-defects tr")).to_have_count(1)
    title_is(page, f"D{new.number} · {new.kind.capitalize()}")
    page.locator("[data-pick=defect-all]").press("Enter")
    expect(page.locator(".wv-alone")).to_have_count(0)
    page.locator("[data-pick=defect-added]").press("Enter")
    expect(page.locator(".wv-alone")).to_contain_text("1 added since before.klarf alone")
    page.keyboard.press("Escape")
    page.locator("[data-pick=defect-earlier-away]").press("Enter")
    expect(page.get_by_text("Since before.klarf")).to_have_count(0)
    assert notes(page).count() == 0


@pytest.mark.campaign(together=True)
def test_a_place_is_left_out_on_every_die_as_a_person_does(session: Session, page: Page):
    dialog, before = page.get_by_role("dialog"), session.snapshot.inspection.inspection
    assert before is not None
    page.keyboard.press("Shift+R")
    page.keyboard.press("PageDown")
    page.locator("[data-pick=defect-excluded][data-k=here]").press("Enter")
    expect(dialog.locator("[data-pick=defect-area-away]")).to_have_count(1)
    type_into(page, "From, µm", "5, 5")
    type_into(page, "To, µm", "5, 15")
    dialog.get_by_role("button", name="Keep", exact=True).click()
    expect(dialog).to_contain_text("The area is empty: type two opposite corners of a rectangle.")
    type_into(page, "To, µm", "12, 15")
    dialog.get_by_role("button", name="Keep", exact=True).click()
    expect(dialog).to_have_count(0)
    expect(page.get_by_text("2 areas of every die excluded")).to_be_visible()
    press(page, "Inspect")
    session.wait_until(lambda now: (found := now.inspection.inspection) is not None and found != before, PATIENCE_S)
    found = session.snapshot.inspection.inspection
    assert found is not None
    assert len(found.recipe.excluded) == 2
    assert found.recipe.excluded[1].bounds_um == (5, 5, 12, 15)
    assert len(found.found) == len(before.found) - 1
    expect(page.get_by_text("Left out of every die, as the recipe asks: 2 areas")).to_be_visible()


@pytest.mark.campaign(together=True)
def test_an_area_is_searched_again_once_it_is_taken_away(session: Session, page: Page):
    page.keyboard.press("Shift+R")
    page.locator("[data-pick=defect-form]").press("Enter")
    expect(page.get_by_text("2 areas of every die excluded")).to_be_visible()
    page.keyboard.press("Control+k")
    page.get_by_placeholder("Search commands...").fill("excluded areas")
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog", name="Excluded areas")
    dialog.locator("[data-pick=defect-area-change][data-k='1']").press("Enter")
    expect(text_field(page, "From, µm")).to_have_value("5, 5")
    dialog.locator("[data-pick=defect-area-away][data-k='0']").press("Enter")
    expect(dialog).to_contain_text("The whole die is searched.")
    dialog.get_by_role("button", name="Cancel", exact=True).click()
    expect(page.get_by_text("2 areas of every die excluded")).to_be_visible()
    page.locator("[data-pick=defect-more]").press("Enter")
    page.locator("[data-pick=defect-excluded][data-k='']").press("Enter")
    dialog.locator("[data-pick=defect-area-away][data-k='1']").press("Enter")
    expect(dialog.locator("[data-pick=defect-area-away]")).to_have_count(1)
    dialog.get_by_role("button", name="Keep", exact=True).click()
    expect(page.get_by_text("1 area of every die excluded")).to_be_visible()
