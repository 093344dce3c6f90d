"""Every screen looked over at every size of the window, light and dark: see audit.py and audit.js."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from tests.browser.audit import GROUPS, look_over

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]


@pytest.mark.parametrize("name", GROUPS)
def test_nothing_is_covered_cut_nameless_or_pale(browser: Browser, name: str):
    found = look_over(browser, GROUPS[name])
    assert not found, "\n".join(
        f"{what}   [{', '.join(dict.fromkeys(where))}]" for what, where in sorted(found.items())
    )
