"""How the surface was made, and choosing how it is made again."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.steps import eventually, go_to, press, title_is
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Recipe

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]


def dropdown(page: Page, label: str) -> Locator:
    row = page.locator(".mantine-Flex-root", has=page.locator("label", has_text=re.compile(f"^{label}$")))
    return row.locator("input:not([type=hidden])").last


def choose(page: Page, label: str, name: str) -> None:
    dropdown(page, label).click()
    page.get_by_role("option", name=name, exact=True).last.click()


def test_a_surface_is_made_again_by_a_ready_recipe_with_one_change(serve: Callable[[fake.FakeSession], Page]):
    session = fake.FakeSession(fake.measured())
    page = serve(session)
    go_to(page, "Surface")
    title_is(page, "Surface")
    panel = page.locator("[data-dock-region=right]")
    expect(panel).to_contain_text("Log-Laplacian · window 9\u202fpx · Centred")
    expect(panel).not_to_contain_text("Chosen from the data")
    page.locator("[data-pick=recipe][data-k=values]").click()
    expect(panel).to_contain_text("Width of a focus curve7.6\u202fµm")
    page.locator("[data-pick=recipe][data-k=form]").click()
    expect(dropdown(page, "Window")).to_have_value("From the data")
    choose(page, "Preset", "The paper's method")
    expect(dropdown(page, "Smoothing")).to_have_value("Levy, literal")
    expect(dropdown(page, "Beside walls")).to_be_disabled()
    choose(page, "Fill", "Small gaps")
    expect(dropdown(page, "Preset")).to_have_value("Custom")
    press(page, "Reconstruct again")
    assert "reconstruct" not in [name for name, _, _ in session.asked]
    press(page, "Replace the surface of coupon-07")
    eventually(lambda: bool(session.asked), "the session was asked")
    paper = Recipe.paper()
    assert session.asked[-1][:2] == ("reconstruct", (replace(paper, fill=replace(paper.fill, mode="small_gaps")),))
