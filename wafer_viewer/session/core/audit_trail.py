"""Audit trail of the session: commands that change something leave an entry once they have succeeded."""

from __future__ import annotations

import getpass
from concurrent.futures import Future
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.roles import Action, AuditEntry, Through
from wafer_viewer.session.core.commands import query

if TYPE_CHECKING:
    from wafer_viewer.session.core.background_work import Notifications
    from wafer_viewer.session.core.command_queue import CommandQueue
    from wafer_viewer.session.state.snapshot import Snapshot

NOT_WRITTEN = "An action is missing in the audit log"


class AuditTrail:
    """Writer of the audit log of a data folder, for the commands of a session."""

    def __init__(self, command_queue: CommandQueue, notices: Notifications, folder: Path) -> None:
        self._command_queue, self._notices, self._folder = command_queue, notices, folder
        command_queue.audit = self.expect

    def expect(self, action: Action, detail: str, outcome: Future[Any]) -> None:
        """Record an action, on any thread, when its outcome is there and good; the holder of the controls did it."""
        by, through = _who(self._command_queue.snapshot)

        def ended(done: Future[Any]) -> None:
            if not done.cancelled() and done.exception() is None:
                self._command_queue.note(self._record, by, through, action, detail, done.result())

        outcome.add_done_callback(ended)

    @query
    def actions(self, subject: str = "") -> tuple[AuditEntry, ...]:
        """Return the entries of the audit log, oldest first, optionally of one dataset, job or file.

        Raises DatasetError when the log was altered.
        """
        from wafer_viewer.store.records.signed_log import recorded_actions

        return recorded_actions(self._folder, subject)

    def _record(self, by: str, through: Through, action: Action, detail: str, result: object) -> None:
        subject = _subject(self._command_queue.now, result)
        try:
            record(self._folder, action, subject, detail, by=by, through=through, wrote=_written(result))
        except DatasetError as fault:
            self._notices.fault(NOT_WRITTEN, f"{action}, {subject}: {fault}", "other")


def record(
    folder: Path,
    action: Action,
    subject: str,
    detail: str = "",
    *,
    by: str = "",
    through: Through = "command line",
    wrote: Path | None = None,
) -> None:
    """Append an action to the audit log of a data folder, now.

    by: the account of this process if empty; wrote: file that the action wrote, whose digest is recorded. Raises
    DatasetError when the log was altered, or cannot be written.
    """
    from wafer_viewer.store.io.checksums import file_sha256
    from wafer_viewer.store.records.signed_log import record_action

    entry = AuditEntry(
        at=datetime.now(UTC).isoformat(timespec="seconds"),
        by=by or account(),
        through=through,
        action=action,
        subject=subject,
        detail=detail,
        sha256="" if wrote is None else file_sha256(wrote),
    )
    record_action(folder, entry)


def account() -> str:
    """Return the name of the account that runs this process."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # an account without a name, as in containers
        return "unknown"


def _who(now: Snapshot) -> tuple[str, Through]:
    holder = now.control.name_of(now.control.holder)
    return (holder, "page") if holder else (account(), "Python")


def _written(result: object) -> Path | None:
    """Return the file that a command wrote; a dataset is a folder, whose manifest has its digests."""
    return result if isinstance(result, Path) and result.is_file() else None


def _subject(now: Snapshot, result: object) -> str:
    """Return the file that a command made, or else the open dataset, or the product of the plan."""
    if isinstance(result, Path):
        return result.name
    if now.dataset is not None:
        return now.dataset.path.name
    job = now.draft.job
    return "" if job is None else f"{job.product} {job.revision}".strip()
