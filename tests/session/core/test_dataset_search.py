"""Search of the datasets of a folder: by lot, wafer, product, verdict, date and name."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.datasets.complete_dataset import complete_dataset
from tests.support.datasets.judged_datasets import judged_dataset, released_job
from wafer_viewer.cli.app import main
from wafer_viewer.session.core.dataset_library import VERDICT, datasets_in
from wafer_viewer.session.state.snapshot import DatasetEntry

ENTRY = DatasetEntry(
    Path("lot42-w07.wafer"), "lot42-w07", "2026-03-03T07:01:00+00:00", False, True,
    lot="LOT-42", wafer_id="W07", product="Logic 7", verdict="fail",
)  # fmt: skip


@pytest.mark.parametrize("words", ["", "lot-42", "w07 FAIL", "2026-03", "logic simulated", "lot42 7"])
def test_every_word_is_part_of_something(words: str) -> None:
    assert ENTRY.matches(words)


@pytest.mark.parametrize("words", ["lot-43", "w07 pass", "2026-04", "unfinished", "07:01"])
def test_one_word_that_is_nowhere_is_enough_to_miss(words: str) -> None:
    assert not ENTRY.matches(words)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    complete_dataset(tmp_path / "whole.wafer")
    judged_dataset(tmp_path / "judged.wafer", 30.0, released_job(), wafer="W9")
    (tmp_path / "no.wafer").mkdir()
    return tmp_path


@pytest.mark.slow
def test_the_verdict_on_disk_is_found_and_a_damaged_one_is_none(folder: Path) -> None:
    (found,) = [entry for entry in datasets_in(folder) if entry.name.startswith("judged")]
    assert found.verdict
    assert datasets_in(folder, f"{found.verdict} w9 l7") == (found,)
    (verdict,) = (folder / "judged.wafer").rglob(VERDICT)
    verdict.write_text("{")
    assert [entry.verdict for entry in datasets_in(folder, "judged")] == [""]


@pytest.mark.slow
def test_the_command_line_finds_them(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["find", str(folder), "judged"]) == 0
    told = capsys.readouterr().out
    assert "judged.wafer" in told
    assert "whole.wafer" not in told
    assert main(["find", str(folder), "judged", "--json"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)
    assert entry["path"] == str(folder / "judged.wafer")
    assert main(["find", str(folder), "lot-that-is-nowhere"]) == 1
