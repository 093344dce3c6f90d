"""A new revision of a job tried on stored wafers at the prompt: which verdicts change, and why."""

from __future__ import annotations

import pytest

from tests.support.datasets.judged_datasets import ELSEWHERE, STEP, judged_dataset, released_job
from wafer_viewer.cli.app import main
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Die, Dies
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import decode, encode, replace


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Two wafers: one that passed in the middle of its limits, one so near the upper one that nothing is decided."""
    folder = tmp_path_factory.mktemp("stored")
    for name, height_um in (("w1", 12.0), ("w2", 12.995)):
        judged_dataset(folder / f"{name}.wafer", height_um, released_job(), wafer=name)
    return folder


@pytest.fixture
def release(tmp_path, stored, capsys):
    """Release a job as another revision at the prompt; returns the status and the lines that it said."""

    def run(job: Job, *flags: object):
        plan = tmp_path / "coupon.toml"
        plan.write_text(encode(job))
        words = ["release", plan, "--revision", "B", "--data", tmp_path, "--against", stored, *flags]
        status = main([str(word) for word in words])
        printed = capsys.readouterr()
        return status, (printed.out + printed.err).splitlines()

    return run


def kept(stored):
    return {path: path.read_bytes() for path in sorted(stored.rglob("*")) if path.is_file()}


@pytest.mark.slow
def test_a_limit_that_changed_is_judged_on_the_height_that_was_kept(release, stored, tmp_path):
    before = kept(stored)
    status, lines = release(released_job(replace(STEP, upper_limit=12.5)))
    assert status == 0
    assert lines[0].startswith("w1.wafer: PASS, 1 feature as before")
    assert lines[1].startswith("w2.wafer: INCONCLUSIVE -> FAIL")
    assert lines[2].startswith("  die over street: INCONCLUSIVE -> FAIL (12.9")
    assert lines[3] == "    Limits: 11 to 13 um before, 11 to 12.5 um now."
    assert lines[4] == "coupon B: 1 of 2 verdicts changes; 1 of 2 wafers gets another word."
    made = tmp_path / "jobs" / "coupon-B.toml"
    assert lines[5] == str(made)
    job = decode(made.read_bytes(), Job, made.name)
    assert (job.released, job.revision, job.features[0].upper_limit) == (True, "B", 12.5)
    assert kept(stored) == before, "nothing of a stored dataset is touched"


def test_a_decision_rule_that_changed_is_named_and_a_dry_run_releases_nothing(release, tmp_path):
    _, lines = release(released_job(replace(STEP, decision_rule="simple_acceptance")), "--dry-run")
    assert lines[1].startswith("w2.wafer: INCONCLUSIVE -> PASS")
    assert lines[3] == "    Decision rule: guard band before, simple acceptance now."
    assert lines[4] == "coupon B: 1 of 2 verdicts changes; 1 of 2 wafers gets another word."
    assert not (tmp_path / "jobs").exists()


def test_a_place_that_changed_is_measured_anew(release):
    _, lines = release(released_job(replace(STEP, places=ELSEWHERE)), "--dry-run")
    assert lines[1].startswith("  die over street: PASS -> FAIL (12.0")
    assert "; -12.0" in lines[1].replace("-11.9", "-12.0")
    assert lines[2] == "    Place: another one; measured again."


def test_features_that_are_new_or_gone_are_reported(release):
    mode = (Region.point(-40, 0), Region.point(40, 0))
    other = replace(STEP, name="pad over die", tool="distance", quantity="dz", places=mode)
    _, lines = release(released_job(other), "--dry-run")
    assert "  pad over die: not judged -> " in lines[1]
    assert lines[2] == "    The feature is new."
    assert lines[3].startswith("  die over street: PASS -> not judged")
    assert lines[4] == "    The feature is taken off."


def test_a_feature_over_dies_says_which_die_fails(release):
    dies = Dies(width_um=50, height_um=60, listed=(Die(name="left", x_um=-55, y_um=-30),))
    on_die = replace(STEP, per_die=True, places=(Region.rectangle(5, 0, 45, 60), Region.rectangle(65, 0, 105, 60)))
    _, lines = release(released_job(on_die, dies=dies), "--dry-run")
    assert "  die over street, die left: not judged -> PASS" in lines[1]


def test_datasets_that_cannot_be_judged_are_named_with_the_reason(release, stored, tmp_path):
    other = replace(released_job(), product="anchor")
    _, lines = release(other, "--dry-run")
    assert lines[:2] == [
        f"{name}.wafer: not judged. It is of the product 'coupon', and the job of 'anchor'." for name in ("w1", "w2")
    ]
    assert lines[2] == "anchor B: No verdict of 0 changes; no wafer of 0 gets another word, 2 datasets not judged."
    recipe = replace(released_job().recipe, window=11)
    _, lines = release(replace(released_job(), recipe=recipe), "--dry-run")
    assert "no field with all its frames" in lines[0], "another recipe needs the frames, and these have none"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"features": ()}, "no feature"),
        ({"released": False, "strategy": "auto"}, "still holds an 'auto'"),
        ({"product": " "}, "no product"),
    ],
)
def test_what_cannot_be_released_is_refused_before_anything_is_judged(release, change, words):
    status, lines = release(replace(released_job(), **change))
    assert status == 2
    assert len(lines) == 1
    assert words in lines[0]


def test_a_revision_that_is_there_is_refused_before_anything_is_judged(release):
    assert release(released_job())[0] == 0
    status, lines = release(released_job())
    assert (status, len(lines)) == (2, 1)
    assert "choose another revision" in lines[0]


def test_a_folder_without_a_dataset_is_refused(tmp_path, capsys):
    plan = tmp_path / "plan.toml"
    plan.write_text(encode(released_job()))
    words = ["release", str(plan), "--revision", "B", "--data", str(tmp_path), "--against", str(tmp_path / "none")]
    assert main(words) == 2
    assert "There is no dataset in" in capsys.readouterr().err
