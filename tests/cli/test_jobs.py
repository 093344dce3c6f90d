"""Released jobs at the prompt: the example of the README from its wafer's id to its verdict, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest

from tests.support.command_line import viewer
from tests.support.datasets.unsigned import without_manifests
from tests.test_house import ROOT
from wafer_viewer import Dataset, step_height
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES
from wafer_viewer.store.dataset.scan_record import read_record, write_record

pytestmark = pytest.mark.slow

JOB = ROOT / "assets" / "jobs" / "demonstration-wafer-A.toml"
NAMED = ("--wafer", "W1")
CORNERS = ("--corners", -2566, -371, 2570, -366)


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """The scan of the example job, and what it said.

    The noise of its frames is the same each time: by chance the faces of a scan look tilted, and U is larger.
    """
    path = tmp_path_factory.mktemp("operator") / "w7.wafer"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wafer_viewer.rigs.virtual.rig.secrets.randbits", lambda bits: 7)
        return path, viewer("scan", JOB, "-o", path, "--wafer", "W07", "--lot", "L1", *CORNERS)


def true_height_um(path):
    """The height of the job's feature on the surface that the rig scanned, by the tool that judges it."""
    seen = Dataset.open(path).result().mosaic().window()
    z_um = SCENES["wafer"].truth(*np.meshgrid(seen.x_um, seen.y_um))
    true = dataclasses.replace(seen, z_um=z_um, z_raw_um=z_um, u_um=None)
    upper, lower = read_record(path).job.features[0].places
    return step_height(true, upper, lower).height.value_um


def test_a_released_job_goes_from_the_wafers_id_to_its_verdict(judged):
    path, printed = judged
    assert printed.returncode == 0, printed.stderr
    assert "ok        Sample: W07 of lot L1." in printed.stdout
    assert "ok        Alignment: 2 corners, residual" in printed.stdout
    assert "PASS         die over street: 30." in printed.stdout
    assert printed.stdout.splitlines()[-1] == "PASS SIMULATED: Take the next wafer."
    stored = json.loads((path / "results" / "default" / "verdict.json").read_text())
    assert len(stored.pop("crc32c")) == 8
    assert (stored["wafer_id"], stored["job"], stored["simulated"]) == ("W07", "demonstration wafer A", True)
    measured = stored["items"][0]["measured"]
    assert abs(measured["value"] - true_height_um(path)) < measured["expanded"] < 0.2
    again = viewer("measure", "verdict", path)
    assert (again.returncode, json.loads(again.stdout)) == (0, stored)


def test_a_wafer_beyond_its_limits_has_status_1(judged, tmp_path):
    path = shutil.copytree(judged[0], tmp_path / "w8.wafer")
    (path / "results" / "default" / "verdict.json").unlink()
    record = read_record(path)
    low = replace(record.job.features[0], lower_limit=20.0, upper_limit=29.0)
    write_record(path, replace(record, job=replace(record.job, features=(low,))))
    without_manifests(path)
    printed = viewer("measure", "verdict", path)
    assert printed.returncode == 1
    assert json.loads(printed.stdout)["word"] == "fail"
    write_record(path, replace(record, job=replace(record.job, features=())))
    without_manifests(path)
    (path / "results" / "default" / "verdict.json").unlink()
    assert "no feature with a place" in viewer("measure", "verdict", path).stderr


@pytest.mark.parametrize(
    ("flags", "line", "sentence"),
    [
        (NAMED, "stop      Alignment: Not aligned", "Alignment: Not aligned"),
        (CORNERS, "stop      Sample: The wafer has no id", "The wafer has no id"),
        ((*NAMED, "--corners", -2566, -331, 2600, -400), "stop      Alignment: 2 corners, residual", "too large"),
        ((*NAMED, "--corners", -2566, -371), "", "1 of 2 corners are marked"),
        ((*NAMED, "--corners", 1, 2, 3), "", "3 numbers: give x and y"),
    ],
)  # fmt: skip
def test_what_is_missing_ends_it_before_anything_moves(tmp_path, flags, line, sentence):
    printed = viewer("scan", JOB, "-o", tmp_path / "w.wafer", *flags)
    assert printed.returncode == 2
    assert line in printed.stdout
    assert sentence in printed.stderr
    assert printed.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_engineer_releases_a_plan_with_a_good_dataset(judged, tmp_path):
    job = decode(JOB.read_bytes(), Job, JOB.name)
    plan = tmp_path / "plan.toml"
    fresh = replace(job, released=False, strategy="auto", recipe=Recipe(), sample=Sample(lot="L9"), revision="")
    plan.write_text(encode(fresh))
    words = ("release", plan, "--good", judged[0], "--data", tmp_path)
    assert "no revision" in viewer(*words).stderr
    printed = viewer(*words, "--revision", "B")
    assert printed.returncode == 0, printed.stderr
    path = tmp_path / "jobs" / "demonstration-wafer-B.toml"
    assert printed.stdout.strip() == str(path)
    made = decode(path.read_bytes(), Job, path.name)
    assert made.released
    assert (made.strategy, made.recipe.window, made.sample.lot) == ("z_snake", job.recipe.window, "")
    assert "choose another revision" in viewer(*words, "--revision", "B").stderr


@pytest.mark.campaign
def test_another_recipe_is_tried_on_a_stored_wafer_in_a_result_of_its_own(judged, tmp_path):
    path = shutil.copytree(judged[0], tmp_path / "w9.wafer")
    before = (path / "results" / "default" / "verdict.json").read_bytes()
    job = decode(JOB.read_bytes(), Job, JOB.name)
    tight = replace(job.features[0], lower_limit=20.0, upper_limit=29.0)
    plan = tmp_path / "plan.toml"
    plan.write_text(encode(replace(job, recipe=replace(job.recipe, window=11), features=(tight,))))
    printed = viewer("release", plan, "--revision", "B", "--data", tmp_path, "--against", path, "--dry-run")
    assert printed.returncode == 0, printed.stderr
    lines = printed.stdout.splitlines()
    assert lines[0] == "w9.wafer: PASS -> FAIL, 0 features as before, judged on revision B"
    assert lines[2].strip().startswith("Limits: 29 to 31 um before, 20 to 29 um now. Recipe: window 9 before, 11 now.")
    assert (path / "results" / "revision B" / "mosaic.zarr").is_dir()
    assert (path / "results" / "default" / "verdict.json").read_bytes() == before
