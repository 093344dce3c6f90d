"""An inspection with what belongs to it in sight: golden dies to choose from, and a file of another tool laid over."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

from tests.browser.sessions.fake_defect_files import other_file
from tests.browser.sessions.inspected_session import InspectedSession, inspected_session
from wafer_viewer.model.inspection.defect import DefectLimits


def with_other_tool() -> InspectedSession:
    """What another tool found is laid over, and there are more defects than the limits allow."""
    session = inspected_session()
    inspection: Any = session.snapshot.inspection.inspection
    with tempfile.TemporaryDirectory() as folder:
        session.defects.files.lay_over(other_file(Path(folder), inspection)).result()
    session.defects.limit(DefectLimits(max_per_die=1, max_per_mm2=5.0))
    return session


def with_golden(page: Page) -> None:
    """Compare with a golden die: the list of them unfolds."""
    page.get_by_label("Compare", exact=True).click()
    page.get_by_role("option", name="Die to golden die").click()
