"""People with roles: who is listed signs in; operators run what is released, engineers change it."""

from __future__ import annotations

import json
import stat
from concurrent.futures import Future
from pathlib import Path

import pytest

from wafer_viewer.model.errors import ControlHeldError, DatasetError, PlanError, RoleError, WaferViewerError
from wafer_viewer.model.roles import NEED_ENGINEER, refusal, role_for
from wafer_viewer.session.core.audit_trail import AuditTrail
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, observer_command, restricted_session
from wafer_viewer.session.core.control_handover import Control
from wafer_viewer.session.core.people import NOT_RIGHT, add_person, listed_people, remove_person, signed_in
from wafer_viewer.session.core.private_file import MOST_OF_ONE
from wafer_viewer.session.state.snapshot import ControlState, Snapshot
from wafer_viewer.store.records.signed_log import recorded_actions

pytestmark = pytest.mark.usefixtures("quick_passwords")
ANN, OLGA = "ann's long password", "olga's long password"


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("listed")
    add_person(folder, "Ann", "engineer", ANN)
    add_person(folder, " Olga  Ünal ", "operator", OLGA)
    return folder


@pytest.fixture
def folder(listed: Path, tmp_path: Path) -> Path:
    (tmp_path / ".wafer-viewer").mkdir()
    kept = tmp_path / ".wafer-viewer/people"
    kept.write_bytes((listed / ".wafer-viewer/people").read_bytes())
    kept.chmod(0o600)
    return tmp_path


class Bench:
    """A session of an engineer's command, an operator's one, and one for everybody."""

    def __init__(self, folder: Path) -> None:
        self._command_queue = CommandQueue(Snapshot(data_folder=folder))
        self.control = Control(self._command_queue)
        AuditTrail(self._command_queue, Notifications(self._command_queue), folder)

    @property
    def snapshot(self) -> Snapshot:
        return self._command_queue.snapshot

    @command.audited("Job released")
    def release(self) -> str:
        return "released"

    @command.audited("Scan started")
    def scan(self) -> str:
        return "scanned"

    @observer_command
    def look(self) -> str:
        return "looked"


@pytest.fixture
def bench(folder: Path):
    bench = Bench(folder)
    yield bench
    bench._command_queue.close()


def test_the_file_holds_hashes_only_and_is_for_its_owner(folder: Path, listed: Path) -> None:
    people = listed_people(folder)
    assert [(person.name, person.role) for person in people] == [("Ann", "engineer"), ("Olga Ünal", "operator")]
    path = listed / ".wafer-viewer/people"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert "long password" not in path.read_text()
    assert listed_people(folder / "elsewhere") == ()
    copy = folder / ".wafer-viewer/people"
    copy.chmod(0o644)
    with pytest.raises(DatasetError, match="can be read or written by others"):
        listed_people(folder)


def test_a_list_without_an_engineer_counts_for_nobody(folder: Path) -> None:
    path = folder / ".wafer-viewer/people"
    people = json.loads(path.read_text())
    people["people"] = [person for person in people["people"] if person["role"] == "operator"]
    path.write_text(json.dumps(people))
    with pytest.raises(DatasetError, match="lists no engineer"):
        listed_people(folder)


