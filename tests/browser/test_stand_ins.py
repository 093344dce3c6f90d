"""Every stand-in of the browser tests against the true session: the same verbs, signatures and kinds of answers."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from tests.browser.recording import Recording, answers_later, groups_of, verbs_of
from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.compared_session import ComparedSession
from tests.browser.sessions.gauge_session import GaugeSession
from tests.browser.sessions.inspected_session import inspected_session
from tests.browser.sessions.measuring_session import MeasuringSession
from tests.browser.sessions.seen_session import SeenSession
from tests.browser.sessions.shaped_session import ShapedSession
from tests.browser.sessions.stitched_session import GrowingSession, StitchedSession
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.job import SavedView
from wafer_viewer.session.files.file_jobs import Documents as TruePapers
from wafer_viewer.session.session import Session

STAND_INS: dict[str, Callable[[], Any]] = {
    "plain": lambda: fake.FakeSession(fake.empty()),
    "compared": ComparedSession,
    "gauge": GaugeSession,
    "inspected": inspected_session,
    "measuring": MeasuringSession,
    "seen": SeenSession,
    "shaped": ShapedSession,
    "stitched": StitchedSession,
    "growing": lambda: GrowingSession(3, 3),
}


def test_stand_ins_have_the_verbs_of_the_session_and_no_others():
    for name, make in STAND_INS.items():
        session = make()
        try:
            assert list(differences(session, Session, name)) == []
        finally:
            getattr(session, "close", lambda: None)()


def differences(stand_in: Any, true: type, path: str) -> Iterator[str]:
    """What a stand-in does otherwise than the class it stands in for."""
    for name, expected in verbs_of(true).items():
        verb = getattr(stand_in, name, None)
        if verb is None:
            if answers_later(expected):
                yield f"{path}.{name} is missing"
            continue
        given = inspect.signature(verb)
        if _shape(given) != _shape(expected):
            yield f"{path}.{name}{given} instead of {expected}"
        if given.return_annotation is not inspect.Signature.empty and answers_later(given) != answers_later(expected):
            yield f"{path}.{name} answers with {given.return_annotation} instead of {expected.return_annotation}"
    for name, group in groups_of(true).items():
        yield from differences(getattr(stand_in, name), group, f"{path}.{name}")
    with pytest.raises(AttributeError):
        stand_in.no_such_verb  # noqa: B018


def test_another_signature_or_kind_of_answer_is_a_difference():
    class Documents(Recording):
        def contents(self) -> dict[str, str]:
            return {}

        def keep_picture(self, png: bytes, name: str = "") -> Future[Path]:
            raise NotImplementedError

    found = list(differences(Documents(TruePapers, lambda *_: Future()), TruePapers, "papers"))
    assert [line.split("(")[0].split(" ")[0] for line in found] == ["papers.contents", "papers.keep_picture"]


def _shape(signature: inspect.Signature) -> list[tuple[str, Any, Any]]:
    """Names, kinds and defaults; what an argument is called matters to who calls it by name."""
    return [(p.name, p.kind, p.default) for p in signature.parameters.values()]


def test_a_stand_in_refuses_what_the_session_would_refuse():
    session = fake.FakeSession(fake.empty())
    with pytest.raises(TypeError):
        session.rename(1)
    with pytest.raises(TypeError):
        session.papers.write_report()
    with pytest.raises(TypeError):
        session.jobs.mark(0, 1.0)
    with pytest.raises(AttributeError, match="no verb 'aprove'"):
        session.jobs.aprove()
    with pytest.raises(AttributeError, match="answers at once"):
        session.mosaic()
    assert session.asked == []
    session.jobs.mark(0, 1.0, y_um=2.0)
    assert session.asked == [("jobs.mark", (0, 1.0), {"y_um": 2.0})]


@pytest.fixture(scope="module")
def true_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    opened = Session(tmp_path_factory.mktemp("wafers"))
    opened.wait_until(lambda now: now.rig.limits is not None, 240)
    yield opened
    opened.close()


@pytest.fixture(params=[pytest.param("true", marks=pytest.mark.slow), "stand-in"])
def session(request: pytest.FixtureRequest) -> Any:
    if request.param == "true":
        return request.getfixturevalue("true_session")
    return fake.FakeSession(fake.empty())


def test_both_edit_the_plan_and_tell_their_listeners(session: Any):
    heard: list[Any] = []
    leave = session.subscribe(heard.append)
    session.edit_job(fake.a_job()).result()
    assert session.snapshot.draft.job == fake.a_job()
    assert session.snapshot.draft.plan.n_frames == 540
    session.edit_job(None).result()
    assert session.snapshot.draft.job is None
    leave()
    assert all(isinstance(now, type(session.snapshot)) for now in heard)


def test_both_know_who_holds_the_controls(session: Any):
    session.control.arrive("a", "Anna").result()
    session.control.arrive("b", "Ben").result()
    assert session.snapshot.control.holder == "a"
    with pytest.raises(WaferViewerError):
        session.control.hand_over("b", "a").result()
    session.control.hand_over("a", "b").result()
    assert session.snapshot.control.holder == "b"


def a_view() -> SavedView:
    return SavedView(position_mm=(0, 0, 1), look_at_mm=(0, 0, 0))


VERBS: dict[str, Callable[[Any], Any]] = {
    "undo": lambda s: s.undo(),
    "undo_findings": lambda s: s.undo_findings(),
    "refresh_datasets": lambda s: s.refresh_datasets(),
    "stop": lambda s: s.stop(),
    "notebook.save_view": lambda s: s.notebook.save_view(a_view()),
    "notebook.undo": lambda s: s.notebook.undo(),
    "jobs.refresh": lambda s: s.jobs.refresh(),
    "defects.undo": lambda s: s.defects.undo(),
    "papers.contents": lambda s: s.papers.contents(),
    "sections.others": lambda s: s.sections.others(),
    "gauge.clear": lambda s: s.gauge.clear(),
}


def test_both_answer_in_the_same_way(session: Any):
    for name, verb in VERBS.items():
        expected = verbs_of(Session).get(name) or _of_group(name)
        answer = verb(session)
        assert isinstance(answer, Future) == answers_later(expected), name
        if isinstance(answer, Future) and (fault := answer.exception(60)) is not None:
            assert isinstance(fault, WaferViewerError), name


def _of_group(name: str) -> inspect.Signature:
    group, verb = name.split(".")
    return verbs_of(groups_of(Session)[group])[verb]
