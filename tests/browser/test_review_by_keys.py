"""A hundred defects reviewed by keys alone, with the true session: what was thought of them is on the disk."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import eventually, notes, title_is
from tests.support.datasets.inspections import defect, inspection
from tests.support.datasets.judged_datasets import PIXEL_UM, RESULT, judged_dataset, released_job
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.session import Session
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.inspection_records import read_inspection, write_inspection

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
GRID = DieGrid(
    pitch_x_um=20.0, pitch_y_um=20.0, width_um=18.0, height_um=18.0, x0_um=-59.0, y0_um=-39.0, cols=6, rows=4
)
FROM_THE_TOP = sorted(GRID.places, key=lambda at: (-at[1], at[0]))
A_DIE, N_DEFECTS, WORK_S = 5, 100, 240


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    path = judged_dataset(tmp_path / "W1.wafer", 12.3, released_job(), operator="RB")
    write_inspection(Dataset.open(path).result(RESULT).path, a_hundred())
    opened = Session(tmp_path)
    opened.open_dataset(path).result(WORK_S)
    opened.wait_until(lambda now: now.surface is not None and now.inspection.inspection is not None, WORK_S)
    yield opened
    opened.close()


@pytest.mark.campaign
def test_a_hundred_defects_are_reviewed_without_the_mouse_and_what_was_thought_is_on_the_disk(
    page: Page, session: Session
):
    page.keyboard.press("Shift+R")
    title_is(page, "D1 · Particle")
    expect(page.get_by_text(f"0 of {N_DEFECTS} judged")).to_be_visible()

    page.keyboard.press("Alt+PageDown")
    expect(page.locator(".wv-alone")).to_contain_text("Die 0,3")
    expect(page.locator(".wv-defects tr")).to_have_count(A_DIE)
    press(session, page, "y", 1, judgement="real")
    title_is(page, "D2 · Particle")
    press(session, page, "n", 2, judgement="nuisance")
    title_is(page, "D3 · Particle")
    note(page, "gel, wafer edge")
    eventually(lambda: of(session, 3).note == "gel, wafer edge", "it is noted down")
    press(session, page, "3", 3, judged_kind="residue", judgement="real")
    title_is(page, "D4 · Particle")
    press(session, page, "n", 4, judgement="nuisance")
    title_is(page, "D5 · Particle")
    press(session, page, "Control+z", 4, judgement="open")
    title_is(page, "D4 · Particle")

    page.keyboard.press("Alt+PageDown")
    expect(page.locator(".wv-alone")).to_contain_text("Die 1,3")
    title_is(page, "D6 · Particle")
    page.keyboard.press("Alt+PageUp")
    expect(page.locator(".wv-alone")).to_contain_text("Die 0,3")
    title_is(page, "D4 · Particle")
    page.keyboard.press("Escape")
    expect(page.locator(".wv-alone")).to_have_count(0)
    page.keyboard.press("0")
    expect(page.locator(".wv-alone")).to_contain_text("Particle alone")
    page.keyboard.press("Escape")
    expect(page.locator(".wv-alone")).to_have_count(0)
    expect(page.get_by_text(f"3 of {N_DEFECTS} judged")).to_be_visible()
    assert notes(page).count() == 0

    kept = {
        d.number: d for d in read_inspection(Dataset.open(session.snapshot.dataset.path).result(RESULT).path).defects
    }
    told = [(kept[n].judgement, kept[n].seen_as, kept[n].note) for n in (1, 2, 3, 4)]
    assert told == [
        ("real", "particle", ""),
        ("nuisance", "particle", ""),
        ("real", "residue", "gel, wafer edge"),
        ("open", "particle", ""),
    ]
    assert {kept[n].judged_by for n in (1, 2, 3)} == {"RB"}
    assert sum(d.judgement != "open" for d in kept.values()) == 3


@pytest.mark.campaign
def test_a_hundred_defects_are_judged_with_a_hundred_keys(page: Page, session: Session):
    page.keyboard.press("Shift+R")
    title_is(page, "D1 · Particle")
    expect(page.locator(".wv-over-picture img").first).to_be_visible()
    keys = [("y", "n", "2", "6")[n % 4] for n in range(N_DEFECTS)]
    begun_s = time.monotonic()
    for key in keys:
        page.keyboard.press(key)
    eventually(lambda: all(d.judgement != "open" for d in session.snapshot.inspection.defects), "all are judged", 120)
    taken_s = time.monotonic() - begun_s
    print(f"{N_DEFECTS} judged with {len(keys)} keys in {taken_s:.1f} s")
    meant = {"y": ("real", "particle"), "n": ("nuisance", "particle"), "2": ("real", "scratch"), "6": ("real", "pit")}
    assert [(of(session, n).judgement, of(session, n).seen_as) for n in range(1, N_DEFECTS + 1)] == [
        meant[key] for key in keys
    ]
    expect(page.get_by_text(f"{N_DEFECTS} of {N_DEFECTS} judged")).to_be_visible()
    kept = read_inspection(Dataset.open(session.snapshot.dataset.path).result(RESULT).path).defects
    assert all(d.judgement != "open" for d in kept)
    assert notes(page).count() == 0


@pytest.mark.campaign
def test_classes_are_proposed_from_judgements_and_one_key_agrees(page: Page, session: Session):
    larger, smaller = tuple(range(1, 50, 8)), tuple(range(52, N_DEFECTS, 8))
    session.defects.judge(larger, "real", "residue").result(WORK_S)
    session.defects.judge(smaller, "nuisance").result(WORK_S)
    page.keyboard.press("Shift+R")
    page.get_by_text("Propose classes", exact=True).click()
    stands_on = f"Proposed from {len(larger) + len(smaller)} judged defects of this inspection"
    expect(page.locator(".wv-sub").filter(has_text=stands_on).first).to_be_visible(timeout=60_000)
    expect(page.locator(".wv-segments .on", has_text="Doubt")).to_be_visible()
    open_ones = [d for d in session.snapshot.inspection.defects if d.judgement == "open"]
    first = min(open_ones, key=lambda d: (d.learned.share, d.number))
    title_is(page, f"D{first.number} · Particle")
    expect(page.locator(".wv-learned")).to_contain_text("of the votes")
    press(session, page, "Alt+y", first.number, judgement="nuisance" if first.learned.kind == "nuisance" else "real")
    assert of(session, first.number).seen_as == ("particle" if first.learned.kind == "nuisance" else "residue")
    proposed = {d.number: d.learned.kind for d in open_ones}
    assert {proposed[n] for n in range(2, 41) if n in proposed} == {"residue"}
    assert {proposed[n] for n in range(61, 101) if n in proposed} == {"nuisance"}
    assert notes(page).count() == 0


def press(session: Session, page: Page, key: str, number: int, **then: str) -> None:
    """Press a key and wait until a defect is what it made of it."""
    page.keyboard.press(key)
    eventually(lambda: all(getattr(of(session, number), name) == to for name, to in then.items()), f"{key}: {then}")


def note(page: Page, text: str) -> None:
    page.keyboard.press("Shift+Enter")
    field = page.locator(".mantine-Modal-content input")
    expect(field).to_be_visible()
    field.focus()
    page.keyboard.type(text)
    page.wait_for_timeout(200)
    page.keyboard.press("Enter")
    expect(field).to_have_count(0)


def of(session: Session, number: int) -> Defect:
    found = session.snapshot.inspection.defect(number)
    assert found is not None
    return found


def a_hundred() -> Inspection:
    """Five on each of twenty dies, from the top, the lowest number the largest."""
    defects = tuple(_defect(n) for n in range(1, N_DEFECTS + 1))
    on_dies = [d.die for d in defects]
    dies = tuple(
        DieStatus(
            name=GRID.name(*at),
            col=at[0],
            row=at[1],
            state="whole",
            measured_fraction=1.0,
            defects=on_dies.count(GRID.name(*at)),
        )
        for at in GRID.places
    )
    return inspection(*defects, grid=GRID, dies=dies)


def _defect(number: int) -> Defect:
    at = FROM_THE_TOP[(number - 1) // A_DIE]
    x, y = (float(um) for um in GRID.to_stage(*at, 3.0 * (1 + (number - 1) % A_DIE), 9.0))
    half = 2 * PIXEL_UM
    like = defect(1, "0,0", 0.0, 0.0)
    return replace(
        like,
        number=number,
        name=f"Defect {number}",
        die=GRID.name(*at),
        center=Point(x_um=x, y_um=y),
        outline=Region.rectangle(x - half, y - half, x + half, y + half),
        major=replace(like.major, value_um=30.0 - 0.1 * number),
    )
