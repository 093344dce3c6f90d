"""The list of surfaces: all fields with heights, of very many the first and the one that is shown."""

from __future__ import annotations

from dataclasses import replace

from tests.browser.sessions import fake_session as fake
from wafer_viewer.gui.steps.surface.surface_step import MOST_LISTED, _listed


def test_the_list_holds_all_fields_with_heights():
    data = fake.measured().dataset
    assert _listed(data, 0) == list(range(1, 10))
    assert _listed(None, 0) == []


def test_the_list_of_very_many_fields_is_short_and_holds_the_field_that_is_shown():
    data = replace(fake.measured().dataset, stamps=dict.fromkeys(range(1, 5001), 1))
    assert _listed(data, 0) == list(range(1, MOST_LISTED + 1))
    assert _listed(data, 4000) == [*range(1, MOST_LISTED + 1), 4000]
    assert _listed(data, 9000) == list(range(1, MOST_LISTED + 1))
