"""The plan being edited, on a desk with the limits of the virtual rig."""

from __future__ import annotations

import pytest

from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.plan import FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.planning.job_releases import read_job
from wafer_viewer.session.planning.plan_editor import RIG_STARTS, PlanEditor, suggested_name
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

OUTLINE = ((-3000.0, -2000.0), (3000.0, -2000.0), (3000.0, 2000.0), (-3000.0, 2000.0))


@pytest.fixture
def command_queue():
    made = CommandQueue(Snapshot(rig=RigStatus(limits=virtual_limits(540, 720), x_um=250.0, y_um=-40.0)))
    yield made
    made.close()


@pytest.fixture
def plan_editor(command_queue, tmp_path):
    return PlanEditor(command_queue, tmp_path)


def test_every_edit_is_priced_and_can_be_undone(command_queue, plan_editor, job):
    plan_editor.edit.run(job())
    assert command_queue.now.draft.plan.strategy == "z_snake"
    assert command_queue.now.draft.free_bytes > 0
    plan_editor.edit.run(job(cols=4))
    assert len(command_queue.now.draft.plan.fields) == 4
    plan_editor.undo.run()
    assert len(command_queue.now.draft.plan.fields) == 2
    assert (command_queue.now.draft.can_undo, command_queue.now.draft.can_redo) == (True, True)
    plan_editor.redo.run()
    assert len(command_queue.now.draft.plan.fields) == 4


def test_a_plan_that_cannot_be_says_why_and_is_no_plan(command_queue, plan_editor, job):
    plan_editor.edit.run(replace(job(), sweep=FocusSweep(z_step_um=5000.0, n_frames=10)))
    assert command_queue.now.draft.plan is None
    assert "um" in command_queue.now.draft.problem
    with pytest.raises(PlanError) as refusal:
        plan_editor.ready()
    assert str(refusal.value) == command_queue.now.draft.problem


def test_before_the_rig_answers_the_plan_waits(command_queue, plan_editor, job):
    command_queue.change(rig=RigStatus())
    plan_editor.edit.run(job())
    assert command_queue.now.draft.problem == RIG_STARTS
    command_queue.change(rig=RigStatus(limits=virtual_limits(540, 720)))
    plan_editor.price()
    assert command_queue.now.draft.problem is None


def test_the_sample_is_covered_round_its_middle(command_queue, plan_editor, job):
    plan_editor.edit.run(replace(job(), sample=Sample(width_um=2000.0, height_um=1000.0)))
    before = command_queue.now.draft.job.grid.center_um
    plan_editor.cover_sample.run()
    grid = command_queue.now.draft.job.grid
    assert grid.width_um >= 2000.0 > grid.width_um - grid.pitch_x_um
    assert grid.height_um >= 1000.0 > grid.height_um - grid.pitch_y_um
    assert grid.center_um == pytest.approx(before)
    plan_editor.edit.run(replace(job(), sample=Sample()))
    with pytest.raises(PlanError, match="The sample has no size"):
        plan_editor.cover_sample.run()
    command_queue.change(overview=Overview(None, 1.0, 0.0, 0.0, OUTLINE, (), "a plate"))
    plan_editor.cover_sample.run()
    assert command_queue.now.draft.job.grid.width_um >= 6000
    assert command_queue.now.draft.job.grid.center_um == pytest.approx((0, 0), abs=1e-6)


def test_a_first_plan_can_begin_where_the_stage_stands(command_queue, plan_editor):
    plan_editor.centre_on_stage.run()
    job = command_queue.now.draft.job
    assert job.grid.center_um == pytest.approx((250.0, -40.0))
    assert job.sweep.z_step_um <= command_queue.now.rig.limits.depth_of_field_um / 2 + 0.1
    assert command_queue.now.draft.problem is None


def test_a_plan_is_kept_in_a_file_and_comes_back(command_queue, plan_editor, job, tmp_path):
    plan_editor.edit.run(job())
    path = plan_editor.save.run(None)
    assert path.parent == tmp_path
    assert read_job(path) == job()
    plan_editor.edit.run(None)
    plan_editor.load.run(path)
    assert command_queue.now.draft.job == job()
    (tmp_path / "odd.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(PlanError, match=r"odd\.toml"):
        plan_editor.load.run(tmp_path / "odd.toml")
    assert command_queue.now.draft.job == job()


def test_the_tour_needs_a_rig_that_brings_one(plan_editor, job):
    with pytest.raises(PlanError, match="virtual rig"):
        plan_editor.take_tour.run()
    plan_editor.tour = job()
    plan_editor.take_tour.run()
    assert plan_editor.ready()[0] == job()


@pytest.mark.parametrize(
    ("sample", "name"),
    [
        (Sample(lot="L 7", wafer_id="W/3"), "L-7-W-3"),
        (Sample(name="../../etc"), "etc"),
        (Sample(), "test"),
    ],
)
def test_a_file_gets_its_name_from_the_sample(job, sample, name):
    assert suggested_name(replace(job(), sample=sample)).split("-test")[0] == name
