"""The exposure found and the proposed bracket, as the page says it."""

from __future__ import annotations

import re
from html import unescape

from wafer_viewer.gui.steps.plan import found_exposure
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.procedure import ExposureLevels, FoundExposure
from wafer_viewer.model.job import Job
from wafer_viewer.session.state.snapshot import Draft, Snapshot

SINGLE = ExposureLevels(71.4, 0.79, 0.00004, 0.058, 0.03, 3)
LONGER = ExposureLevels(455.0, 1.0, 0.613, 0.0, 0.0, 1)
FOUND = FoundExposure(SINGLE, (), (1, 3, 4), (0.0, 29.5, 59.0), 128)
WITH_BRACKET = FoundExposure(SINGLE, (SINGLE, LONGER), (3,), (0.0, 59.0), 48)


def said(found, exposures_us):
    grid = FieldGrid(rows=2, cols=2, field_width_um=336.0, field_height_um=252.0)
    job = Job(grid=grid, sweep=FocusSweep(z_step_um=1.0, n_frames=60), exposures_us=exposures_us)
    html = found_exposure(Snapshot(draft=Draft(job=job), exposure=found))
    return unescape(re.sub(r"\s+", " ", re.sub("<[^>]*>", " ", html))).replace("\u202f", " "), html


def test_the_result_names_the_exposure_the_level_and_what_was_looked_at():
    text, html = said(FOUND, (71.4,))
    assert "71.4 µs suits the brightest field" in text
    assert "Brightest pixels at 79 % of white in field 3; searched in fields 1, 3, 4, 3 positions over 59.0 µm." in text
    assert "bracket" not in html


def test_a_proposed_bracket_has_its_figures_and_a_link_until_it_is_taken():
    text, html = said(WITH_BRACKET, (71.4,))
    assert "5.8 % of the pixels are darker than 5 % of white: a bracket shows them." in text
    assert "71.4 < 0.1 % 5.8 % 455 61.3 % 0.0 %" in text
    assert 'data-pick="bracket"' in html
    text, html = said(WITH_BRACKET, (71.4, 455.0))
    assert "455 61.3 % 0.0 %" in text
    assert 'data-pick="bracket"' not in html


def test_an_exposure_typed_since_hides_it():
    assert said(FOUND, (80.0,))[1] == ""
    assert said(None, (80.0,))[1] == ""
