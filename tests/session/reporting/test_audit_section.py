"""Audit log in a report: who did what to this dataset and its job, and nothing of a log that was altered."""

from __future__ import annotations

import re

import pytest

from tests.support.datasets.judged_datasets import judged_dataset, released_job
from wafer_viewer.cli.app import main
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.audit_trail import record
from wafer_viewer.session.planning.job_releases import write_released
from wafer_viewer.session.reporting.report import contents
from wafer_viewer.store.records.signed_log import AUDIT_LOG

HEADING = "<h2>Audit log</h2>"


@pytest.fixture
def folder(tmp_path):
    """A data folder with two datasets of a released job, one of them held."""
    job = released_job()
    record(
        tmp_path,
        "Job released",
        "coupon-A.toml",
        "why: <b>new</b> limits",
        by="Ann",
        wrote=write_released(tmp_path, job),
    )
    for name, wafer in (("one.wafer", "W1"), ("other.wafer", "W2")):
        judged_dataset(tmp_path / name, 12.0, job, wafer=wafer)
        assert main(["hold", str(tmp_path / name), "--reason", f"complaint about {wafer}"]) == 0
    return tmp_path


def reported(folder, name="one.wafer"):
    """The HTML of the command line's report."""
    assert main(["report", str(folder / name), "-o", str(folder / "report.html")]) == 0
    return (folder / "report.html").read_text()


def rows(text):
    """The rows of the section, each the list of its cells' text."""
    table = text.split(HEADING)[1].split("</table>")[0].split("<tbody>")[1]
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in table.split("</tr>")[:-1]]


@pytest.mark.slow
def test_what_was_done_to_the_dataset_and_its_job_stands_in_a_table(folder):
    released, held = rows(reported(folder))
    assert (released[1], released[2]) == ("Ann", "command line")
    assert released[3] == "Job released, coupon-A.toml"
    assert released[4].startswith("why: &lt;b&gt;new&lt;/b&gt; limits · SHA-256 ")
    assert (held[3], held[4]) == ("Frames held", "why: complaint about W1")
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", held[0])
    assert contents(folder / "one.wafer", "default")["audit"].words == "2 entries on this dataset and its job"


@pytest.mark.slow
def test_entries_on_another_dataset_leave_the_report_as_it_is(folder):
    before = reported(folder)
    assert main(["unhold", str(folder / "other.wafer"), "--reason", "settled"]) == 0
    assert reported(folder) == before
    assert main(["unhold", str(folder / "one.wafer"), "--reason", "settled"]) == 0
    assert rows(reported(folder))[-1][3:] == ["Hold ended", "why: settled"]


@pytest.mark.slow
def test_a_release_of_another_job_under_the_same_name_is_not_that_of_the_dataset(folder):
    path = folder / "jobs" / "coupon-A.toml"
    path.write_text(path.read_text() + "\n")
    assert [row[3] for row in rows(reported(folder))] == ["Frames held"]


@pytest.mark.slow
def test_nothing_of_a_log_that_was_altered_is_printed_but_that_it_was(folder):
    log = folder / AUDIT_LOG
    log.write_bytes(log.read_bytes().replace(b"complaint about W1", b"nothing to be seen"))
    section = reported(folder).split(HEADING)[1].split("</section>")[0]
    assert "nothing to be seen" not in section
    assert "Ann" not in section
    assert "The audit log cannot be relied on" in section
    assert "cannot be relied on" in contents(folder / "one.wafer", "default")["audit"].words


def test_a_dataset_that_nobody_did_anything_to_has_no_such_section(tmp_path):
    judged_dataset(tmp_path / "one.wafer", 12.0, replace(released_job(), released=False))
    assert HEADING not in reported(tmp_path)
    assert contents(tmp_path / "one.wafer", "default")["audit"].nothing
