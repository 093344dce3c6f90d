"""Old frames at the prompt: what would go, who is asked, what goes and what check says afterwards; holds."""

from __future__ import annotations

import pytest

from tests.store.dataset.test_damaged_frames import take
from tests.support.datasets.judged_datasets import CALIBRATED, RESULT, released_job, surface
from tests.support.datasets.samples import make_plan
from wafer_viewer.cli.app import main
from wafer_viewer.model.acquisition.sample import Alignment, Sample
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.dataset_library import datasets_in, save_summary, summarise
from wafer_viewer.session.core.people import PASSWORD_VARIABLE, add_person
from wafer_viewer.session.planning.verdicts import verdict_of
from wafer_viewer.store.dataset import writer as writer_module
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.retention import remove_frames
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic
from wafer_viewer.store.records.manifest import sign_result
from wafer_viewer.store.records.signed_log import recorded_actions


def judged(path, height_um):
    """A scan with frames, a surface and its verdict: pass at 12 um, fail at 20."""
    job = replace(released_job(), sample=Sample(wafer_id="W1", lot="L7"), alignment=Alignment(n_marks=2))
    plan = make_plan(replace(job, alignment=None))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer_module, "_now", lambda: "2026-03-01T10:00:00+00:00")
        with DatasetWriter.create(path, plan, job, calibration=CALIBRATED) as writer:
            take(writer)
    result = Dataset.open(path).result(RESULT)
    write_mosaic(result.mosaic_path, surface(height_um))
    save_summary(result, summarise(result.mosaic(), 2, RESULT))
    verdict_of(Dataset.open(path), result, keep=True)
    sign_result(result.path)
    return path


@pytest.fixture
def folder(tmp_path):
    judged(tmp_path / "good.wafer", 12.0)
    judged(tmp_path / "bad.wafer", 20.0)
    return tmp_path


@pytest.fixture
def prompt(capsys):
    def run(*words):
        status = main([str(word) for word in words])
        printed = capsys.readouterr()
        return status, (printed.out + printed.err).strip()

    return run


def n_frames(folder, name):
    return len(list((folder / name / "frames").glob("*.tif")))


def test_frames_are_kept_for_ever_unless_somebody_says_how_long(prompt, folder):
    status, told = prompt("tidy", folder)
    assert status == 2
    assert "are kept for ever: give --days N, or write frames_days = N into" in told
    assert prompt("tidy", folder, "--days", 30000) == (1, f"No frames in {folder} may be removed.")
    assert [entry.frames for entry in datasets_in(folder)] == ["", ""]
    (folder / "retention.toml").write_text("frames_days = 30000\n")
    assert sorted(entry.frames[:18] for entry in datasets_in(folder)) == ["", "frames kept until "]
    (folder / "retention.toml").write_text("frames_days = 'soon'\n")
    assert "retention.toml" in prompt("tidy", folder)[1]


@pytest.mark.slow
def test_only_accepted_ones_go_and_only_when_asked(prompt, folder):
    (folder / "retention.toml").write_text("frames_days = 30\n")
    status, told = prompt("tidy", folder, "--dry-run")
    assert status == 0
    assert "good.wafer" in told
    assert "bad.wafer" not in told
    assert told.splitlines()[-1].startswith("1 dataset, ")
    status, told = prompt("tidy", folder)
    assert status == 2
    assert "there is no terminal to ask at, so give --yes" in told
    assert (n_frames(folder, "good.wafer"), n_frames(folder, "bad.wafer")) == (2, 2)
    assert prompt("tidy", folder, "--yes", "--reason", "disk full", "--by", "Ann")[0] == 0
    assert (n_frames(folder, "good.wafer"), n_frames(folder, "bad.wafer")) == (0, 2)
    (entry,) = (e for e in recorded_actions(folder) if e.action == "Frames removed")
    assert (entry.by, entry.subject) == ("Ann", "good.wafer")
    assert entry.detail.endswith("freed, why: disk full")
    status, told = prompt("check", folder / "good.wafer")
    assert status == 0
    assert "The frames of good.wafer were removed by Ann on" in told
    assert "after 30 days (disk full). 2 files; none of them is lost." in told
    assert prompt("measure", "verdict", folder / "good.wafer")[0] == 0, "the verdict stays"
    assert prompt("tidy", folder, "--yes")[0] == 1
    assert [e.frames for e in datasets_in(folder, "pass")] == ["frames removed"]


def test_a_removal_that_was_broken_off_is_finished(prompt, folder):
    with pytest.raises(Exception, match="stopped at 1"):
        remove_frames(
            Dataset.open(folder / "good.wafer"), "Ann", 30, should_stop=lambda: n_frames(folder, "good.wafer") < 2
        )
    status, told = prompt("tidy", folder, "--days", 30000, "--yes")
    assert status == 0
    assert "removal was broken off" in told
    assert n_frames(folder, "good.wafer") == 0


@pytest.mark.slow
def test_held_ones_are_never_touched(prompt, folder):
    good = folder / "good.wafer"
    assert prompt("hold", good, "--reason", "complaint 7") == (0, "good.wafer is held.")
    assert prompt("tidy", folder, "--days", 30, "--yes")[0] == 1
    assert n_frames(folder, "good.wafer") == 2
    assert "held by" in prompt("check", good)[1]
    assert [e.frames for e in datasets_in(folder, "pass")] == ["held"]
    assert prompt("hold", good, "--reason", "again")[0] == 2
    assert prompt("unhold", good, "--reason", "settled")[0] == 0
    assert [(e.action, e.detail) for e in recorded_actions(folder)] == [
        ("Frames held", "why: complaint 7"),
        ("Hold ended", "why: settled"),
    ]
    assert prompt("tidy", folder, "--days", 30, "--yes")[0] == 0


@pytest.mark.slow
@pytest.mark.usefixtures("quick_passwords")
def test_where_people_are_listed_an_operator_holds_and_an_engineer_removes(prompt, folder, monkeypatch):
    add_person(folder, "Ann", "engineer", "ann's long password")
    add_person(folder, "Olga", "operator", "olga's long password")
    good = folder / "good.wafer"

    def as_olga(*words):
        monkeypatch.setenv(PASSWORD_VARIABLE, "olga's long password")
        return prompt(*words, "--by", "Olga", "--reason", "mine")

    status, told = as_olga("tidy", folder, "--days", 30, "--yes")
    assert status == 2
    assert told.endswith("Only an engineer removes frames: Ann. Olga is signed in as operator.")
    assert as_olga("hold", good)[0] == 0
    assert as_olga("unhold", good)[1].endswith("Only an engineer ends a hold: Ann. Olga is signed in as operator.")
    assert n_frames(folder, "good.wafer") == 2
