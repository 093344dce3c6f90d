"""Released jobs: how one comes to be, what stays as it is, aligning a wafer, and the next one."""

from __future__ import annotations

import pytest

from tests.session.conftest import small_job
from tests.support.datasets.released import DIE, SETTLED, engineered, release_of
from wafer_viewer.model.acquisition.sample import Alignment, Sample
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.rigs.virtual.rig import CALIBRATION, SETUP, virtual_limits
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.planning.job_releases import list_released, write_released
from wafer_viewer.session.planning.plan_editor import PlanEditor
from wafer_viewer.session.planning.preflight import preflight_of_snapshot, stops
from wafer_viewer.session.planning.revision_trial import JobController
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

LIMITS = virtual_limits(540, 720)
LEFT, RIGHT = (-1990.0, 5.0), (2010.0, 5.0)


@pytest.fixture
def command_queue():
    rig = RigStatus(state="ready", limits=LIMITS, calibration=CALIBRATION, setup=SETUP)
    made = CommandQueue(Snapshot(rig=rig))
    yield made
    made.close()


@pytest.fixture
def plan_editor(command_queue, tmp_path):
    return PlanEditor(command_queue, tmp_path)


@pytest.fixture
def taken_up(plan_editor, tmp_path):
    """A released job, taken up from its file."""
    plan_editor.load.run(write_released(tmp_path, release_of(small_job())))
    return plan_editor


def draft(command_queue):
    return command_queue.now.draft


def test_a_release_settles_what_was_auto_and_forgets_the_wafer(command_queue, plan_editor, tmp_path):
    job = replace(engineered(small_job()), sample=Sample(wafer_id="W1", lot="L1", operator="me", width_um=6000.0))
    plan_editor.edit.run(job)
    path = plan_editor.release(SETTLED, (2.5, 0.9))
    stored = decode(path.read_text(), type(job), path.name)
    assert (path.parent.name, path.name) == ("jobs", "wafer-A.toml")
    assert stored.released
    assert not stored.recipe.has_auto
    assert (stored.recipe.window, stored.recipe.stitching.stage_error_um) == (9, 2.5)
    assert stored.strategy == draft(command_queue).plan.strategy == "z_snake"
    assert stored.sample == Sample(width_um=6000.0)
    assert stored.features == (DIE,)
    assert draft(command_queue).job == stored
    assert decode(encode(stored), type(stored), "again") == stored


def test_a_revision_is_never_overwritten(command_queue, plan_editor):
    plan_editor.edit.run(engineered(small_job()))
    plan_editor.release(SETTLED, None)
    plan_editor.copy.run()
    assert not draft(command_queue).job.released
    plan_editor.edit.run(replace(draft(command_queue).job, revision="A"))
    with pytest.raises(PlanError, match=r"Revision A of wafer is released already .*: choose another revision"):
        plan_editor.release(SETTLED, None)
    plan_editor.edit.run(replace(draft(command_queue).job, revision="B"))
    assert plan_editor.release(SETTLED, None).name == "wafer-B.toml"


@pytest.mark.parametrize(
    ("change", "settled", "words"),
    [
        ({"revision": " "}, SETTLED, "no revision"),
        ({"marks": None}, SETTLED, "two corners"),
        ({"features": ()}, SETTLED, "no feature"),
        ({"features": (replace(DIE, places=()),)}, SETTLED, "'die over street' has no place"),
        ({}, Recipe(), "'auto'"),
        ({}, None, "no surface"),
    ],
)
def test_what_is_missing_for_a_release_is_reported(plan_editor, tmp_path, change, settled, words):
    plan_editor.edit.run(replace(engineered(small_job()), **change))
    with pytest.raises(PlanError, match=words):
        plan_editor.release(settled, None)
    assert list_released(tmp_path) == ()


def test_released_jobs_are_listed_by_product_newest_revision_first(command_queue, plan_editor, tmp_path):
    for product, revision in (("wafer", "A"), ("Anchor", "1"), ("wafer", "B")):
        write_released(tmp_path, replace(release_of(small_job()), product=product, revision=revision))
    (tmp_path / "jobs" / "plan.toml").write_text(encode(small_job()))
    (tmp_path / "jobs" / "torn.toml").write_text("product = ")
    JobController(command_queue, plan_editor, tmp_path).refresh.run()
    listed = [(e.product, e.revision, e.n_fields, e.n_features) for e in command_queue.now.operating.jobs]
    assert listed == [("Anchor", "1", 2, 1), ("wafer", "B", 2, 1), ("wafer", "A", 2, 1)]


