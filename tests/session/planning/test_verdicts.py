"""When a surface is judged: once it is whole, once only, and anew when it is another one."""

from __future__ import annotations

import dataclasses
import threading
from types import SimpleNamespace

import pytest

from tests.browser.sessions import operator_session as day
from tests.support.datasets.judged_datasets import RESULT, STEP, judged_dataset, released_job
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.planning import verdicts as module
from wafer_viewer.session.planning.verdicts import Judge, stored_verdict
from wafer_viewer.session.state.snapshot import Operating, Work
from wafer_viewer.store.dataset.dataset import Dataset

STITCHING = (Work("w1", "Stitching the fields"),)
PATIENCE_S = 20.0


@pytest.fixture
def verdicts(monkeypatch):
    """What the next judgements come to; each waits until `go` is set."""
    made = SimpleNamespace(answers=[], n=0, go=threading.Event())
    made.go.set()

    def verdict_of(data, result, *, keep):
        made.go.wait(PATIENCE_S)
        made.n += 1
        answer = made.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(module, "verdict_of", verdict_of)
    return made


@pytest.fixture
def command_queue(verdicts):
    made = CommandQueue(day.judged(None))
    made.do(made.change, operating=Operating()).result()
    library = SimpleNamespace(dataset=None, result=None, shown=made.now.dataset)
    judge = Judge(made, library, Notifications(made))
    yield made
    verdicts.go.set()
    made.close()
    judge.close()


def change(command_queue, **fields):
    command_queue.do(lambda: command_queue.change(**fields)).result()


def came_to(command_queue, verdict):
    return command_queue.wait_until(
        lambda now: now.operating.verdict == verdict and not now.operating.judging, PATIENCE_S
    )


def test_a_surface_is_judged_when_it_is_whole_and_once(command_queue, verdicts):
    verdicts.answers, verdicts.go = [day.PASS], threading.Event()
    change(command_queue, works=STITCHING)
    change(command_queue, works=())
    command_queue.wait_until(lambda now: now.operating.judging, PATIENCE_S)
    verdicts.go.set()
    came_to(command_queue, day.PASS)
    change(command_queue, works=(Work("w2", "Export"),))
    change(command_queue, works=())
    came_to(command_queue, day.PASS)
    assert verdicts.n == 1, "other work on the same surface asks for no other verdict"


@pytest.mark.slow
def test_another_surface_is_judged_anew_and_none_without_a_dataset(command_queue, verdicts):
    verdicts.answers = [day.PASS, day.FAIL]
    change(command_queue, works=())
    came_to(command_queue, day.PASS)
    surface = command_queue.now.surface
    change(command_queue, works=STITCHING, surface=dataclasses.replace(surface, stamp=surface.stamp + 1))
    command_queue.wait_until(lambda now: now.operating.verdict is None, PATIENCE_S)
    change(command_queue, works=())
    came_to(command_queue, day.FAIL)
    assert verdicts.n == 2
    change(command_queue, dataset=None, surface=None)
    came_to(command_queue, None)
    assert verdicts.n == 2, "without a dataset there is nothing to judge"


def test_what_cannot_be_judged_is_reported(command_queue, verdicts):
    verdicts.answers = [MeasureError("The disk is gone: look at it.")]
    change(command_queue, works=())
    reported = command_queue.wait_until(lambda now: now.faults, PATIENCE_S)
    assert (reported.faults[0].title, reported.faults[0].text) == (
        "There is no verdict",
        "The disk is gone: look at it.",
    )


def test_without_a_feature_nothing_is_judged(command_queue, verdicts):
    data = command_queue.now.dataset
    change(command_queue, dataset=dataclasses.replace(data, job=replace(data.job, features=())))
    change(command_queue, works=())
    assert verdicts.n == 0
    assert command_queue.now.operating == Operating()


def test_wafer_with_a_feature_that_has_no_place_does_not_pass(tmp_path):
    job = replace(released_job(), released=False, features=(STEP, replace(STEP, name="frame", places=())))
    data = Dataset.open(judged_dataset(tmp_path / "W1.wafer", 12.0, job))
    verdict = stored_verdict(data, data.result(RESULT))
    assert verdict is not None
    assert [(item.name, item.word) for item in verdict.items] == [("die over street", "pass"), ("frame", "no verdict")]
    assert (verdict.word, verdict.next) == ("no verdict", "'frame' has no place to be measured at: give it one.")
