"""Audit trail: what changed something leaves an entry with who did it; what failed leaves none."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path

import pytest

from wafer_viewer.model.errors import ControlHeldError, DatasetError, PlanError
from wafer_viewer.model.roles import Action, AuditEntry
from wafer_viewer.session.core.audit_trail import NOT_WRITTEN, AuditTrail, account, record
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, observer_command, restricted_session
from wafer_viewer.session.core.control_handover import Control
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.store.records.signed_log import AUDIT_LOG, recorded_actions


class Bench:
    """A session of two commands that the log holds and one that it does not."""

    def __init__(self, folder: Path) -> None:
        self._command_queue = CommandQueue(Snapshot(data_folder=folder))
        self.notices = Notifications(self._command_queue)
        self.control = Control(self._command_queue)
        self.later: Future[Path] = Future()
        AuditTrail(self._command_queue, self.notices, folder)

    @property
    def snapshot(self) -> Snapshot:
        return self._command_queue.snapshot

    @command.audited("Job released")
    def release(self, product: str, revision: int = 1, why: str = "", loud: bool = False) -> Path:
        if not product:
            raise PlanError("The job has no product.")
        return Path("jobs") / f"{product}-{revision}.toml"

    @command.audited("Surface made")
    def reconstruct(self, result: str = "default") -> Future[Path]:
        return self.later

    @observer_command
    def look(self) -> None:
        """Look."""

    def wait(self) -> None:
        """Wait for the entries of what is over."""
        for _ in range(2):
            self.look().result()


@pytest.fixture
def bench(tmp_path: Path):
    bench = Bench(tmp_path)
    yield bench
    bench._command_queue.close()


def test_who_holds_the_controls_did_it(bench: Bench, tmp_path: Path) -> None:
    bench.control.arrive("a", "Ann's bench").result()
    bench.control.arrive("b", "Desk").result()
    bench.release("Logic 7", revision=3, why="new limits").result()
    bench.wait()
    (entry,) = recorded_actions(tmp_path)
    assert (entry.by, entry.through, entry.action) == ("Ann's bench", "page", "Job released")
    assert entry.subject == "Logic 7-3.toml"
    assert entry.detail == "product: Logic 7, revision: 3, why: new limits"
    assert entry.at.endswith("+00:00")
    with pytest.raises(ControlHeldError):
        restricted_session(bench, lambda: "b").release("Logic 7").result()
    bench.wait()
    assert len(recorded_actions(tmp_path)) == 1


def test_without_a_browser_it_was_the_account(bench: Bench, tmp_path: Path) -> None:
    bench.release("Logic 7").result()
    bench.wait()
    (entry,) = recorded_actions(tmp_path, subject="Logic 7-1.toml")
    assert (entry.by, entry.through) == (account(), "Python")
    assert recorded_actions(tmp_path, subject="another") == ()


def test_what_failed_leaves_none(bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(PlanError):
        bench.release("").result()
    bench.reconstruct()
    bench.later.cancel()
    bench.wait()
    assert recorded_actions(tmp_path) == ()


def test_long_work_is_recorded_when_it_succeeds_by_who_began_it(bench: Bench, tmp_path: Path) -> None:
    bench.control.arrive("a", "Ann").result()
    outcome = bench.reconstruct()
    bench.wait()
    assert recorded_actions(tmp_path) == ()
    bench.control.arrive("b", "Bob").result()
    bench.control.hand_over("a", "b").result()
    bench.later.set_result(tmp_path / "one.wafer")
    outcome.result()
    bench.wait()
    (entry,) = recorded_actions(tmp_path)
    assert (entry.by, entry.subject, entry.detail) == ("Ann", "one.wafer", "")


def test_an_altered_log_is_told_and_nothing_is_stopped(bench: Bench, tmp_path: Path) -> None:
    bench.release("Logic 7").result()
    bench.wait()
    log = tmp_path / AUDIT_LOG
    log.write_bytes(log.read_bytes().replace(b"Logic 7", b"Logic 8"))
    assert bench.release("Logic 9").result().name == "Logic 9-1.toml"
    bench.wait()
    (fault,) = bench.snapshot.faults
    assert fault.title == NOT_WRITTEN
    assert str(log) in fault.text
    with pytest.raises(DatasetError, match=r"damaged|altered"):
        recorded_actions(tmp_path)


def test_many_entries_are_appended_in_about_constant_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Signatures of what was verified when it was written are not verified at each entry."""
    from wafer_viewer.store.records import signed_log

    looks = []
    original = signed_log.is_signed
    monkeypatch.setattr(signed_log, "is_signed", lambda *args: looks.append(1) or original(*args))
    for n in range(40):
        record(tmp_path, "Result kept", f"{n}.wafer")
    assert len(looks) <= 2 * 40
    assert len(recorded_actions(tmp_path)) == 40


def test_each_action_of_the_log_is_that_of_a_command_or_of_the_command_line() -> None:
    from typing import get_args

    source = "".join(path.read_text() for path in Path(__file__).parents[3].glob("wafer_viewer/**/*.py"))
    elsewhere = source.replace(Path(__file__).parents[3].joinpath("wafer_viewer/model/roles.py").read_text(), "")
    assert [action for action in get_args(Action) if f'"{action}"' not in elsewhere] == []
    assert AuditEntry(at="", by="", through="Python", action="of a later version").action


def test_a_command_whose_action_cannot_be_recorded_has_done_its_work_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from wafer_viewer.cli.output import audit

    audit(tmp_path, "Surface made", "w1.wafer")
    log = tmp_path / AUDIT_LOG
    log.write_bytes(log.read_bytes().replace(b"w1", b"w2"))
    audit(tmp_path, "Surface made", "w3.wafer")
    assert f"{NOT_WRITTEN}, Surface made, w3.wafer: {log}" in capsys.readouterr().err