def test_a_released_job_takes_names_and_nothing_else(command_queue, taken_up):
    job = draft(command_queue).job
    named = replace(job, sample=replace(job.sample, wafer_id="W9", operator="K. Adler"))
    taken_up.edit.run(named)
    assert draft(command_queue).job.sample.wafer_id == "W9"
    for change in ({"exposures_us": (50.0,)}, {"features": ()}, {"product": "other"}, {"sample": Sample(notch="up")}):
        with pytest.raises(PlanError, match="released and stays as it is"):
            taken_up.edit.run(replace(named, **change))
    with pytest.raises(PlanError, match="stays as it is"):
        taken_up.centre_on_stage.run()
    assert draft(command_queue).job == named
    taken_up.copy.run()
    taken_up.edit.run(replace(draft(command_queue).job, exposures_us=(50.0,)))
    assert draft(command_queue).job.exposures_us == (50.0,)


def align(plan_editor):
    plan_editor.mark.run(0, *LEFT)
    plan_editor.mark.run(1, *RIGHT)


def test_two_corners_align_the_wafer_and_move_its_fields(command_queue, taken_up):
    taken_up.mark.run(1, *RIGHT)
    assert draft(command_queue).marked_um == (None, RIGHT)
    assert draft(command_queue).job.alignment is None
    taken_up.mark.run(0, *LEFT)
    found = draft(command_queue).job.alignment
    assert (found.n_marks, found.residual_um) == (2, pytest.approx(0, abs=1e-6))
    on_stage, planned = draft(command_queue).plan.fields, release_of(small_job()).all_fields()
    assert [(a.x_um - b.x_um, a.y_um - b.y_um) for a, b in zip(on_stage, planned, strict=True)] == [
        (pytest.approx(10), pytest.approx(5))
    ] * 2
    taken_up.mark.run(0, -1980.0, 5.0)
    assert draft(command_queue).job.alignment.residual_um == pytest.approx(5)
    taken_up.unmark.run()
    assert (draft(command_queue).job.alignment, draft(command_queue).marked_um) == (None, (None, None))


def test_corners_that_make_no_alignment_are_refused_and_can_be_marked_again(command_queue, taken_up):
    taken_up.mark.run(0, *LEFT)
    with pytest.raises(PlanError, match="turned by"):
        taken_up.mark.run(1, 0.0, 2010.0)
    assert draft(command_queue).job.alignment is None
    taken_up.mark.run(1, *RIGHT)
    assert draft(command_queue).job.alignment.n_marks == 2
    with pytest.raises(PlanError, match="no corner 3"):
        taken_up.mark.run(2, 0.0, 0.0)


def test_another_wafer_is_aligned_anew(command_queue, taken_up):
    job = draft(command_queue).job
    taken_up.edit.run(replace(job, sample=replace(job.sample, wafer_id="W1", operator="me")))
    align(taken_up)
    aligned = draft(command_queue).job
    assert stops(preflight_of_snapshot(command_queue.now, None, "2026-11-21")) == ()
    taken_up.edit.run(replace(aligned, sample=replace(aligned.sample, operator="you")))
    assert draft(command_queue).job.alignment is not None, "the operator's name moves no wafer"
    now = draft(command_queue).job
    taken_up.edit.run(replace(now, sample=replace(now.sample, wafer_id="W2")))
    assert (draft(command_queue).job.alignment, draft(command_queue).marked_um) == (None, (None, None))
    align(taken_up)
    taken_up.next_wafer.run()
    now = draft(command_queue)
    assert (now.job.sample.wafer_id, now.job.sample.operator, now.job.alignment) == ("", "you", None)
    assert not now.can_undo, "what was of the last wafer cannot come back"
    assert [c.what for c in stops(preflight_of_snapshot(command_queue.now, None, "2026-11-21"))] == [
        "Sample",
        "Alignment",
    ]


def test_a_plan_that_is_opened_again_waits_for_a_person(command_queue, plan_editor):
    plan_editor.reopen(replace(engineered(small_job()), alignment=Alignment(n_marks=2)))
    assert draft(command_queue).job.alignment is None, "the wafer may have been taken off meanwhile"
    plan_editor.reopen(small_job())
    assert [c.what for c in stops(preflight_of_snapshot(command_queue.now, None, "2026-11-21"))] == ["Sample"]
    plan_editor.edit.run(replace(small_job(), exposures_us=(50.0,)))
    assert not draft(command_queue).confirmed
    plan_editor.confirm.run()
    assert stops(preflight_of_snapshot(command_queue.now, None, "2026-11-21")) == ()
