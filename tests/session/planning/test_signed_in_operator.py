"""The operator of a plan is the person who is signed in, unless another name was typed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.session.conftest import small_job
from tests.support.datasets.released import release_of
from tests.support.patience import PATIENCE_S
from wafer_viewer.gui.steps.plan_form import job_of, values_of
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.audit_trail import record
from wafer_viewer.session.core.people import add_person
from wafer_viewer.session.planning.job_releases import write_released
from wafer_viewer.session.session import Session

pytestmark = pytest.mark.usefixtures("quick_passwords")
ANN, OLGA = "ann's long password", "olga's long password"


@pytest.fixture(scope="module")
def released(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    add_person(folder, "Ann", "engineer", ANN)
    add_person(folder, "Olga", "operator", OLGA)
    path = write_released(folder, release_of(small_job()))
    record(folder, "Job released", path.name, by="Ann", wrote=path)
    return path


@pytest.fixture(scope="module")
def session(released: Path) -> Iterator[Session]:
    opened = Session(released.parents[1])
    opened.wait_until(lambda now: now.rig.state == "ready", PATIENCE_S)
    opened.control.arrive("page").result(PATIENCE_S)
    yield opened
    opened.close()


def operator_of(session: Session) -> str:
    job = session.snapshot.draft.job
    assert job is not None
    return job.sample.operator


def operator_shown(session: Session) -> str:
    return values_of(session.snapshot, {})["sample.operator"]


def sign_in(session: Session, name: str, password: str) -> None:
    session.control.sign_in("page", name, password).result(PATIENCE_S)


@pytest.mark.slow
def test_the_form_of_a_new_plan_names_who_is_signed_in_and_keeps_what_is_typed(session: Session):
    assert session.snapshot.draft.job is None
    assert operator_shown(session) == ""
    sign_in(session, "Ann", ANN)
    assert operator_shown(session) == "Ann"
    values = values_of(session.snapshot, {"size": "1.2 × 0.8"})
    session.edit_job(job_of(values, None, session.snapshot.rig.limits)).result(PATIENCE_S)
    assert operator_of(session) == "Ann"
    for typed in ("Ben", ""):
        job = session.snapshot.draft.job
        assert job is not None
        session.edit_job(replace(job, sample=replace(job.sample, operator=typed))).result(PATIENCE_S)
        assert operator_of(session) == typed
        assert operator_shown(session) == typed
    session.edit_job(None).result(PATIENCE_S)
    session.centre_on_stage().result(PATIENCE_S)
    assert operator_of(session) == "Ann", "a plan that begins with the stage has no form before"


@pytest.mark.slow
def test_a_released_job_names_who_is_signed_in_and_keeps_what_is_typed(session: Session, released: Path):
    sign_in(session, "Olga", OLGA)
    session.load_plan(released).result(PATIENCE_S)
    assert operator_of(session) == "Olga"
    job = session.snapshot.draft.job
    assert job is not None
    session.edit_job(replace(job, sample=replace(job.sample, operator="Ben", wafer_id="W7"))).result(PATIENCE_S)
    assert operator_of(session) == "Ben"
    session.jobs.next_wafer().result(PATIENCE_S)
    assert operator_of(session) == "Ben", "the next wafer of the lot keeps its operator"
    session.load_plan(released).result(PATIENCE_S)
    assert operator_of(session) == "Olga"
