"""The search for the exposure: in a session as the page asks for it, and at the prompt."""

from __future__ import annotations

import json

import pytest

from tests.support.patience import PATIENCE_S
from tests.support.plans import die_beside_its_trench
from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import MotionStopped, PlanError, RigError
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.session.acquisition.live_controller import write_exposures
from wafer_viewer.session.planning.job_releases import read_job
from wafer_viewer.session.planning.plan_editor import UNCONFIRMED

PLAN = die_beside_its_trench(14)


@pytest.mark.slow
def test_a_session_sets_the_exposure_in_one_step_and_then_the_bracket_in_another(session, job):
    before = replace(job(z_step_um=3.0, n_frames=14), exposures_us=(20.0,))
    session.edit_job(before).result(PATIENCE_S)
    found = session.find_exposure().result(PATIENCE_S)
    shown = session.snapshot
    assert shown.exposure == found
    assert shown.draft.job == replace(before, exposures_us=found.single_us)
    assert (found.fields, shown.rig.state) == ((1, 2), "ready")
    assert 0.75 <= found.single.level <= 0.85
    assert found.single.dark_fraction > 0.02
    assert found.bracket[0] == found.single
    assert found.bracket[1].dark_fraction < 0.5 * found.single.dark_fraction
    session.take_bracket().result(PATIENCE_S)
    assert session.snapshot.draft.job.exposures_us == found.bracket_us
    session.undo().result(PATIENCE_S)
    assert session.snapshot.draft.job.exposures_us == found.single_us
    session.undo().result(PATIENCE_S)
    assert session.snapshot.draft.job == before


@pytest.mark.slow
def test_a_cancelled_search_leaves_the_plan_as_it_is(session, job):
    session.edit_job(job()).result(PATIENCE_S)
    running = session.find_exposure((2,))
    (work,) = session.wait_until(lambda s: s.works, PATIENCE_S).works
    assert (work.title, work.cancellable) == ("Find the exposure", True)
    with pytest.raises(RigError, match=r"The rig is at work \(Find the exposure\)"):
        session.move_to(x_um=0.0).result(PATIENCE_S)
    session.cancel(work.id).result(PATIENCE_S)
    with pytest.raises(MotionStopped):
        running.result(PATIENCE_S)
    assert session.snapshot.draft.job == job()
    assert session.snapshot.exposure is None
    with pytest.raises(PlanError, match="No bracket is proposed: find the exposure first"):
        session.take_bracket().result(PATIENCE_S)


@pytest.mark.slow
def test_it_is_refused_with_the_reason(session, job):
    plan_editor = session._coordinator.plan_editor
    session.edit_job(job()).result(PATIENCE_S)
    with pytest.raises(PlanError, match="The plan has 2 fields and no field 9: choose one of them"):
        session.find_exposure((1, 9)).result(PATIENCE_S)
    session._command_queue.do(plan_editor.reopen, job()).result(PATIENCE_S)
    with pytest.raises(PlanError, match=UNCONFIRMED):
        session.find_exposure().result(PATIENCE_S)
    session._command_queue.do(plan_editor.reopen, None).result(PATIENCE_S)
    session.jobs.confirm().result(PATIENCE_S)
    with pytest.raises(PlanError, match="There is no plan yet"):
        session.find_exposure().result(PATIENCE_S)


@pytest.mark.slow
def test_the_prompt_prints_the_exposure_and_writes_it_into_the_plan(tmp_path, capsys):
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN)
    assert main(["exposure", str(plan), "--write", "--bracket"]) == 0
    printed = capsys.readouterr().out
    exposures_us = read_job(plan).exposures_us
    assert printed.startswith(f"{exposures_us[0]:g} us: the brightest pixels in focus reach ")
    assert "Fields 1, 6 positions over 39 um in z" in printed
    assert "A bracket brings more pixels to light" in printed
    assert f"exposures_us = {exposures_us[0]:g}, {exposures_us[1]:g}" in printed
    assert "# as on the carrier" in plan.read_text()
    assert main(["exposure", str(plan), "--fields", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["single"]["exposure_us"] == pytest.approx(exposures_us[0], rel=0.1)
    assert read_job(plan).exposures_us == exposures_us
    assert main(["exposure", str(plan), "--fields", "2"]) == 2
    assert "has 1 fields and no field 2" in capsys.readouterr().err


@pytest.mark.parametrize(
    "text",
    [
        PLAN,
        f"exposures_us = [60.0]\n{PLAN}",
        die_beside_its_trench(14, exposures_us="[\n  60.0,  # dark\n  240.0,\n]"),
        "# exposures_us = [1.0]\n" + PLAN,
    ],
    ids=["none", "one", "several lines", "a comment"],
)
def test_a_plan_keeps_its_comments_when_its_exposures_change(text, tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    before = read_job(path)
    write_exposures(path, (71.4, 500.0))
    assert read_job(path) == replace(before, exposures_us=(71.4, 500.0))
    assert "# as on the carrier" in path.read_text()


def test_a_plan_is_written_anew_where_its_layout_cannot_be_kept(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(
        "sweep = { n_frames = 14, z_step_um = 3.0 }\nexposures_us = [60.0,  # ]\n]\n"
        "[[fields]]\nnumber = 1\nrow = 0\ncol = 0\nx_um = 0.0\ny_um = 0.0\nz_start_um = 0.0\n"
    )
    before = read_job(path)
    write_exposures(path, (71.4,))
    assert read_job(path) == replace(before, exposures_us=(71.4,))
    assert path.read_text() == encode(read_job(path))
