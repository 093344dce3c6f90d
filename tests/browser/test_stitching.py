"""What an operator sees of stitching: the overlay, its legend, doubted overlaps by name, colours by difference."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.stitched_session import StitchedSession
from tests.browser.steps import eventually, go_to, title_is
from tests.browser.test_recipe import choose, dropdown

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Serve = Callable[[fake.FakeSession], Page]


@pytest.fixture
def stitched() -> StitchedSession:
    return StitchedSession(3, 3, coarse=4)


def panel(page: Page) -> Locator:
    return page.locator("[data-dock-region=right]")


def legend(page: Page) -> Locator:
    return page.locator(".wv-lines")


def switch(page: Page) -> Locator:
    return page.locator("div:has(> .wv-wide) + div input[type=checkbox]")


def test_the_switch_and_its_key_show_the_fields_with_a_legend_and_name_what_is_doubted(
    serve: Serve, stitched: StitchedSession
):
    page = serve(stitched)
    go_to(page, "Surface")
    title_is(page, "Surface")
    expect(panel(page)).to_contain_text("10 of 12")
    expect(panel(page)).not_to_contain_text("Rejected because")
    expect(legend(page)).to_have_count(0)
    switch(page).check()
    expect(legend(page)).to_contain_text("drawn × 20")
    expect(legend(page)).to_contain_text("overlap rejected")
    row = panel(page).locator("tr", has_text="5\u202f–\u202f8")
    expect(row).to_contain_text("it fits at several places")
    expect(panel(page).locator("tr", has_text="6\u202f–\u202f9")).to_contain_text("nothing to compare")
    page.locator(".wv-title").first.click()  # keys are letters as long as a widget has the focus
    page.keyboard.press("o")
    expect(legend(page)).to_have_count(0)
    expect(switch(page)).not_to_be_checked()
    page.keyboard.press("o")
    expect(switch(page)).to_be_checked()
    go_to(page, "Measure")
    expect(legend(page)).to_have_count(0)


def test_details_unfold_to_what_the_stage_alone_knows(serve: Serve, stitched: StitchedSession):
    page = serve(stitched)
    go_to(page, "Surface")
    expect(panel(page)).not_to_contain_text("Known only from the stage")
    page.locator("[data-pick=recipe][data-k=stitching]").click()
    expect(panel(page)).to_contain_text("Known only from the stage")
    expect(panel(page)).to_contain_text("Bow±\u202f0.82\u202fµm")


def test_the_surface_is_coloured_by_the_difference_in_overlaps(serve: Serve, stitched: StitchedSession):
    page = serve(stitched)
    go_to(page, "Surface")
    choose(page, "Colour by", "Overlap difference")
    bar = page.locator("[data-floating-window]", has_text="one field only")
    expect(bar).to_contain_text("Difference µm")
    eventually(
        lambda: any(r.look.colour_by == "overlap" for r in stitched.painted), "tiles in those colours were asked"
    )
    shown = stitched.snapshot
    whole = stitched.shelf.surfaces[0]
    stitched.shelf.surfaces[0] = dataclasses.replace(whole, overlap_um=None)
    stitched.change(surface=dataclasses.replace(shown.surface, stamp=2))
    expect(bar).to_have_count(0)
    expect(dropdown(page, "Colour by")).to_have_value("Height")


def test_the_surface_is_coloured_by_its_uncertainty(serve: Serve, stitched: StitchedSession):
    whole = stitched.shelf.surfaces[0]
    u_um = np.where(np.isfinite(whole.z_raw_um), np.float32(0.125), np.float32(np.nan))
    stitched.shelf.surfaces[0] = dataclasses.replace(whole, u_um=u_um)
    page = serve(stitched)
    go_to(page, "Surface")
    choose(page, "Colour by", "Uncertainty")
    bar = page.locator("[data-floating-window]", has_text="not known")
    expect(bar).to_contain_text("U, k = 2 µm")
    eventually(
        lambda: any(r.look.colour_by == "uncertainty" for r in stitched.painted), "tiles in those colours were asked"
    )
    stitched.shelf.surfaces[0] = whole
    stitched.change(surface=dataclasses.replace(stitched.snapshot.surface, stamp=2))
    expect(bar).to_have_count(0)
    expect(dropdown(page, "Colour by")).to_have_value("Height")


def test_a_surface_that_the_stage_alone_placed_says_so_in_panel_and_status_line(
    serve: Serve, stitched: StitchedSession
):
    surface = stitched.snapshot.surface
    note = "Stitched by the stage's positions alone: 12 of 12 overlaps ambiguous (repeating pattern)."
    alone = dataclasses.replace(surface.stitching, n_believed=0, n_by_stage=surface.n_fields, notes=(note,))
    stitched.change(surface=dataclasses.replace(surface, stitching=alone))
    page = serve(stitched)
    go_to(page, "Surface")
    expect(panel(page).locator(".wv-notes.attention")).to_contain_text(note)
    strip = page.locator(".wv-strip span.attention", has_text="Stitched by the stage alone")
    expect(strip).to_be_visible()
    expect(strip).to_have_attribute("title", re.compile(re.escape(note)))
    stitched.change(surface=surface)
    expect(strip).to_have_count(0)


def test_what_a_person_should_look_at_is_amber_and_fields_by_the_stage_are_said(
    serve: Serve, stitched: StitchedSession
):
    surface = stitched.snapshot.surface
    asks = dataclasses.replace(surface.stitching, n_groups=2, left_out=(7,))
    stitched.change(surface=dataclasses.replace(surface, stitching=asks))
    page = serve(stitched)
    go_to(page, "Surface")
    cautions = panel(page).locator(".wv-notes.attention")
    expect(cautions).to_contain_text("Field 7 is left out: it matches none of its neighbours.")
    expect(cautions).to_contain_text("2 islands")
    expect(cautions).to_have_css("color", "rgb(138, 83, 0)")
    stitched.change(surface=dataclasses.replace(surface, stitching=None))
    expect(panel(page)).to_contain_text("Fields are placed by the stage alone")
    expect(switch(page)).to_be_disabled()
