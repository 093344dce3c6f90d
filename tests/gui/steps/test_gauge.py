"""The step Gauge check as a function: the way from faces to a signature, terms, earlier checks, the instrument."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from tests.browser.sessions import calibrated_states as made_up
from tests.browser.sessions.gauge_blocks import certificate
from tests.browser.sessions.gauge_session import LOWER, TERMS, UPPER, GaugeSession, checked, correctable
from tests.gui.steps.test_steps import Page
from tests.gui.steps.test_surface import html_of, shown
from tests.support.patience import until
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.gauge.gauge_check import CHECK_PICKS, points, run_chart_dock
from wafer_viewer.gui.steps.gauge.gauge_step import (
    GAUGE_PICKS,
    CheckInputs,
    gauge_commands,
    gauge_step,
    next_of,
    why_not,
)
from wafer_viewer.gui.steps.gauge.instrument import INSTRUMENT_PICKS, instrument_commands, instrument_step
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.session.state.inspection_state import GaugeState
from wafer_viewer.session.state.snapshot import Snapshot

FIRST = GaugeState(certificate=certificate(), terms=TERMS)


class CheckPage(Page):
    """A page over a session that checks blocks; commands are carried out at once."""

    def __init__(self, session: GaugeSession, view: View) -> None:
        super().__init__(view)
        self.session = session

    def ask(self, name: str, verb: Any, then: Any = None) -> None:
        verb.result(20)
        if then is not None:
            then(verb.result())


@pytest.fixture
def begin() -> Iterator[Any]:
    sessions: list[GaugeSession] = []

    def begin(state: GaugeState | None = None, *, faces: bool = True, surface: bool = True, **view: Any) -> Here[Any]:
        sessions.append(GaugeSession(state, surface))
        page: Any = CheckPage(sessions[-1], View(step="gauge", faces=(UPPER, LOWER) if faces else (), **view))
        return Here(page, CheckInputs())

    yield begin
    for session in sessions:
        session.close()


PICKS: dict[str, Any] = {**GAUGE_PICKS, **CHECK_PICKS, **INSTRUMENT_PICKS}


def pick(here: Here[Any], subject: str, key: str = "") -> None:
    PICKS[subject](here, key)


def text(here: Here[Any], step: Any = gauge_step) -> str:
    here.snapshot = here.page.session.snapshot
    return "".join(str(e.content) for e in html_of(here, step))


@pytest.mark.slow
def test_each_state_of_a_check_has_one_leading_button(begin: Any):
    for state, label in (
        (GaugeState(), "Load the certificate…"),
        (FIRST, "Measure the step"),
        (checked(), "Sign and save"),
        (correctable(), "New check"),
    ):
        here = begin(state)
        leads = {"Load the certificate…", "Measure the step", "Sign and save", "New check"}
        assert leads & shown(here, gauge_step).keys() == {label}


@pytest.mark.slow
def test_the_step_is_measured_again_and_the_check_begun_anew(begin: Any):
    here = begin(FIRST)
    assert shown(here, gauge_step)["Measure again"].disabled
    shown(here, gauge_step)["Measure the step"].act()
    assert len(here.page.session.snapshot.gauge.repeats) == 1
    shown(here, gauge_step)["Measure again"].act()
    assert text(here).count("gauge-drop") == 2
    pick(here, "gauge-drop", "0")
    assert text(here).count("gauge-drop") == 1
    next(c for c in gauge_commands(here) if c.name == "Begin a new check").act()
    assert "Measure the step" in shown(here, gauge_step)


def test_without_faces_they_are_looked_for_once(begin: Any):
    here = begin(FIRST, faces=False)
    assert why_not(here.snapshot, here.view, "measure") == "the regions do not lie on the faces yet."
    text(here)
    until(lambda: here.page.view.faces == (UPPER, LOWER))
    here.page.change(faces=())
    text(here)
    assert here.page.view.faces == ()  # a person took them away


def test_faces_that_are_not_found_can_be_placed_by_hand(begin: Any, monkeypatch: pytest.MonkeyPatch):
    here = begin(FIRST, faces=False)

    def none_found(show: int = 0) -> Any:
        raise MeasureError("No two planes are large enough.")

    monkeypatch.setattr(here.page.session.gauge, "find_faces", none_found)
    until(lambda: "No two planes are large enough." in text(here))
    pick(here, "gauge-lay")
    assert len(here.page.view.faces) == 2
    assert "No two planes" not in text(here)


def test_what_refuses_a_scan_stands_where_the_state_does(begin: Any):
    here = begin(replace(FIRST, refusal="The certificate expired."))
    assert "The certificate expired." in text(here)
    assert shown(here, gauge_step)["Measure the step"].disabled
    assert "No surface of the blocks yet." in text(begin(GaugeState(), surface=False))


@pytest.mark.parametrize(
    ("label", "put", "field", "now"),
    [
        ("Limit, ± µm", 0.7, "limit_um", 0.7),
        ("Limit, ± µm", None, "limit_um", None),
        ("Blocks, °C", 21.5, "temperature_c", 21.5),
        ("Tolerance, µm", 3.0, "tolerance_um", 3.0),
        ("Next in, days", 14, "interval_days", 14),
    ],
)
def test_each_term_is_put_and_shown(begin: Any, label: str, put: Any, field: str, now: Any):
    here = begin(FIRST)
    shown(here, gauge_step)[label].put(put)
    assert getattr(here.page.session.snapshot.gauge.terms, field) == now
    assert shown(here, gauge_step)[label].value == now


@pytest.mark.slow
def test_terms_and_buttons_are_of_the_present_check(begin: Any):
    here = begin(checked())
    here.page.change(check=here.page.session.snapshot.gauge.records[0].check.at)
    assert "Earlier check" in text(here)
    assert shown(here, gauge_step).keys() == {"Gauge R&R study…"}
    pick(here, "gauge-record", here.page.view.check or "")
    assert here.page.view.check is None


def test_enter_goes_through_the_procedure(begin: Any):
    here = begin(FIRST)
    for name in ("clean", "warm"):
        next_of(here.page)
        now = {point.name: point.done for point in points(here.page.session.snapshot)}
        assert now[name]
    next_of(here.page)
    assert len(here.page.session.snapshot.gauge.repeats) == 1


@pytest.mark.slow
def test_another_scale_is_offered_only_after_a_check_that_asks_for_it(begin: Any):
    assert "Correct the z scale…" in shown(begin(correctable()), gauge_step)
    assert "Correct the z scale…" not in shown(begin(checked()), gauge_step)
    assert "wv-dot" in text(begin(checked()), run_chart_dock)


def instrument(now: Snapshot, kind: Any = "delay") -> Here[None]:
    page: Any = Page(View(step="gauge", instrument=True, calibration=kind))
    page.session.snapshot = now
    return Here(page, None)


@pytest.mark.parametrize(
    ("now", "kind", "label", "possible"),
    [
        (made_up.instrument_session().snapshot, "delay", "Run here…", True),
        (made_up.instrument_session().snapshot, "linearity", "Evaluate the checks", True),
        (made_up.instrument_session(made_up.pending()).snapshot, "delay", "Keep…", True),
        (made_up.instrument_session(made_up.pending()).snapshot, "pixel", "Run here…", False),
        (made_up.running(), "pixel", "Run here…", False),
    ],
)
def test_a_calibration_leads_to_its_next_step(now: Snapshot, kind: Any, label: str, possible: bool):
    here = instrument(now, kind)
    buttons = shown(here, instrument_step)
    assert buttons.keys() - {"Discard…"} == {label}
    assert buttons[label].disabled is not possible
    assert ("Discard…" in buttons) is (label == "Keep…")
    assert ("Not yet:" in text(here, instrument_step)) is not possible


def test_a_kind_is_chosen_from_the_list():
    here = instrument(made_up.instrument_session().snapshot)
    pick(here, "calibration-kind", "flatness")
    assert here.page.view.calibration == "flatness"
    pick(here, "calibration-live")
    assert (here.page.view.step, here.page.view.live) == ("plan", True)


def test_a_result_is_needed_to_keep_one():
    here = instrument(made_up.instrument_session().snapshot)
    commands = {c.name: c for c in instrument_commands(here.page)}
    keep = commands["Keep the calibration…"]
    assert keep.why_not is not None
    assert keep.why_not(here.snapshot, here.view) == "no result waits."
