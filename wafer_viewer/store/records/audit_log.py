"""Audit log of a data folder: who scanned, released, changed, judged and signed; append-only and signed."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.audit import AuditEntry
from wafer_viewer.store.records.signed_log import append_record, read_log

AUDIT_LOG = "audit.jsonl"


def record_action(folder: Path, entry: AuditEntry) -> None:
    """Append an entry. Raises DatasetError when the log was altered, or cannot be written."""
    append_record(folder / AUDIT_LOG, entry)


def recorded_actions(folder: Path, subject: str = "") -> tuple[AuditEntry, ...]:
    """Return the entries of a data folder, oldest first, optionally of one dataset, job or file.

    Raises DatasetError when a line is damaged, or the log was altered.
    """
    entries = read_log(folder / AUDIT_LOG, AuditEntry).records
    return tuple(entry for entry in entries if not subject or entry.subject == subject)
