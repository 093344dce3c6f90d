"""A trial as the panel tells it, and dies coloured by their word."""

from __future__ import annotations

import dataclasses

import pytest

from tests.gui.steps.test_align import words
from tests.session.conftest import small_job
from wafer_viewer.draw.charts.die_map import die_map_svg
from wafer_viewer.gui.presenters.results import kept_features
from wafer_viewer.gui.presenters.verdict import dies, features
from wafer_viewer.gui.steps.job_dialogs import lattice_of, relative_to_die, within_fields
from wafer_viewer.gui.steps.trial import MOST_CHANGES, before_release, trial, trial_is_old
from wafer_viewer.model.acquisition.plan import FieldGrid
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import JudgedDie, NotTried, Trial, TriedWafer, VerdictChange
from wafer_viewer.model.measurement.feature import Dies
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Operating, Snapshot

CHANGE = VerdictChange(
    feature="die <over> street",
    before="pass",
    after="fail",
    measured_before=Quantity(value=12.8, unit="um", expanded=0.02, status="evaluated"),
    measured_after=Quantity(value=12.8, unit="um", expanded=0.02, status="evaluated"),
    why=("Limits: 11 to 13 um before, 11 to 12.5 um now.",),
)
WAFER = TriedWafer(
    dataset="w2.wafer", wafer_id="W2", result="default", before="pass", after="fail", changes=(CHANGE,), n_same=3
)
LEFT_OUT = NotTried(dataset="w3.wafer", why="The wafer was not aligned.")


def test_each_change_is_told_with_its_reason_and_what_was_left_out():
    done = Trial(job="coupon B", wafers=(WAFER,), not_tried=(LEFT_OUT,))
    text = words(trial(done, trying=False))
    assert "1 of 4 verdicts changes; 1 of 1 wafer gets another word, 1 dataset not judged." in text
    assert "W2, die &lt;over&gt; street" in text
    assert "Limits: 11 to 13 µm before, 11 to 12.5 µm now." in text
    assert "PASS" in text
    assert "FAIL" in text
    assert "w3.wafer was not judged. The wafer was not aligned." in text
    assert "<over>" not in trial(done, trying=False)
    assert "12.80" not in text, "what did not change is not told twice"


def test_many_changes_are_counted_and_nothing_stands_there_before_a_trial():
    many = replace(WAFER, changes=(CHANGE,) * (MOST_CHANGES + 2))
    assert "And 2 more" in words(trial(Trial(job="B", wafers=(many,)), trying=False))
    assert trial(None, trying=False) == ""
    assert "being judged" in words(trial(None, trying=True))


def test_a_release_says_what_is_known_of_stored_wafers_and_an_old_trial_is_called_old():
    done = Trial(job="coupon B", wafers=(WAFER,))
    now = Operating(trial=done)
    assert "1 of 4 verdicts changes" in words(before_release(now, outdated=False))
    assert "since it was changed" in words(before_release(now, outdated=True))
    assert "Not tried on stored wafers yet" in words(before_release(Operating(), outdated=False))
    assert "Try it again" in words(trial(done, trying=False, outdated=True))
    job = small_job()
    draft = dataclasses.replace(Snapshot().draft, job=replace(job, revision="B"))
    snapshot = Snapshot(draft=draft, operating=dataclasses.replace(now, trial_of=job))
    assert not trial_is_old(snapshot), "another name of its revision changes no verdict"
    draft = dataclasses.replace(draft, job=replace(job, z_start_um=1.0))
    assert trial_is_old(dataclasses.replace(snapshot, draft=draft))


def die(name, x_um, word):
    return JudgedDie(name=name, x_um=x_um, y_um=0.0, width_um=8.0, height_um=8.0, word=word)


def test_every_die_has_a_colour_and_all_but_the_good_ones_a_sign():
    svg = die_map_svg([die("0,0", 0, "pass"), die("1,0", 10, "fail"), die("2,0", 20, "inconclusive")])
    assert [svg.count(f"var(--{tone})") > 0 for tone in ("good", "fault", "attention")] == [True] * 3
    assert svg.count("<text") == 2
    assert "<title>Die 1,0: fail</title>" in svg
    assert "<circle" not in svg
    assert "<circle" in die_map_svg([die("0,0", 0, "pass")], across_um=30.0)


def test_good_dies_are_counted_and_the_others_listed():
    from tests.browser.sessions import operator_session as day

    good, bad = day.PASS.items[0], day.FAIL.items[0]
    items = (replace(good, die="0,0"), replace(good, die="1,0"), replace(bad, die="2,0"))
    judged = (die("0,0", 0, "pass"), die("1,0", 10, "pass"), die("2,0", 20, "fail"))
    verdict = replace(day.FAIL, items=items, dies=judged)
    text = words(features(verdict))
    assert "die over street, die 2,0" in text
    assert "die over street, die 0,0" not in text
    assert "2 of 3 dies pass" in text
    assert "1 fail, 2 pass" in words(dies(verdict))
    assert dies(day.FAIL) == ""


def test_a_result_that_was_kept_can_be_a_feature():
    from tests.browser.sessions import fake_session as fake

    stored = kept_features(fake.measured())
    steps = [feature for feature in stored.values() if feature.tool == "step"]
    assert steps
    assert len(steps[0].places) == 2
    assert steps[0].unit("") == "um"
    assert "height" in steps[0].quantities


def test_the_dies_that_the_fields_show_whole_are_kept_and_a_place_is_counted_from_its_die():
    grid = FieldGrid(rows=1, cols=2, field_width_um=100, field_height_um=100, overlap_x_fraction=0, x0_um=50, y0_um=50)
    job = replace(small_job(), grid=grid)
    lattice = Dies(width_um=40, height_um=40, rows=3, cols=5, pitch_x_um=45, pitch_y_um=45, x0_um=5, y0_um=5)
    shown = within_fields(lattice, job)
    assert [die.name for die in shown.listed] == ["0,0", "1,0", "2,0", "3,0", "0,1", "1,1", "2,1", "3,1"]
    assert lattice_of(shown).cols == 4
    assert lattice_of(lattice) == lattice
    place = Region.rectangle(60, 10, 80, 20)
    (counted,) = relative_to_die((place,), shown)
    assert counted == Region.rectangle(10, 5, 30, 15)
    with pytest.raises(PlanError, match="lie on no die"):
        relative_to_die((Region.point(300, 300),), shown)
    with pytest.raises(PlanError, match="No die of this lattice"):
        within_fields(replace(lattice, x0_um=900.0), job)