def test_an_engineer_is_the_first_and_the_last_one(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(PlanError, match="Somebody must be an engineer"):
        add_person(tmp_path / "new", "Olga", "operator", OLGA)
    with pytest.raises(PlanError, match="has 5 characters"):
        add_person(folder, "Bob", "operator", "short")
    with pytest.raises(PlanError, match="Somebody must be an engineer"):
        remove_person(folder, "Ann")
    with pytest.raises(PlanError, match="Nobody is listed as 'Bob': Ann"):
        remove_person(folder, "Bob")
    remove_person(folder, "olga ünal")
    remove_person(folder, "Ann")
    assert listed_people(folder) == ()


def test_name_and_password_have_to_be_right(folder: Path) -> None:
    assert signed_in(folder, "ann", ANN).role == "engineer"
    for name, password in (("Ann", OLGA), ("Bob", ANN), ("", "")):
        with pytest.raises(WaferViewerError, match=NOT_RIGHT):
            signed_in(folder, name, password)


def test_without_anybody_listed_everyone_is_an_engineer(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.control.arrive("a", "Ann").result()
    assert restricted_session(bench, lambda: "a").release().result() == "released"
    with pytest.raises(WaferViewerError, match="everyone is an engineer"):
        bench.control.sign_in("a", "Ann", ANN).result()
    bench._command_queue.close()


def test_nobody_who_is_not_signed_in_changes_anything(bench: Bench) -> None:
    bench.control.arrive("a", "Ann").result()
    page = restricted_session(bench, lambda: "a")
    assert bench.snapshot.control.name_of("a") == "Browser 1", "the name of a listed person has to be signed in"
    for refused in (page.scan, page.release):
        with pytest.raises(ControlHeldError, match="sign in first"):
            refused().result()
    assert page.look().result() == "looked"
    bench.control.rename("a", "ANN").result()
    assert bench.snapshot.control.name_of("a") == "Browser 1"


def test_an_operator_is_told_the_rule_and_who_may(bench: Bench, folder: Path) -> None:
    bench.control.arrive("a").result()
    assert bench.control.sign_in("a", "Olga Ünal", OLGA).result().role == "operator"
    page = restricted_session(bench, lambda: "a")
    assert page.scan().result() == "scanned"
    for refused in (page.release, bench.release):
        with pytest.raises(RoleError) as told:
            refused().result()
        assert str(told.value) == "Only an engineer releases jobs: Ann. Olga Ünal is signed in as operator."
    bench.control.rename("a", "Ann").result()
    bench.look().result()
    assert [(entry.by, entry.action) for entry in recorded_actions(folder)] == [("Olga Ünal", "Scan started")]
    bench.control.sign_out("a").result()
    with pytest.raises(ControlHeldError):
        page.scan().result()


def test_an_engineer_does_it_under_the_own_name(bench: Bench, folder: Path) -> None:
    bench.control.arrive("a").result()
    bench.control.sign_in("a", "ann", ANN).result()
    assert restricted_session(bench, lambda: "a").release().result() == "released"
    bench.look().result()
    (entry,) = recorded_actions(folder, "")
    assert (entry.by, entry.through) == ("Ann", "page")


def test_passwords_are_not_guessed(bench: Bench) -> None:
    bench.control.arrive("a").result()
    for _ in range(MOST_OF_ONE):
        with pytest.raises(WaferViewerError, match=NOT_RIGHT):
            bench.control.sign_in("a", "Ann", "a guessed password").result()
    with pytest.raises(WaferViewerError, match="Too many attempts"):
        bench.control.sign_in("a", "Ann", ANN).result()
    with pytest.raises(WaferViewerError, match="has disconnected"):
        bench.control.sign_in("z", "Ann", ANN).result()


def test_the_key_of_a_browser_is_on_no_other_page() -> None:
    from wafer_viewer.gui.dialogs.control_handover import _people, _question
    from wafer_viewer.session.state.snapshot import Browser, ControlState

    control = ControlState(
        browsers=(Browser("secret-a", "Ann"), Browser("secret-b", "Olga")), holder="secret-a", requester="secret-b"
    )
    drawn = _people(control, "secret-a") + _question(control)
    assert "secret-" not in drawn
    assert control.browsers[1].public_id in drawn


def test_a_refused_command_is_not_run(bench: Bench) -> None:
    bench.control.arrive("a").result()
    bench.control.sign_in("a", "Olga Ünal", OLGA).result()
    refused: Future[str] = bench.release()
    assert isinstance(refused.exception(), RoleError)


def test_each_rule_has_its_sentence() -> None:
    for action, rule in NEED_ENGINEER.items():
        assert role_for(action) == "engineer"
        assert refusal(action, "Olga", "operator", ("Ann", "Bob")) == (
            f"Only an engineer {rule}: Ann or Bob. Olga is signed in as operator."
        )
        assert refusal(action, "Ann", "engineer", ("Ann",)) is None
    assert refusal("Scan started", "Olga", "operator", ("Ann",)) is None


def test_who_is_signed_in_signs_and_gives_a_reason(bench: Bench, tmp_path: Path) -> None:
    bench.control.arrive("a").result()
    bench.control.sign_in("a", "Ann", ANN).result()
    control = bench.snapshot.control
    assert control.author("somebody else") == "Ann"
    control.require_reason("limits of order 12")
    with pytest.raises(PlanError, match="has no reason"):
        control.require_reason("  ")
    nobody_listed = ControlState()
    nobody_listed.require_reason("")
    assert nobody_listed.author("K. Adler") == "K. Adler"
