"""Calibrations on the page: the table of kinds as a list, results beside the values before, drift as a chart."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.browser.sessions import calibrated_states as made_up
from tests.browser.sessions.fake_session import RIG
from wafer_viewer.gui.steps.gauge import instrument as words
from wafer_viewer.gui.widgets.number_field import EMPTY, option_label
from wafer_viewer.model.acquisition.characteristics import KINDS, NOT_MEASURED, CalibrationOption, KindOfCalibration
from wafer_viewer.rigs.virtual.rig import CALIBRATION
from wafer_viewer.session.state.instrument_state import CalibrationHistory, CalibrationState
from wafer_viewer.session.state.snapshot import Draft, Snapshot

STATE = made_up.calibrated()
READY = Snapshot(rig=RIG, calibration=STATE)


def test_the_list_has_every_kind_of_the_table_in_its_order(monkeypatch: pytest.MonkeyPatch):
    new = KindOfCalibration(title="Colour of the <lamp>", about="", needs="a white tile", interval_days=9)
    monkeypatch.setitem(KINDS, "colour", new)
    shown = words.kinds_list(STATE, "delay")
    assert [shown.index(f'data-k="{kind}"') for kind in KINDS] == sorted(
        shown.index(f'data-k="{kind}"') for kind in KINDS
    )
    assert "Colour of the &lt;lamp&gt;" in shown
    assert "needs a white tile" in shown
    assert f"{STATE.n_due} due" in shown


def test_a_kind_is_listed_with_its_value_its_day_and_whether_it_is_due():
    shown = words.kinds_list(STATE, "delay")
    assert "62.6 ± 4.7 µs · 17 Nov 2098" in shown
    assert "due 17 Nov 2099 · SIMULATED" in shown.replace("Due", "due")
    assert "due since 17 Nov 2026" in shown.replace("Due", "due")
    assert f"{len(KINDS)} due" in words.kinds_list(CalibrationState(), "delay")
    assert all(needs in words.not_measured() for needs in NOT_MEASURED.values())


def test_the_next_one_that_is_due_is_a_click_away():
    state = CalibrationState(tuple(CalibrationHistory(kind, is_due=kind == "noise") for kind in KINDS))
    assert 'data-k="noise"' in words.next_due(state, "delay")
    assert 'data-k="noise"' in words.next_due(state, "linearity")
    assert words.next_due(state, "noise") == ""


def test_a_result_stands_beside_the_value_before_and_names_what_differs_by_more_than_its_u():
    within = words.waiting(made_up.pending(drift=0.8).pending, STATE, "delay")
    assert ">62.6</td>" in within
    assert "<b>66.4</b>" in within
    assert "SIMULATED" in within
    assert "more than its U" not in within
    beyond = words.waiting(made_up.pending(drift=1.6).pending, STATE, "delay")
    assert "Trigger delay +7.5 µs" in beyond
    elsewhere = words.waiting(made_up.pending().pending, STATE, "pixel")
    assert "A result is waiting" in elsewhere
    for_information = words.waiting(made_up.pending("noise").pending, STATE, "noise")
    assert "the next scans do not use it" in for_information


def test_the_history_has_every_value_with_its_u_and_who_signed_it():
    table = words.history_table(STATE.history("delay"))
    assert table.index("17 Nov 2098") < table.index("17 Nov 2095")
    assert "M. Ott" in table
    assert words.history_table(STATE.history("pixel")) == ""
    chart = words.history_chart(STATE.history("delay"))
    assert chart.count("wv-dot") == 4
    assert "58.4 ± 4.7 µs · M. Ott" in chart
    assert "drawn here" in words.history_chart(STATE.history("flatness"))


def test_the_next_scans_are_listed_with_u_or_that_it_is_not_known():
    shown = words.next_scans(CALIBRATION)
    assert ">0.46729</td>" in shown
    assert "not known" in shown
    assert "The rig has no calibration." in words.next_scans(None)


@pytest.mark.parametrize(
    ("now", "kind", "why"),
    [
        (READY, "delay", None),
        (replace(READY, rig=replace(RIG, state="scanning")), "delay", "a scan is running"),
        (replace(READY, rig=replace(RIG, state="scanning")), "linearity", None),
        (replace(READY, rig=replace(RIG, state="working", message="Find the exposure")), "delay", "Find the exposure"),
        (replace(READY, draft=Draft(confirmed=False)), "delay", "Confirm it in Plan"),
        (replace(READY, rig=replace(RIG, state="absent")), "delay", "not ready (absent)"),
        (replace(READY, rig=replace(RIG, calibration=None)), "delay", "no calibration to start from"),
        (replace(READY, calibration=made_up.pending()), "pixel", "keep or discard the result first"),
        (made_up.running(), "pixel", "a calibration is running"),
    ],
)
def test_what_keeps_a_calibration_from_running_is_said(now: Snapshot, kind, why: str | None):
    said = words.why_not_run(now, kind)
    assert said is None if why is None else why in said


def test_a_running_calibration_shows_its_step_and_can_be_cancelled():
    shown = words.running(made_up.running())
    assert "Sweep up and down, 2 of 4" in shown
    assert 'data-k="work-1"' in shown
    stopping = made_up.running()
    (work,) = stopping.works
    halted = replace(stopping, works=(replace(work, cancellable=False, stopping=True),))
    assert "Cancel</span>" not in words.running(halted)
    assert "stopping" in words.running(halted)


def test_an_option_is_labelled_with_its_unit_and_says_what_an_empty_field_means():
    option = CalibrationOption(name="length_um", title="Length", about="", unit="um", default=1.0)
    assert option_label(option) == "Length, µm"
    assert all(option_label(option) in EMPTY for kind in KINDS.values() for option in kind.options)
