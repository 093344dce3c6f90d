"""The trigger delay as a metrologist calibrates it: a true page on a virtual rig with a hidden delay."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import go_to, notes, press, set_numbers, title_is, type_into
from tests.support.paths import ROOT
from wafer_viewer.rigs.rig_config import read_config
from wafer_viewer.session.session import Session
from wafer_viewer.store.records.calibration_records import calibration_records

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
READY_S = 180
HIDDEN_US = 62.0
"""Delay of the rig: 12 us of its calibration and 50 us beyond."""


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path / "wafers", read_config(ROOT / "assets/rigs/uncalibrated.toml"))
    yield opened
    opened.close()


@pytest.mark.campaign
def test_a_delay_is_run_seen_kept_and_listed(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready", READY_S)
    go_to(page, "Gauge check")
    page.locator("[data-pick=gauge-look][data-k=instrument]").click()
    title_is(page, "Trigger delay")
    kind = page.locator("[data-pick=calibration-kind][data-k=delay]")
    expect(kind).to_contain_text("not measured")
    press(page, "Run here…")
    set_numbers(page, "Pairs", 2)
    set_numbers(page, "z range, µm", 60)
    set_numbers(page, "Exposure, µs", 125)
    press(page, "Run here")
    expect(page.get_by_text("Result, not applied yet")).to_be_visible(timeout=READY_S * 1000)
    result = session.snapshot.calibration.pending.result
    assert calibration_records(session.snapshot.data_folder) == ()
    press(page, "Keep…")
    type_into(page, "Signed by", "K. Adler")
    type_into(page, "Reason", "new cable")
    press(page, "Keep and sign")
    today = datetime.datetime.now().astimezone().date()
    expect(kind).to_contain_text(f"{today.day} {today:%b} {today.year}")
    expect(kind).to_contain_text("±")
    expect(kind).to_contain_text("SIMULATED")
    (record,) = calibration_records(session.snapshot.data_folder)
    assert (record.signed_by, record.why, record.simulated, record.result) == ("K. Adler", "new cable", True, result)
    delay = record.result.characteristics[0]
    assert delay.value == pytest.approx(HIDDEN_US, abs=2 * delay.expanded)
    assert session.snapshot.rig.calibration.trigger_delay_us == delay.value
    expect(page.locator(".wv-dot")).to_have_count(1)
    assert notes(page).count() == 0
