"""Operators run what an engineer released and nothing else; a job that is edited is no longer released."""

from __future__ import annotations

import pytest

from tests.session.conftest import small_job
from tests.support.datasets.released import engineered, release_of
from wafer_viewer.model.errors import PlanError, RoleError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.session.core.audit_trail import AuditTrail
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.planning.job_releases import list_released, release_problem, write_released
from wafer_viewer.session.planning.plan_editor import PlanEditor
from wafer_viewer.session.planning.revision_trial import JobController
from wafer_viewer.session.state.snapshot import Browser, ControlState, RigStatus, Snapshot
from wafer_viewer.store.records.signed_log import AUDIT_LOG, recorded_actions

PEOPLE = Browser("a", "Ann", role="engineer"), Browser("o", "Olga", role="operator")


class Bench:
    def __init__(self, folder):
        rig = RigStatus(state="ready", limits=virtual_limits(540, 720))
        self.queue = CommandQueue(Snapshot(rig=rig, data_folder=folder))
        AuditTrail(self.queue, Notifications(self.queue), folder)
        self.editor = PlanEditor(self.queue, folder)
        self.jobs = JobController(self.queue, self.editor, folder)
        self.folder = folder

    def hold(self, key, engineers=("Ann",)):
        control = ControlState(browsers=PEOPLE, holder=key, engineers=engineers)
        self.queue.do(lambda: self.queue.change(control=control)).result()

    def wait(self):
        self.queue.do(lambda: None).result()
        self.queue.do(lambda: None).result()

    @property
    def job(self):
        return self.queue.snapshot.draft.job

    def released(self, why="first revision"):
        """Release a job as Ann does."""
        self.hold("a")
        ready = release_of(small_job())
        self.editor.edit(replace(ready, released=False)).result()
        path = self.jobs.release(why).result()
        self.wait()
        return path


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.queue.close()


def test_a_release_records_who_why_and_what(bench):
    path = bench.released("limits of order 12")
    (entry,) = (entry for entry in recorded_actions(bench.folder) if entry.action == "Job released")
    assert (entry.by, entry.subject, entry.detail) == ("Ann", path.name, "why: limits of order 12")
    assert len(entry.sha256) == 64
    assert release_problem(bench.folder, bench.job) is None
    bench.editor.edit(replace(bench.job, sample=replace(bench.job.sample, wafer_id="W7"))).result()
    assert release_problem(bench.folder, bench.job) is None, "names of a wafer are no part of what is released"


def test_a_listed_engineer_gives_a_reason_and_others_need_none(bench):
    bench.hold("a")
    bench.editor.edit(replace(release_of(small_job()), released=False)).result()
    with pytest.raises(PlanError, match="This has no reason"):
        bench.jobs.release(" ").result()
    bench.hold("a", engineers=())
    assert bench.jobs.release().result().name == "wafer-A.toml"


def test_an_operator_runs_the_released_job_and_names_the_wafer(bench):
    path = bench.released()
    bench.hold("o")
    bench.jobs.take_up(path).result()
    bench.editor.edit(replace(bench.job, sample=replace(bench.job.sample, wafer_id="W7", operator="Olga"))).result()
    bench.queue.do(bench.editor.require_runnable, bench.job).result()
    for refused in (
        bench.jobs.release("mine"),
        bench.editor.save(),
        bench.jobs.copy(),
        bench.editor.edit(engineered(small_job())),
        bench.editor.cover_sample(),
    ):
        with pytest.raises((RoleError, PlanError)):
            refused.result()
    with pytest.raises(
        RoleError, match=r"Only an engineer changes plans and jobs: Ann\. Olga is signed in as operator"
    ):
        bench.jobs.copy().result()


def test_an_operator_runs_no_other_plan(bench):
    bench.hold("o")
    with pytest.raises(RoleError, match=r"This plan is not released\. Operators run released jobs only"):
        bench.queue.do(bench.editor.require_runnable, small_job()).result()
    made_up = release_of(small_job())
    with pytest.raises(RoleError, match="was not released in"):
        bench.queue.do(bench.editor.require_runnable, made_up).result()
    path = write_released(bench.folder, made_up)  # by hand, without a release
    with pytest.raises(RoleError, match="wafer A was not released in"):
        bench.jobs.take_up(path).result()


def test_a_job_that_is_edited_is_no_longer_released(bench):
    path = bench.released()
    (entry,) = list_released(bench.folder)
    assert not entry.edited
    path.write_text(path.read_text().replace("defect_sensitivity = 5.0", "defect_sensitivity = 2.0"))
    (entry,) = list_released(bench.folder)
    assert entry.edited
    assert "wafer-A.toml was edited after Ann released it on" in release_problem(bench.folder, release_of(small_job()))
    bench.jobs.take_up(path).result()
    assert not bench.job.released, "an engineer may release it as another revision"
    bench.hold("o")
    with pytest.raises(RoleError, match="This plan is not released"):
        bench.jobs.take_up(path).result()


def test_a_job_that_differs_from_its_file_is_not_run(bench):
    bench.released()
    bench.hold("o")
    job = replace(bench.job, defect_sensitivity=2.0)
    with pytest.raises(RoleError, match="The plan is not wafer A as Ann released it on"):
        bench.queue.do(bench.editor.require_runnable, job).result()


def test_who_edits_the_log_as_well_releases_nothing(bench):
    path = bench.released()
    log = bench.folder / AUDIT_LOG
    log.write_bytes(log.read_bytes().replace(b"Ann", b"Bob"))
    bench.hold("o")
    with pytest.raises(Exception, match=r"damaged|altered"):
        bench.jobs.take_up(path).result()
