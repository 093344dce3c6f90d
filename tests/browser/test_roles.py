"""People with roles on the page: nobody works who is not signed in, and an operator sees what is not for operators."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import eventually, put, text_field
from tests.session.conftest import small_job
from tests.support.datasets.released import release_of
from wafer_viewer.session.core.audit_trail import record
from wafer_viewer.session.core.people import add_person
from wafer_viewer.session.planning.job_releases import write_released
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 400.0
ANN, OLGA = "ann's long password", "olga's long password"


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    add_person(tmp_path, "Ann", "engineer", ANN)
    add_person(tmp_path, "Olga", "operator", OLGA)
    path = write_released(tmp_path, release_of(small_job()))
    record(tmp_path, "Job released", path.name, by="Ann", wrote=path)
    opened = Session(tmp_path)
    yield opened
    opened.close()


def sign_in(page: Page, name: str, password: str) -> None:
    page.get_by_role("button", name="Sign in…", exact=True).first.click()
    put(page, text_field(page, "Your name"), name)
    put(page, text_field(page, "Password"), password)
    page.get_by_role("dialog").get_by_role("button", name="Sign in", exact=True).click()


def test_an_operator_runs_released_jobs_and_an_engineer_changes_plans(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready", WORK_S)
    strip = page.locator("[data-dock-region=right] .wv-note.busy")
    expect(strip).to_contain_text("Nobody is signed in on this browser.")
    for name in ("Plan a scan", "Open…", "Save plan…"):
        expect(page.get_by_role("button", name=name, exact=True)).to_be_disabled()
    sign_in(page, "Olga", "not her password")
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("The name or the password is wrong.")
    masked = text_field(page, "Password").evaluate("field => getComputedStyle(field).webkitTextSecurity")
    assert masked == "disc", "nobody reads a password over a shoulder"
    put(page, text_field(page, "Password"), OLGA)
    dialog.get_by_role("button", name="Sign in", exact=True).click()
    expect(strip).to_contain_text("Olga is signed in as operator.")
    expect(strip).to_contain_text("Only an engineer changes plans, jobs, recipes, calibrations and verdicts: Ann.")
    expect(page.locator(".wv-strip")).to_contain_text("Olga, operator: you hold the controls")
    expect(page.get_by_role("button", name="Open…", exact=True)).to_be_enabled()
    for name in ("Plan a scan", "Save plan…"):
        expect(page.get_by_role("button", name=name, exact=True)).to_be_disabled()
    told = "Not yet: choose a released job: operators run no other plan."
    expect(page.locator("[data-dock-region=right]")).to_contain_text(told)

    page.locator("[data-pick=job]", has_text="wafer").click()
    eventually(lambda: session.snapshot.draft.job is not None, "the released job is taken up")
    expect(text_field(page, "Wafer id")).to_be_enabled()
    page.get_by_role("button", name="Show everything", exact=True).click()
    expect(page.get_by_role("button", name="Save plan…", exact=True)).to_be_disabled()
    page.get_by_role("button", name="Sign out", exact=True).click()
    expect(strip).to_contain_text("Nobody is signed in on this browser.")
    sign_in(page, "Ann", ANN)
    expect(strip).to_have_count(0)
    expect(page.get_by_role("button", name="Save plan…", exact=True)).to_be_enabled()
    expect(page.locator(".wv-strip")).to_contain_text("Ann, engineer: you hold the controls")
