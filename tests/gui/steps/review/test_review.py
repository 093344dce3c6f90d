"""What is under review as data, and views as they are kept and taken up again."""

from __future__ import annotations

import dataclasses

import numpy as np

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import operator_session as operator
from wafer_viewer.gui.page.work_steps import done
from wafer_viewer.gui.presenters.review import chosen_item, neighbour, review_items
from wafer_viewer.gui.scene.camera_presets import CameraPose
from wafer_viewer.gui.shell.left_panel import field_at
from wafer_viewer.gui.shell.saved_views import LOOKED, choices, saved
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.review.defect_list import review_list
from wafer_viewer.gui.steps.review.review_step import numbers_of
from wafer_viewer.model.job import Judgement, Notebook, keys_of_features
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import NotebookState, Operating, Snapshot

POSE = CameraPose(np.array([0.1, -0.9, 0.8]), np.array([0.0, 0.1, 0.0]))


def noted(snapshot: Snapshot, *judgements: Judgement) -> Snapshot:
    return dataclasses.replace(snapshot, notebook=NotebookState(Notebook(judgements=judgements)))


def judged(*judgements: Judgement) -> Snapshot:
    return noted(fake.measured(), *judgements)


def at(key: str | None, **chosen: str) -> View:
    """A review of one item."""
    return View(step="review", review=key, **chosen)


def test_results_are_items_with_their_place_numbers_and_judgement():
    first, second = review_items(judged(Judgement(key="result 2", verdict="rejected", note="burr")))
    assert (first.key, first.sign, first.title) == ("result 1", "S1", "Die to trench")
    assert first.box_um == (0.0, -120.0, 80.0, 60.0)
    assert first.rows[0] == ("Height", "11.86", "0.31", "µm")
    assert (first.judgement.verdict, second.judgement.note) == ("open", "burr")


def test_features_of_a_released_job_come_first_with_the_word_of_the_instrument():
    items = review_items(operator.judged(operator.FAIL))
    assert [item.sign for item in items[:2]] == ["F1", "F2"]
    assert (items[0].word, items[0].reason) == ("fail", "Over the upper limit.")
    assert {"Step height", "Lower limit", "Upper limit"} <= {row[0] for row in items[0].rows}
    x0, y0, x1, y1 = items[0].box_um
    assert x0 < x1
    assert y0 < y1


def test_a_filter_lists_what_is_open_or_was_rejected():
    now = judged(Judgement(key="result 1", verdict="accepted"), Judgement(key="result 2", verdict="rejected"))
    assert [item.key for item in review_items(now, "rejected")] == ["result 2"]
    assert review_items(now, "open") == ()


def test_going_on_runs_round_the_ends_and_starts_at_either():
    now = fake.measured()
    first, last = (item.key for item in review_items(now))
    assert neighbour(now, at(last), 1).key == first
    assert neighbour(now, at(first), -1).key == last
    assert neighbour(now, at("gone"), 1).key == first
    assert neighbour(now, at(None), 1).key == last
    assert neighbour(dataclasses.replace(now, findings=()), at(None), 1) is None
    assert chosen_item(now, at("gone")).key == first


def test_one_goes_on_to_what_is_open_and_back_to_what_was_before():
    now = noted(operator.judged(operator.FAIL), Judgement(key="feature pad over die", verdict="accepted"))
    assert neighbour(now, at("feature die over street"), 1).key == "result 1"
    assert neighbour(now, at("result 1"), -1).key == "feature pad over die"
    assert neighbour(now, at("result 2", review_filter="rejected"), 1) is None
    everything = tuple(Judgement(key=item.key, verdict="accepted") for item in review_items(now))
    assert neighbour(noted(now, *everything), at("result 1"), 1).key == "result 2"


def test_a_feature_that_fails_stands_before_those_that_pass_and_says_so_beside_its_limits():
    now = operator.judged(operator.a_verdict(30.03, 2.31))
    first, second = (item for item in review_items(now) if item.word is not None)
    assert (first.sign, first.title, first.word, second.word) == ("F2", "pad over die", "fail", "pass")
    shown = review_list(now, View(step="review"))
    assert shown.index("FAIL") < shown.index("PASS") < shown.index("Die to trench")
    assert "<b>2.310</b> ± 0.060<small>1.8 … 2.2" in shown
    assert 'aria-label="pad over die, FAIL, open"' in shown
    assert "Over the upper limit." in numbers_of(first)


def test_features_of_one_name_are_judged_apart():
    one = operator.FAIL.items[0]
    twins = replace(operator.FAIL, items=(one, one))
    keys = keys_of_features(twins)
    assert keys == ("feature die over street", "feature die over street (2)")
    now = noted(operator.judged(twins), Judgement(key=keys[1], verdict="rejected", note="dust"))
    assert [item.judgement.note for item in review_items(now)][:2] == ["", "dust"]


def test_a_review_of_features_ends_when_they_are_judged():
    now = dataclasses.replace(operator.judged(operator.PASS), findings=())
    assert not done("review", now)
    judgements = (Judgement(key=key, verdict="accepted") for key in keys_of_features(operator.PASS))
    assert done("review", noted(now, *judgements))
    assert not done("review", dataclasses.replace(now, operating=Operating()))


def test_a_view_is_kept_and_taken_up_again_as_it_was():
    view = View(step="surface", look="plan", colour_by="slope", range_um=(1.0, 5.0), exaggeration=7.0, show=3)
    stored = saved(view, POSE, "near")
    assert stored.position_mm == (0.1, -0.9, 0.8)
    assert dataclasses.replace(View(step="surface"), **choices(stored, fake.measured())) == view
    assert set(LOOKED) == set(choices(stored, fake.measured()))


def test_a_view_of_a_field_that_is_gone_or_in_words_of_another_version_still_opens():
    stored = replace(saved(View(show=99), POSE, ""), look="hologram")
    taken = choices(stored, fake.measured())
    assert taken["show"] == 0
    assert taken["look"] == "surface"


def test_the_field_under_a_place_is_the_one_whose_centre_is_nearest():
    now, view = fake.measured(), View(step="surface")
    first = now.dataset.fields[0]
    assert field_at(now, view, first.x_um + 5, first.y_um - 5) == first
    assert field_at(now, view, 1e6, 0.0) is None
