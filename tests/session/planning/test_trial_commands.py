"""The plan tried on stored wafers from the page: which job is tried, how far it is, that it can be given up."""

from __future__ import annotations

from concurrent.futures import Future

import pytest

from tests.session.conftest import small_job
from tests.support.datasets.judged_datasets import STEP, judged_dataset, released_job
from tests.support.datasets.released import SETTLED, engineered
from wafer_viewer.model.errors import ComputeError, DatasetError, PlanError
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Stitching
from wafer_viewer.rigs.virtual.rig import CALIBRATION, SETUP, virtual_limits
from wafer_viewer.session.core.background_work import BackgroundWork, Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.planning.plan_editor import PlanEditor
from wafer_viewer.session.planning.revision_trial import TrialController, try_job
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

PATIENCE_S = 20.0
STITCHED = Stitching(search_um=20.0, stage_error_um=2.0, z_error_um=1.0, tilt_error=1e-4)


class Workers:
    """Compute that waits to be told what a task came to."""

    def __init__(self) -> None:
        self.asked, self.cancelled = [], []

    def lead(self, work, task, *args):
        self.asked.append((work, task, args, Future()))
        return self.asked[-1][-1]

    def cancel(self, work):
        self.cancelled.append(work)


@pytest.fixture
def trials(tmp_path):
    rig = RigStatus(state="ready", limits=virtual_limits(540, 720), calibration=CALIBRATION, setup=SETUP)
    command_queue = CommandQueue(Snapshot(rig=rig))
    plan_editor = PlanEditor(command_queue, tmp_path)
    controller = TrialController(
        command_queue, BackgroundWork(command_queue, Notifications(command_queue), Workers()), plan_editor
    )
    controller.command_queue, controller.plan_editor, controller.workers = (
        command_queue,
        plan_editor,
        controller._background._compute,
    )
    yield controller
    command_queue.close()


def plan(**changes):
    return replace(engineered(small_job()), **{"recipe": replace(SETTLED, stitching=STITCHED), **changes})


def test_the_plan_is_tried_as_it_would_be_released_and_the_outcome_is_shown(trials, tmp_path):
    judged_dataset(tmp_path / "w1.wafer", 12.0, replace(released_job(), product="wafer"))
    trials.plan_editor.edit.run(plan(revision=" "))
    done = trials.begin((tmp_path,))
    now = trials.command_queue.wait_until(lambda now: now.works, PATIENCE_S)
    assert (now.works[0].title, now.operating.trying) == ("Trial of wafer next", True)
    _, task, (job, datasets, result), answer = trials.workers.asked[0]
    assert (task, job.released, job.revision, result) == (try_job, True, "next", "default")
    assert [path.name for path in datasets] == ["w1.wafer"]
    trial = try_job(job, datasets, result)
    answer.set_result(trial)
    assert done.result(PATIENCE_S) == trial
    now = trials.command_queue.wait_until(lambda now: not now.operating.trying, PATIENCE_S)
    assert (now.operating.trial, now.works) == (trial, ())
    assert now.operating.trial_of == trials.command_queue.now.draft.job


def test_a_trial_can_be_cancelled_and_only_one_runs_at_a_time(trials, tmp_path):
    judged_dataset(tmp_path / "w1.wafer", 12.0, released_job())
    trials.plan_editor.edit.run(plan())
    done = trials.begin((tmp_path,))
    work = trials.command_queue.wait_until(lambda now: now.works, PATIENCE_S).works[0]
    with pytest.raises(PlanError, match="being tried already"):
        trials.begin((tmp_path,)).result(PATIENCE_S)
    trials.command_queue.do(trials._background.cancel, work.id).result(PATIENCE_S)
    assert trials.workers.cancelled == [work.id]
    trials.workers.asked[0][-1].set_exception(ComputeError("The trial was stopped."))
    with pytest.raises(ComputeError):
        done.result(PATIENCE_S)
    now = trials.command_queue.wait_until(lambda now: not now.operating.trying, PATIENCE_S)
    assert (now.operating.trial, now.works) == (None, ())


def test_what_cannot_be_released_cannot_be_tried(trials, tmp_path):
    trials.plan_editor.edit.run(plan(features=()))
    with pytest.raises(PlanError, match="no feature"):
        trials.begin((tmp_path,)).result(PATIENCE_S)
    trials.plan_editor.edit.run(plan())
    with pytest.raises(DatasetError, match="There is no dataset"):
        trials.begin((tmp_path,)).result(PATIENCE_S)
    assert not trials.command_queue.now.operating.trying


@pytest.mark.campaign
def test_a_true_session_tries_a_plan_in_its_compute_process(tmp_path):
    for name, height_um in (("w1", 30.0), ("w2", 30.9)):
        judged_dataset(tmp_path / f"{name}.wafer", height_um, replace(released_job(), product="wafer"), wafer=name)
    session = Session(tmp_path)
    try:
        session.wait_until(lambda now: now.rig.state == "ready", PATIENCE_S * 12)
        wide = replace(STEP, nominal=30.0, lower_limit=29.5, upper_limit=30.5)
        session.edit_job(plan(features=(wide,))).result(PATIENCE_S)
        session.wait_until(lambda now: now.draft.plan is not None, PATIENCE_S * 12)
        trial = session.trials.begin((tmp_path,)).result(PATIENCE_S * 12)
    finally:
        session.close()
    assert [(wafer.wafer_id, wafer.before, wafer.after) for wafer in trial.wafers] == [
        ("w1", "fail", "pass"),
        ("w2", "fail", "fail"),
    ]
    assert trial.n_changes == 1


def test_a_trial_that_is_stopped_ends_and_one_bad_dataset_does_not(tmp_path):
    path = judged_dataset(tmp_path / "w1.wafer", 12.0, released_job())
    gone = tmp_path / "gone.wafer"
    trial = try_job(released_job(), (gone, path))
    assert [item.dataset for item in trial.not_tried] == ["gone.wafer"]
    assert [wafer.after for wafer in trial.wafers] == ["pass"]
    shares: list[float] = []
    with pytest.raises(ComputeError, match="stopped at dataset 1 of 2; nothing was released"):
        try_job(released_job(), (path, path), progress=shares.append, should_stop=lambda: True)
    assert shares == []
