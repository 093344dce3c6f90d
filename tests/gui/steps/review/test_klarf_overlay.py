"""What another tool found beside what was found here: counted on both sides, the rest listed, all of it on the map."""

from __future__ import annotations

from html import unescape
from pathlib import Path

from tests.browser.sessions.fake_defect_files import other_file
from tests.browser.sessions.inspected_session import PLANTED, found
from wafer_viewer.gui.steps.review.dialogs import FORMATS, LOSES, other_marks, overlay_html
from wafer_viewer.session.inspection.inspection_files import TITLES, WRITERS, overlay_klarf

INSPECTION = found(PLANTED)


def test_both_sides_are_counted_and_the_rest_is_listed(tmp_path: Path):
    other = overlay_klarf(other_file(tmp_path, INSPECTION), None, INSPECTION, within_um=20.0)
    text = unescape(overlay_html(other, INSPECTION.defects))
    assert "8 places of another tool: 6 found here too, 2 not." in text
    assert "1 found here is not in the file." in text
    assert "The same within 20 µm" in text
    assert text.count('data-pick="defect-other"') == 2
    assert 'data-k="90"' in text


def test_all_of_it_is_on_the_map_and_can_be_clicked(tmp_path: Path):
    other = overlay_klarf(other_file(tmp_path, INSPECTION), None, INSPECTION)
    marks = other_marks(other)
    assert len(marks) == 8
    assert {mark.shape for mark in marks} == {"ring"}
    assert "defect-other" in marks[0].attributes
    assert other_marks(None) == []


def test_every_export_is_offered_with_what_it_loses():
    assert {kind for kind, _ in FORMATS.values()} == set(LOSES) == set(WRITERS) == set(TITLES)
