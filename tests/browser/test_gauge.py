"""A check against gauge blocks as an operator makes it, on three scans of the blocks in a true session."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.kept_page import PATIENCE_MS
from tests.browser.sessions.gauge_blocks import CERTIFICATE_TOML, dataset_of_blocks
from tests.browser.steps import (
    camera_at_rest,
    drag_at,
    eventually,
    go_to,
    on_screen,
    press,
    set_numbers,
    stored,
    title_is,
    type_into,
)
from wafer_viewer.session.session import Session
from wafer_viewer.store.records.calibration_records import signed_checks

pytestmark = [pytest.mark.browser, pytest.mark.slow]
SCANS = ("scan-1", "scan-2", "scan-3")


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    """The first of three scans of the blocks is open; beside them lie a certificate that holds and an expired one."""
    for k, name in enumerate(SCANS):
        off_um = (0.0, 0.04, -0.03)[k]
        dataset_of_blocks(tmp_path / f"{name}.wafer", 399.9 + off_um, k + 1, f"2026-11-21T09:{12 + 8 * k}:00")
    (tmp_path / "blocks.toml").write_text(CERTIFICATE_TOML.format(expires="2099-03-14"))
    (tmp_path / "expired.toml").write_text(CERTIFICATE_TOML.format(expires="2026-03-14"))
    made = Session(tmp_path)
    made.wait_until(lambda now: now.rig.state == "ready" and not now.reopening, 120)
    made.open_dataset(tmp_path / "scan-1.wafer").result(60)
    yield made
    made.close()


@pytest.fixture
def folder(session: Session) -> Path:
    return session.snapshot.data_folder


def verdict(page: Page) -> Locator:
    return page.get_by_label("Verdict", exact=True)


def repeats(page: Page) -> Locator:
    return page.locator("[data-pick=gauge-drop]")


def earlier(page: Page) -> Locator:
    return page.locator("tr[data-pick=gauge-record]")


def figure(page: Page) -> Locator:
    return page.locator(".wv-gauge-glass")


def take_certificate(page: Page, path: Path) -> None:
    page.get_by_role("button", name="Certificate…", exact=True).click()
    type_into(page, "Path", str(path))
    press(page, "Use certificate")
    expect(page.get_by_role("dialog")).to_have_count(0)


def middle_on_screen(page: Page, region: dict) -> tuple[float, float]:
    """Where the middle of a region on the lower face is seen, in pixels of the window."""
    (x0, y0), (x1, y1) = region["points"]
    return on_screen(page, ((x0 + x1) / 2e3, (y0 + y1) / 2e3, 0.01))


def drag_lower(page: Page) -> None:
    """Drag the lower region by its middle once the camera rests, until the browser remembers it somewhere else."""

    def at_rest() -> bool:
        return camera_at_rest(page) and len(stored(page, "view").get("faces", ())) == 2

    eventually(at_rest, "faces laid, and the camera at rest", PATIENCE_MS / 1000)
    before = stored(page, "view")["faces"]

    def followed() -> bool:
        drag_at(page, middle_on_screen(page, before[1]), (-8, 4))
        page.wait_for_timeout(1000)
        return stored(page, "view")["faces"][1] != before[1]

    eventually(followed, "the region followed the pointer", PATIENCE_MS / 1000)
    assert stored(page, "view")["faces"][0] == before[0]


def begin(page: Page) -> None:
    """Look at the surface, so that it is drawn, and go to the check."""
    go_to(page, "Surface")
    expect(page.locator("[data-floating-window]", has_text="Height").last).to_be_visible()
    go_to(page, "Gauge check")
    title_is(page, "Gauge check")


def open_scan(page: Page, folder: Path, name: str) -> None:
    go_to(page, "Surface")
    page.locator(f"[data-pick=open][data-k='{folder / name}.wafer']").click()
    expect(page.locator(".wv-mark small")).to_have_text(name)
    go_to(page, "Gauge check")


def test_three_scans_are_measured_signed_and_still_there_after_a_reload(page: Page, session: Session, folder: Path):
    begin(page)
    for point in ("Clean the blocks, wring them", "Warm up 20 min"):
        page.keyboard.press("Enter")
        expect(page.get_by_label(f"{point}, done")).to_be_visible()
    press(page, "Load the certificate…")
    type_into(page, "Path", str(folder / "blocks.toml"))
    press(page, "Use certificate")
    expect(page.locator("[data-dock-region=right]")).to_contain_text("valid until 14 Mar 2099")
    set_numbers(page, "Limit, ± µm", 0.5)
    expect(figure(page)).to_contain_text("live")
    drag_lower(page)
    press(page, "Measure the step")
    expect(verdict(page)).to_contain_text("PASS")
    expect(repeats(page)).to_have_count(1)
    for n, name in enumerate(SCANS[1:], 2):
        open_scan(page, folder, name)
        expect(page.get_by_role("button", name="Measure again")).to_be_enabled()
        press(page, "Measure again")
        expect(repeats(page)).to_have_count(n)
    expect(figure(page)).to_contain_text("mean of 3")
    press(page, "Sign and save")
    type_into(page, "Signed by", "K. Adler")
    press(page, "Sign and save")
    expect(earlier(page)).to_have_count(1)
    expect(earlier(page)).to_contain_text("pass")
    page.reload()
    title_is(page, "Gauge check")
    earlier(page).click()
    title_is(page, "Earlier check")
    expect(page.locator(".wv-sub").first).to_contain_text("Signed by K. Adler")
    expect(page.locator(".wv-dot.pass")).to_have_count(1)
    (signed,) = signed_checks(folder)
    assert (signed.check.signed_by, signed.check.verdict) == ("K. Adler", "pass")
    check = session.snapshot.findings[-1]
    assert (check.n, check.signed_by) == (3, "K. Adler")
    assert abs(check.deviation.value_um) < 0.15


@pytest.mark.campaign
def test_the_same_scan_twice_and_an_expired_certificate_are_refused_in_a_sentence(page: Page, folder: Path):
    begin(page)
    take_certificate(page, folder / "blocks.toml")
    expect(figure(page)).to_contain_text("live")
    press(page, "Measure the step")
    expect(verdict(page)).to_contain_text("NO VERDICT")
    press(page, "Measure again")
    expect(page.locator(".wv-note.fault")).to_contain_text("is in the check already: a repeat is a new scan")
    take_certificate(page, folder / "expired.toml")
    expect(page.locator(".wv-note", has_text="No check")).to_contain_text(
        "Certificate K-2231 expired on 2026-03-14 and the scan is of 2026-11-21: have the blocks certified again."
    )
    expect(page.get_by_role("button", name="Measure the step")).to_be_disabled()
