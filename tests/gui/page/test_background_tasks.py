"""The list of background work, in words."""

from __future__ import annotations

import dataclasses

import pytest

from tests.browser.sessions import fake_session as fake
from wafer_viewer.gui.page.panels import job_list, state_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.session.core.background_work import Notifications, seconds_left
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.state.snapshot import KernelProgress, Snapshot, Work

READY = fake.planned()
STARTING = dataclasses.replace(READY, compute_ready=False)
WORK = Work("w1", "Heights of the fields")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "running"),
        ({"waits_for": "the first field"}, "queued: waiting for the first field"),
        ({"waits_for": "the first field", "fraction": 0.5}, "50\u202f%"),
        ({"fraction": 0.25, "seconds_left": 95.2}, "1:36 left · 25\u202f%"),
        ({"fraction": 0.99, "seconds_left": 0.4}, "99\u202f%"),
    ],
)
def test_a_job_says_how_it_stands(changes, said):
    assert state_of(dataclasses.replace(WORK, **changes), READY) == said


def test_nothing_is_at_work_before_there_are_workers():
    assert state_of(WORK, STARTING) == "queued: waiting for the workers"
    assert state_of(dataclasses.replace(WORK, fraction=0.1), STARTING) == "10\u202f%"


def test_compilation_of_the_kernels_is_shown_with_its_progress():
    compiling = dataclasses.replace(STARTING, kernels=KernelProgress(3, 11, "heights"))
    text = job_list(compiling, View())
    assert "Compiling the numerical kernels for this machine, once" in text
    assert "3 of 11" in text
    assert "data-pick" not in text
    assert state_of(WORK, compiling) == "queued: waiting for the numerical kernels"
    assert "Compiling" not in job_list(READY, View())


def test_a_name_from_a_file_is_harmless_and_a_job_that_is_being_stopped_has_no_cross():
    work = Work("w1", "Import of <b>", cancellable=False, stopping=True)
    text = job_list(dataclasses.replace(READY, works=(work,)), View())
    assert "Import of &lt;b&gt;" in text
    assert "stopping" in text
    assert "data-pick" not in text


def test_time_left_follows_from_what_was_done_since_the_first_word():
    assert seconds_left(10.0, 0.0, 0.5) == pytest.approx(10.0)
    assert seconds_left(10.0, 0.5, 0.75) == pytest.approx(10.0)
    assert seconds_left(1.0, 0.0, 0.5) is None
    assert seconds_left(10.0, 0.0, 0.01) is None


def test_progress_tells_the_time_left_and_an_end_takes_the_job_off_the_list():
    command_queue, now_s = CommandQueue(Snapshot()), [100.0]
    try:
        notices = Notifications(command_queue, lambda: now_s[0])
        work = command_queue.do(notices.begin, "Stitching", lambda: None, "the first field").result()
        command_queue.do(notices.progress, work, 0.2).result()
        now_s[0] = 120.0
        command_queue.do(notices.progress, work, 0.4).result()
        assert command_queue.snapshot.works[0].seconds_left == pytest.approx(60.0)
        command_queue.do(notices.cancel, work).result()
        assert (command_queue.snapshot.works[0].stopping, command_queue.snapshot.works[0].cancellable) == (True, False)
        command_queue.do(notices.end, work).result()
        assert command_queue.snapshot.works == ()
    finally:
        command_queue.close()
