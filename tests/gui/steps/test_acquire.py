"""The step Acquire as a function of the snapshot: what it shows and offers, without a browser."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import operator_session as operator
from tests.gui.steps.test_steps import flat
from wafer_viewer.gui.elements.elements import Button, Html, Picture, Progress
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.acquire import acquire_step, pause_or_resume
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.session.state.snapshot import Snapshot


class Session:
    """A session whose commands are noted."""

    def __init__(self, snapshot: Snapshot) -> None:
        self.snapshot, self.latest_frame = snapshot, fake.a_frame(snapshot) if snapshot.scanning else None
        self.done: list[str] = []

    def __getattr__(self, name: str) -> Any:
        return lambda: self.done.append(name)


def shown(snapshot: Snapshot, *, narrow: bool = False, **view: Any) -> tuple[list[Any], Any]:
    session, none = Session(snapshot), lambda *_, **__: None
    page = SimpleNamespace(session=session, notes=lambda _: "", ask=none, change=none, watches_scan=narrow)
    here: Any = SimpleNamespace(snapshot=snapshot, view=View(step="acquire", **view), page=page)
    return flat(acquire_step(here)), page


def buttons(snapshot: Snapshot) -> dict[str, tuple[str, bool]]:
    elements, _ = shown(snapshot)
    return {one.label: (one.style, one.disabled) for one in elements if isinstance(one, Button)}


def text(snapshot: Snapshot, **view: Any) -> str:
    return "".join(one.content for one in shown(snapshot, **view)[0] if isinstance(one, Html))


def in_state(state: Any) -> Snapshot:
    now = fake.scanning()
    return replace(now, rig=replace(now.rig, state=state))


def damaged() -> Snapshot:
    now = fake.measured()
    assert now.dataset is not None
    return replace(now, dataset=replace(now.dataset, damaged=(Shot(1, 4),)))


def test_a_running_scan_has_progress_picture_pause_and_stop():
    elements, _ = shown(fake.scanning())
    (progress,) = [one for one in elements if isinstance(one, Progress)]
    assert 0 < progress.fraction < 1
    assert any(isinstance(one, Picture) for one in elements)
    assert buttons(fake.scanning()) == {"Pause": ("plain", False), "Stop scan": ("plain", False)}


def test_pause_is_continue_in_a_pause_and_neither_can_be_pressed_while_it_stops():
    assert buttons(in_state("paused")) == {"Continue": ("plain", False), "Stop scan": ("plain", False)}
    assert buttons(in_state("stopping")) == {"Pause": ("plain", True), "Stop scan": ("plain", True)}
    for state, done in (("paused", "resume"), ("scanning", "pause")):
        _, page = shown(in_state(state))
        pause_or_resume(page)
        assert page.session.done == [done]


def test_an_unfinished_scan_can_go_on_if_the_rig_can_start():
    assert buttons(fake.unfinished()) == {"Continue the scan": ("leading", False)}
    now = fake.unfinished()
    lost = replace(now, rig=replace(now.rig, state="absent", limits=None, message="The box does not answer."))
    assert buttons(lost) == {"Continue the scan": ("leading", True)}
    assert "Not yet: The box does not answer." in text(lost)


def test_damaged_frames_are_taken_again_by_the_rig_that_took_them():
    assert list(buttons(damaged())) == ["Take damaged frames again…", "Look at the surface"]
    elsewhere = damaged()
    assert elsewhere.dataset is not None
    moved = replace(elsewhere, dataset=replace(elsewhere.dataset, imported=True))
    assert buttons(moved)["Take damaged frames again…"] == ("leading", True)
    assert "this rig did not take the dataset" in text(moved)


def test_a_scan_that_is_done_leads_to_its_surface():
    assert buttons(fake.measured()) == {"Look at the surface": ("leading", False)}


@pytest.mark.parametrize(("verdict", "others"), [(operator.PASS, []), (operator.OPEN, ["Scan it again"])])
def test_a_released_job_leads_to_the_next_wafer(verdict: Any, others: list[str]):
    judged = operator.judged(verdict)
    assert list(buttons(judged)) == ["Look at the surface", "Next wafer", *others]


def test_a_narrow_window_offers_no_step_that_it_does_not_show():
    elements, _ = shown(operator.judged(operator.OPEN), narrow=True)
    assert not [one for one in elements if isinstance(one, Button)]


def test_a_released_job_shows_counters_and_picture_only_if_all_is_unfolded():
    assert "Counters" not in text(operator.taking())
    assert "Show everything" in text(operator.taking())
    assert "Counters" in text(operator.taking(), everything=True)
