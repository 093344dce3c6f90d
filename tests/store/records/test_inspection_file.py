"""What an inspection found is kept, and what people said of it outlives the next inspection."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.datasets.inspections import defect, inspection
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.store.records.inspection_records import carry_over, read_inspection, write_inspection


def test_an_inspection_is_read_as_it_was_kept(tmp_path: Path):
    found = inspection(defect(1, "0,0", 100.0, 50.0, judged_kind="pit", judged_by="RB"), defect(2, "2,1", 5.0, 7.0))
    assert read_inspection(tmp_path / "default") is None
    write_inspection(tmp_path / "default", found)
    assert read_inspection(tmp_path / "default") == found
    assert [path.name for path in (tmp_path / "default").iterdir()] == ["defects.json"]


def test_a_torn_file_is_reported_and_not_taken_for_a_clean_wafer(tmp_path: Path):
    write_inspection(tmp_path, inspection(defect(1, "0,0", 100.0, 50.0)))
    path = tmp_path / "defects.json"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(WaferViewerError, match=r"defects\.json"):
        read_inspection(tmp_path)


def test_a_folder_that_is_a_file_is_reported(tmp_path: Path):
    (tmp_path / "default").write_text("")
    with pytest.raises(DatasetError, match="cannot be written"):
        write_inspection(tmp_path / "default", inspection())


def test_judgements_follow_the_position_not_the_number():
    message = {
        "judgement": "real",
        "judged_kind": "residue",
        "note": "gel",
        "judged_by": "RB",
        "judged_at": "2026-11-22",
    }
    before = inspection(defect(1, "0,0", 100.0, 50.0, **message), defect(2, "0,0", 300.0, 50.0))
    again = carry_over(before, inspection(defect(1, "0,0", 300.0, 50.0), defect(2, "0,0", 103.0, 51.0)))
    assert [d.judgement for d in again.defects] == ["open", "real"]
    assert {name: getattr(again.defects[1], name) for name in message} == message
    assert again.defects[1].kind == "particle"
    assert again.notes == ()


def test_a_word_is_given_once_and_to_the_nearest():
    before = inspection(defect(1, "0,0", 100.0, 50.0, judgement="nuisance"))
    again = carry_over(before, inspection(defect(1, "0,0", 104.0, 50.0), defect(2, "0,0", 99.0, 50.0)))
    assert [d.judgement for d in again.defects] == ["open", "nuisance"]


def test_a_judged_defect_that_is_gone_is_reported():
    before = inspection(defect(7, "0,0", 100.0, 50.0, note="look again"))
    again = carry_over(before, inspection(defect(1, "1,0", 100.0, 50.0)))
    assert again.notes == ("Judged before and not found this time: 7 of the inspection before.",)
