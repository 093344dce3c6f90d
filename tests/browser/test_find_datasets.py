"""Search of the list of datasets in the page: by words, and what it says when nothing is found."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.steps import go_to, put, text_field
from wafer_viewer.gui.shell.left_panel import MANY_DATASETS
from wafer_viewer.session.state.snapshot import DatasetEntry

pytestmark = pytest.mark.browser


def entries(n: int) -> tuple[DatasetEntry, ...]:
    return tuple(
        DatasetEntry(
            fake.DATA / f"scan{k}.wafer", f"scan{k}", f"2026-03-{k + 1:02d}T07:00:00", False, True,
            lot=f"LOT-{k % 3}", wafer_id=f"W{k:02d}", product="Logic", verdict="fail" if k == 4 else "pass",
        )
        for k in range(n)
    )  # fmt: skip


def test_many_datasets_can_be_searched(serve: Callable[[fake.FakeSession], Page]) -> None:
    few = dataclasses.replace(fake.empty(), datasets=entries(MANY_DATASETS - 1))
    session = fake.FakeSession(few)
    page = serve(session)
    go_to(page, "Plan")
    expect(page.get_by_text("scan0", exact=True)).to_be_visible()
    expect(text_field(page, "Find")).to_have_count(0)
    session.change(datasets=entries(MANY_DATASETS))
    expect(text_field(page, "Find")).to_be_visible()
    put(page, text_field(page, "Find"), "lot-1 fail")
    expect(page.get_by_text("scan4", exact=True)).to_be_visible()
    expect(page.get_by_text("scan1", exact=True)).to_have_count(0)
    put(page, text_field(page, "Find"), "lot-9")
    expect(page.get_by_text(f"None of {MANY_DATASETS} datasets matches “lot-9”.")).to_be_visible()
    put(page, text_field(page, "Find"), "")
    expect(page.get_by_text("scan0", exact=True)).to_be_visible()
