"""Defects with the true session: a surface is inspected at the defaults, judged by keys, and handed over as files."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import eventually, notes, press, text_field
from tests.browser.test_defect_files import state_wafer
from tests.support.noisy_wafer import Planted, wafer
from wafer_viewer.session.session import Session
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.formats.npz_file import write_npz
from wafer_viewer.store.records.inspection_records import read_inspection
from wafer_viewer.store.tables.klarf import read_klarf

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 240.0
PLANTED = (Planted("bump", 250.0, 392.0, 30, 8), Planted("pit", 110.0, 110.0, 24, 10))


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    """A surface of nine dies, two of them with a defect; nothing was inspected."""
    write_npz(wafer(1, (3, 3), (120, 140), PLANTED).surface, tmp_path / "w7.npz")
    opened = Session(tmp_path)
    opened.exchange.import_surface(tmp_path / "w7.npz").result(WORK_S)
    opened.wait_until(lambda now: now.surface is not None, WORK_S)
    yield opened
    opened.close()


def test_a_surface_is_inspected_judged_and_handed_over(page: Page, session: Session):
    page.keyboard.press("Shift+R")
    press(page, "Inspect")
    done = session.wait_until(lambda now: now.inspection.inspection is not None, WORK_S)
    found = done.inspection.inspection.found
    heights_um = [defect.height.value_um for defect in found]
    assert min(heights_um) < 0 < max(heights_um)
    rows = page.locator(".wv-defects tr")
    expect(rows.first).to_be_visible()

    judged = list[int]()
    for key, judgement in (("y", "real"), ("n", "nuisance")):
        before = {d.number for d in session.snapshot.inspection.defects if d.judgement == "open"}
        page.keyboard.press(key)
        judged.append(judged_now(session, before, judgement))

    stem = Path(exported(page, session, ".klarf")).name.removesuffix(".klarf")
    klarf, table = session.snapshot.data_folder / f"{stem}.klarf", session.snapshot.data_folder / f"{stem}.csv"
    assert len(read_klarf(klarf).defects) == len(found)
    exported(page, session, ".csv")
    with table.open() as lines:
        assert len(list(csv.reader(line for line in lines if not line.startswith("#")))) == len(found) + 1
    data = session.snapshot.dataset
    kept = {d.number: d.judgement for d in read_inspection(Dataset.open(data.path).result().path).defects}
    assert [kept[number] for number in judged] == ["real", "nuisance"]
    assert notes(page).count() == 0


def judged_now(session: Session, before: set[int], judgement: str) -> int:
    """The number of the defect that was judged, once it is."""

    def newly() -> list[int]:
        return [d.number for d in session.snapshot.inspection.defects if d.number in before and d.judgement != "open"]

    eventually(lambda: len(newly()) == 1, "one defect is judged")
    (number,) = newly()
    assert session.snapshot.inspection.defect(number).judgement == judgement
    return number


def exported(page: Page, session: Session, ending: str) -> str:
    """Export the defects to the file that the dialog proposes, with another ending."""
    page.locator("[data-pick=defect-errand][data-k=export]").press("Enter")
    dialog = page.get_by_role("dialog")
    name = text_field(page, "File name").input_value()
    path = (session.snapshot.data_folder / name).with_suffix(ending)
    if ending == ".klarf":
        state_wafer(page)
    else:
        dialog.get_by_label("Format").click()
        page.get_by_role("option").filter(has_text="CSV, a table").click()
        expect(text_field(page, "File name")).to_have_value(path.name)
    dialog.get_by_role("button", name="Export", exact=True).click()
    eventually(path.exists, f"{path.name} is written")
    expect(dialog).to_have_count(0)
    return str(path)
