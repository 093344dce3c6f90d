"""What the page says, without a browser: escaping, times, lengths, curves, steps, what a browser remembers."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future
from datetime import datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import escape

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import seen_session as seen
from wafer_viewer.draw.number_format import format_time
from wafer_viewer.gui.page.panels import bottom_panel_height_px
from wafer_viewer.gui.page.work_steps import STEPS, done, possible
from wafer_viewer.gui.presenters import measurement
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.surface import focus_evidence
from wafer_viewer.gui.steps.surface.focus_evidence import focus_measurement_text
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.style import DARK, LIGHT, page_style
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.job import Judgement, Notebook, key_of_result
from wafer_viewer.model.measurement.measurements import Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.reconstruct.gates.gate import POWERS
from wafer_viewer.session.state.snapshot import Fault, NotebookState


@given(st.text())
def test_nothing_from_people_becomes_markup(text):
    for piece in (html.title(text, text), html.note("fault", text, text), html.head(text, text), html.empty(text)):
        assert escape(text) in piece
        assert "<script" not in piece


def test_a_picked_key_cannot_leave_its_attribute():
    attributes = html.pick("open", "a\"b'c<d>")
    assert 'data-k="a&#34;b&#39;c&lt;d&gt;"' in attributes


NOW = datetime(2026, 11, 21, 12, 0, tzinfo=timezone(timedelta(hours=1)))


@pytest.mark.parametrize(
    ("taken", "said"),
    [
        ("2026-11-21T07:41:07+00:00", "today 08:41"),
        ("2026-11-20T23:30:00+00:00", "today 00:30"),
        ("2026-11-20T08:00:00+00:00", "yesterday 09:00"),
        ("2026-03-01T08:00:00+00:00", "1 Mar"),
        ("2025-12-31T08:00:00+00:00", "31 Dec 2025"),
        ("in spring", "in spring"),
    ],
)
def test_times_read_as_people_say_them(taken, said):
    assert format_time(taken, NOW) == said


@pytest.mark.parametrize(
    ("length", "words"),
    [
        (Length(value_um=11.8623, expanded_um=0.3112, status="evaluated"), ("11.86", "± 0.31\u202fµm", "k = 2")),
        (Length(value_um=11.8623), ("11.86", "U not evaluated")),
        (Length(value_um=-3.0, status="uncalibrated"), ("−3.00", "uncalibrated")),
    ],
)
def test_an_answer_never_stands_without_its_uncertainty_or_the_reason(length, words):
    card = measurement.answer("Step", length.quantity)
    assert all(word in card for word in words)


def test_the_budget_ends_with_the_combined_and_the_expanded_uncertainty():
    step = fake.a_step(Region.rectangle(0, 0, 1, 1), Region.rectangle(0, 2, 1, 3))
    words = measurement.budget(step.main)
    assert "Flatness of the regions" in words
    assert "0.155 · 0.310" in words


def test_a_step_is_possible_when_it_has_contents():
    def of(snapshot):
        return {step for step in STEPS if possible(step, snapshot)}

    assert of(fake.planned()) == {"plan", "gauge"}
    assert of(fake.scanning()) == {"plan", "acquire", "surface", "gauge"}
    measured = fake.measured()
    assert of(measured) == set(STEPS)
    assert of(dataclasses.replace(measured, surface=None)) == set(STEPS) - {"measure", "review", "report"}
    assert {step for step in STEPS if done(step, measured)} == {"plan", "acquire", "surface"}
    judged = tuple(Judgement(key=key_of_result(f.number), verdict="accepted") for f in measured.findings)
    reviewed = dataclasses.replace(measured, notebook=NotebookState(Notebook(judgements=judged)))
    assert {step for step in STEPS if done(step, reviewed)} == set(STEPS) - {"gauge", "report"}


def test_both_palettes_name_the_same_colours():
    assert LIGHT.keys() == DARK.keys()
    assert "--accent:#58BDE8" in page_style(dark=True, bottom_px=0)


def luminance(colour: str) -> float:
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("colours", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.parametrize(
    ("ink", "paper", "ratio"),
    [
        ("ink2", "panel", 7.0),
        ("ink3", "panel", 4.5),
        ("accent", "accent-soft", 4.5),
        ("good", "good-soft", 4.5),
        ("attention", "attention-soft", 4.5),
        ("fault", "fault-soft", 4.5),
    ],
)
def test_all_text_can_be_read(colours, ink, paper, ratio):
    light, dark = sorted((luminance(colours[ink]), luminance(colours[paper])), reverse=True)
    assert (light + 0.05) / (dark + 0.05) >= ratio


class Told:
    def __init__(self):
        self.faults: list[Fault] = []

    def tell(self, fault: Fault) -> None:
        self.faults.append(fault)


def test_the_guard_tells_in_the_programs_own_sentence():
    text = Told()

    @guarded(text, "Import stopped")
    def stop():
        raise DatasetError("Import stopped at a.tif: it is truncated. Nothing was written.")

    stop()
    assert [(f.title, f.text) for f in text.faults] == [
        ("Import stopped at a.tif", "It is truncated. Nothing was written.")
    ]


def test_the_guard_watches_a_verb_until_it_is_done():
    text, verb = Told(), Future()
    guarded(text, "The scan did not start")(lambda: verb)()
    assert text.faults == []
    verb.set_exception(DatasetError("The folder cannot be written to."))
    assert text.faults[0].title == "The scan did not start"


def test_the_guard_tells_what_nobody_foresaw(caplog):
    text = Told()
    guarded(text, "The grid was not changed")(lambda: 1 / 0)()
    assert "Unexpected error: division by zero" in text.faults[0].text
    assert "ZeroDivisionError" in caplog.text


def test_every_verdict_says_in_words_what_its_sign_says():
    curve = seen.a_focus_curve(0.0, 0.0, measured=False)
    text = focus_evidence.verdicts(curve)
    for words in ("passed", "not passed", "gate is off", "Is there texture to focus on?"):
        assert words in text
    assert text.count("<tr") == 1 + len(curve.verdicts)
    assert "Not measured" in focus_evidence.answer_card(curve)
    assert "Ambiguous peak" in focus_evidence.answer_card(curve)


def test_scores_and_limits_read_in_one_unit_that_needs_no_logarithm():
    curve = seen.a_focus_curve(0.0, 0.0)
    text = focus_evidence.verdicts(curve)
    for words in ("× 2.89", 'over</span> × 1.56"', "× 21.1", "up to</span> 30.0\u202f%", "0.31\u202fµm"):
        assert words.replace('"', "") in text
    assert "powers" not in text
    assert "1 at an end" not in text
    assert {v.unit for v in curve.verdicts} <= set(focus_evidence.FIGURES)


def test_the_units_of_gates_are_known():
    assert POWERS in focus_evidence.FIGURES
    odd = replace(seen.a_focus_curve(0.0, 0.0).verdicts[0], unit="furlongs", score=1.0, limit=2.0)
    text = focus_evidence.verdicts(replace(seen.a_focus_curve(0.0, 0.0), verdicts=(odd,)))
    assert "in furlongs" in text
    assert "1.00" in text


def test_what_is_off_says_so_once():
    curve = seen.a_focus_curve(0.0, 0.0)
    assert focus_evidence.verdicts(curve).count("gate is off") == 1
    text = replace(curve.verdicts[-1], note="Fewer than 12 frames.")
    assert "gate is off · Fewer than 12 frames." in focus_evidence.verdicts(replace(curve, verdicts=(text,)))


@given(st.text())
def test_what_a_gate_says_does_not_become_markup(text):
    curve = seen.a_focus_curve(0.0, 0.0)
    odd = replace(curve, origin=text, verdicts=(replace(curve.verdicts[0], question=text, note=text, unit=text),))
    said = focus_evidence.verdicts(odd) + focus_evidence.answer_card(odd)
    assert escape(text) in said


def test_a_simulated_curve_says_so():
    curve = seen.a_focus_curve(0.0, 0.0)
    assert focus_measurement_text(curve).startswith("SIMULATED · Tenengrad")
    assert "SIMULATED" not in focus_measurement_text(replace(curve, simulated=False))
    assert focus_measurement_text(replace(curve, focus_measure="of_old", simulated=False)).startswith("Of old,")


@pytest.mark.parametrize(
    ("view", "below"),
    [
        (View(step="measure", tool="profile"), "profile"),
        (View(step="measure", tool="profile", why=(1.0, 2.0)), "why"),
        (View(step="surface", why=(1.0, 2.0)), "why"),
        (View(step="plan", why=(1.0, 2.0)), "none"),
        (View(step="surface", tool="profile"), "none"),
        (View(step="plan", live=True), "live"),
        (View(step="surface", live=True), "none"),
    ],
)
def test_one_curve_at_a_time_takes_the_room_below_the_scene(view, below):
    assert view.below == below
    assert (bottom_panel_height_px(view) > 0) == (below != "none")
