"""Table of the audit log: the newest first, everything escaped, and what is not shown is said."""

from __future__ import annotations

from datetime import UTC, datetime

from wafer_viewer.gui.dialogs.open_and_export import SHOWN, audit_table
from wafer_viewer.model.roles import AuditEntry

NOW = datetime(2026, 3, 3, 12, 0, tzinfo=UTC)


def entry(n: int = 0, **changes: str) -> AuditEntry:
    told = {"by": "Ann", "through": "page", "action": "Result kept", "subject": f"{n}.wafer", **changes}
    return AuditEntry(at="2026-03-03T09:30:00+00:00", **told)


def test_the_newest_comes_first_with_its_time_and_details() -> None:
    table = audit_table([entry(1), entry(2, detail="name: <b>", by="<i>", through="Python")], NOW)
    assert table.index("2.wafer") < table.index("1.wafer")
    assert "today 09:30" in table
    assert "<b>" not in table
    assert "<i>" not in table
    assert "&lt;i&gt;<small> Python</small>" in table


def test_older_entries_are_counted() -> None:
    table = audit_table([entry(n) for n in range(SHOWN + 7)], NOW)
    assert "7 earlier entries: wafer-viewer log FOLDER" in table
    assert ">6.wafer<" not in table
    assert ">7.wafer<" in table


def test_an_empty_log_says_what_comes_first() -> None:
    assert "Nothing is recorded yet" in audit_table([], NOW)
