"""Passes whose frames do not fit their pulses are found in the journal alone, also in those of older programs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.support.datasets.samples import make_frame, make_job, make_plan
from tests.support.datasets.unsigned import without_digests
from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.store.dataset import scan_record
from wafer_viewer.store.dataset.dataset import Dataset, check_passes
from wafer_viewer.store.dataset.scan_record import JOURNAL
from wafer_viewer.store.dataset.writer import DatasetWriter

N, PERIOD_US = 40, 17_000
GOOD = PulseSummary(emitted=N, suppressed=0, quadrature_errors=0, exposures=N)


@pytest.fixture
def scan(tmp_path):
    """A function that writes one pass of 40 frames, each taken at the time of the pulse that `taken_by` says."""
    job = make_job(n_frames=N)
    plan = make_plan(job)

    def write(taken_by=lambda k: k, summary=GOOD, older=False, ended=True):
        with DatasetWriter.create(tmp_path / "scan.wafer", plan, job) as writer:
            writer.pass_begun(0, plan.legs[0])
            for k in range(N):
                time_us = 7_000_000 + PERIOD_US * taken_by(k)
                writer.frame(replace(make_frame(Shot(1, k), plan), pulse_count=20 * k, device_time_us=time_us))
            if ended:
                writer.pass_ended(0, summary)
        lines = tmp_path / "scan.wafer" / JOURNAL
        if older:
            text = lines.read_bytes()
            assert b',"provisional":true' in text
            lines.write_bytes(without_digests(text.replace(b',"provisional":true', b"")))
        return Dataset.open(tmp_path / "scan.wafer")

    return write


def test_frames_at_the_times_of_their_pulses_are_in_no_doubt(scan):
    report = check_passes(scan())
    assert (report.ok, report.n_passes, report.n_timed) == (True, 1, 1)


def test_a_frame_that_is_missing_is_no_doubt(scan):
    data = scan()
    lines = data.path / JOURNAL
    stored = [line for line in lines.read_bytes().splitlines(keepends=True) if b'"pulse_count":340,' not in line]
    assert len(stored) == N + 1
    lines.write_bytes(without_digests(b"".join(stored)))
    assert check_passes(Dataset.open(data.path)).ok


@pytest.mark.parametrize("by", [1, -1])
def test_frames_in_the_slots_of_their_neighbours_are_found(by, scan):
    report = check_passes(scan(lambda k: k + by * (k >= 21), older=True))
    (doubt,) = report.doubts
    assert f"in 1 places, first at field 1, frame 21, by {by:+.1f} pulses" in doubt
    assert "frames stand in slots of their neighbours" in doubt


@pytest.mark.parametrize(
    ("summary", "says"),
    [
        (PulseSummary(N, 0, 7, N), "40 frames were kept although the pulse box reported 7 quadrature errors"),
        (PulseSummary(N, 7, 0, N), "7 suppressed pulses"),
        (PulseSummary(N, 0, 0, N + 2), "2 exposures more than pulses"),
    ],
)
def test_frames_of_a_pass_whose_box_reported_errors_are_named(summary, says, scan):
    report = check_passes(scan(summary=summary, older=True))
    assert not report.ok
    assert says in report.doubts[0]
    assert "Pass 1, from field 1" in report.doubts[0]


def test_the_frames_of_a_pass_count_once_it_has_ended(scan):
    broken_off = scan(ended=False)
    assert broken_off.kept() == set()
    assert len(broken_off.arrived()) == N
    assert broken_off.complete_fields() == set()
    assert broken_off.stack(1).present.all(), "it can be looked at while it is taken"
    assert check_passes(broken_off).n_passes == 0
    with DatasetWriter.resume(broken_off.path) as writer:
        assert writer.kept == frozenset()


def test_older_programs_kept_every_frame_at_once(scan):
    assert len(scan(ended=False, older=True).kept()) == N


def test_a_frame_that_is_missed_before_its_pass_ends_does_not_count(tmp_path):
    job = make_job(n_frames=N)
    plan = make_plan(job)
    complete = []
    with DatasetWriter.create(tmp_path / "scan.wafer", plan, job, on_field_complete=complete.append) as writer:
        for again in range(2):
            writer.pass_begun(0, plan.legs[0])
            for k in range(N):
                writer.frame(make_frame(Shot(1, k), plan))
            if not again:
                for k in range(N):
                    writer.missed(Shot(1, k), k, "7 quadrature errors")
            writer.pass_ended(0, GOOD)
            assert len(writer.kept) == N * again
            assert complete == [1] * again
    data = Dataset.open(tmp_path / "scan.wafer")
    assert len(data.kept()) == N
    assert data.missed() == {}
    assert len(data.ever_missed()) == N
    lines = list(scan_record.JournalReader(data.path / JOURNAL).new_lines())
    assert sum(isinstance(line, scan_record.Missed) for line in lines) == N
