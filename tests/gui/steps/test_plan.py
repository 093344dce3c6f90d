"""The step Plan as a function: what it shows of a plan, what a person may change, and what typing does to the job."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest
from markupsafe import Markup

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import operator_session as day
from tests.gui.steps.test_steps import flat, labels
from wafer_viewer.gui.dialogs import dialog as dialog_module
from wafer_viewer.gui.elements.elements import Button, Fold, Html, Input
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps import job_dialogs
from wafer_viewer.gui.steps.job_dialogs import FeatureForm, feature_of
from wafer_viewer.gui.steps.plan import PICKS, plan_step, start, why_not_start
from wafer_viewer.gui.steps.plan_form import PlanState, enter
from wafer_viewer.model.errors import PlanError, WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace


class Session:
    """A session whose edits arrive when they are let through."""

    latest_frame = None

    def __init__(self, snapshot: Any) -> None:
        self.snapshot, self.edits = snapshot, list[tuple[Future[Any], dict[str, Any]]]()
        self.asked: list[str] = []

    def _change(self, **draft: Any) -> Future[Any]:
        self.edits.append((Future[Any](), draft))
        return self.edits[-1][0]

    def edit_job(self, job: Any) -> Future[Any]:
        return self._change(job=job, typed=None)

    def keep_typed(self, typed: Any) -> Future[Any]:
        return self._change(typed=typed)

    def arrive(self) -> None:
        for done, draft in self.edits:
            self.snapshot = dataclasses.replace(self.snapshot, draft=dataclasses.replace(self.snapshot.draft, **draft))
            done.set_result(None)
        self.edits.clear()

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: self.asked.append(name) or Future()


def here_of(snapshot: Any, **view: Any) -> Here[PlanState]:
    page: Any = SimpleNamespace(session=Session(snapshot), view=View(step="plan", **view), answers=None)
    page.redraw, page.notes, page.ask = lambda: None, lambda _: Markup(), lambda *_: None
    page.change = lambda **changes: setattr(page, "view", dataclasses.replace(page.view, **changes))
    return Here(page, PlanState())


def shown(here: Here[PlanState]) -> list[Any]:
    here.snapshot, here.view = here.page.session.snapshot, here.page.view
    found = flat(plan_step(here))
    return [*found, *(one for fold in found if isinstance(fold, Fold) for one in flat(fold.elements))]


def inputs(here: Here[PlanState]) -> dict[str, Any]:
    return {one.label: one for one in shown(here) if isinstance(one, Input | Button)}


def text(here: Here[PlanState]) -> str:
    return " ".join(str(one.content) for one in shown(here) if isinstance(one, Html))


FIELDS = (
    *("Name", "Lot", "Wafer id", "Product", "Operator", "Size, mm", "Columns, rows", "Overlap, %", "Centre, µm"),
    *("From, to, µm", "Step, µm", "Below, above focus, µm", "Exposures, µs", "Frames on disk"),
)


def test_plan_has_every_field_once_in_the_order_of_work():
    found = [one.label for one in shown(here_of(fake.planned())) if isinstance(one, Input)]
    assert found == list(FIELDS)


def test_every_input_has_a_hint_and_waits_for_a_rest_in_typing():
    fields = [one for one in shown(here_of(fake.planned())) if isinstance(one, Input)]
    assert all(one.hint and one.pause_s and one.commands for one in fields)


def test_before_a_plan_only_the_sample_can_be_described():
    here = here_of(fake.empty())
    assert labels(plan_step(here))[:6] == list(FIELDS[:6])
    assert "Columns, rows" not in inputs(here)
    assert "Not yet: the sample has no size." in text(here)
    assert "Use the sample on the stage" in text(here)
    assert inputs(here)["Start scan"].disabled


def test_away_from_the_step_nothing_is_shown():
    assert plan_step(here_of(fake.planned(), live=True)) is None
    here = here_of(fake.planned())
    here.view = View(step="surface")
    assert plan_step(here) is None


def test_released_job_has_all_fixed_but_the_names_of_the_wafer():
    here = here_of(day.aligned(), everything=True)
    fixed = {label for label, one in inputs(here).items() if one.disabled}
    assert set(FIELDS) - fixed == {"Name", "Lot", "Wafer id", "Operator"}
    assert {"Cover the sample", "Move to stage", "Find the exposure"} <= fixed
    assert "Copy to a new plan" in inputs(here)
    assert "Release…" not in inputs(here)
    operator = inputs(here_of(day.aligned()))
    assert list(operator) == ["Wafer id", "Lot", "Operator", "Start scan"]


def test_what_an_engineer_prepares_needs_that_role():
    made = inputs(here_of(fake.planned()))
    free = {"Name", "Lot", "Wafer id", "Operator", "Load plan…", "Start scan"}
    assert {label for label, one in made.items() if one.action is None} == free


def test_values_that_are_on_their_way_are_shown_and_none_is_lost():
    here = here_of(fake.planned())
    session: Any = here.page.session
    made = inputs(here)
    made["Columns, rows"].put((2.0, 1.0))
    made["Lot"].put("L9")
    assert (inputs(here)["Columns, rows"].value, inputs(here)["Lot"].value) == ((2.0, 1.0), "L9")
    session.arrive()
    job = session.snapshot.draft.job
    assert (job.grid.cols, job.grid.rows, job.sample.lot) == (2, 1, "L9")
    assert here.own.entered == {}


def test_what_makes_no_plan_stays_as_typed_with_the_reason_until_it_does():
    here = here_of(fake.planned())
    session: Any = here.page.session
    job = session.snapshot.draft.job
    inputs(here)["Exposures, µs"].put("quick")
    session.arrive()
    assert session.snapshot.draft.job == job
    assert inputs(here)["Exposures, µs"].value == "quick"
    assert "Not yet: The exposures read &#39;quick&#39;" in text(here)
    inputs(here)["Lot"].put("L9")
    session.arrive()
    inputs(here)["Exposures, µs"].put("100, 400")
    session.arrive()
    made = session.snapshot.draft
    assert (made.job.exposures_us, made.job.sample.lot, made.typed) == ((100.0, 400.0), "L9", None)


def test_finer_step_restores_the_range_that_was_typed():
    here = here_of(fake.planned())
    session: Any = here.page.session
    for label, value in (("From, to, µm", (0.0, 59.0)), ("Step, µm", 5.0), ("Step, µm", 1.0)):
        inputs(here)[label].put(value)
        session.arrive()
    assert session.snapshot.draft.job.sweep.n_frames == 60
    assert inputs(here)["From, to, µm"].value == (0.0, 59.0)


def test_coarse_step_is_warned_of():
    now = fake.planned()
    assert "The step is coarse" not in text(here_of(now))
    coarse = replace(now.draft.job, sweep=replace(now.draft.job.sweep, z_step_um=6.0))
    now = dataclasses.replace(now, draft=dataclasses.replace(now.draft, job=coarse))
    assert "over half the depth of field" in text(here_of(now))


def test_full_disk_forbids_the_start_and_says_so():
    now = day.aligned()
    here = here_of(dataclasses.replace(now, draft=dataclasses.replace(now.draft, free_bytes=1_000_000)))
    assert "1.0 MB free. <b>Free some space" in text(here).replace("\u202f", " ")
    assert inputs(here)["Start scan"].disabled


def test_corner_is_not_marked_where_a_lost_stage_was_last_seen():
    now = day.released(day.a_released_job("W07"))
    lost = dataclasses.replace(now.rig, state="absent", message="The stage does not answer.")
    found = inputs(here_of(dataclasses.replace(now, rig=lost)))
    assert (found["Go there"].disabled, found["Mark here"].disabled) == (False, True)
    assert not inputs(here_of(now))["Mark here"].disabled


def test_scan_starts_at_once_if_nothing_needs_attention():
    here = here_of(fake.planned())
    assert why_not_start(here, here.snapshot) is None
    start(here)
    assert here.page.session.asked == ["start_scan"]


def test_every_link_of_the_step_has_its_command():
    import re

    states = (fake.planned(), fake.empty(), day.tried(), day.waiting(), day.aligned())
    picked = {pick for now in states for pick in re.findall('data-pick="([^"]+)"', text(here_of(now)))}
    assert {"strategy", "undo", "cover", "feature", "no-feature", "corner", "unmark", "jobs"} <= picked
    assert picked <= set(PICKS)


def test_feature_keeps_its_regions_and_an_impossible_one_is_refused():
    old = day.tried().draft.job.features[0]
    form = FeatureForm.of(old)
    assert feature_of(form, old.places, "unnamed") == old
    assert feature_of(replace(form, name=" "), old.places, "Step 3").name == "Step 3"
    with pytest.raises(PlanError, match="over the lower limit"):
        feature_of(replace(form, lower_limit="31", upper_limit="29"), old.places, "")
    places = (Region.rectangle(0, 0, 10, 20), Region.rectangle(30, 0, 40, 20))
    assert FeatureForm.of(replace(old, places=places)).corners[2:] == ((30.0, 0.0), (40.0, 20.0))


@pytest.fixture
def dialogs(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Dialogs that were opened: what they hold, what their button does, and their inputs."""
    opened: list[Any] = []

    def open_dialog(
        page: Any, _title: str, _below: str, answer: Any, own: Any, contents: Any = dialog_module.fields_of
    ) -> None:
        here: Any = Here(page, own)
        opened.append((here, lambda: answer.act(here), lambda: contents(here)))

    monkeypatch.setattr(job_dialogs, "Dialog", open_dialog)
    return opened


def within(dialog: Any) -> dict[str, Any]:
    return {one.label: one for one in flat(dialog[2]()) if isinstance(one, Input)}


def test_dies_are_given_as_a_lattice_and_kept_where_fields_are(dialogs: list[Any]):
    here = here_of(fake.planned())
    job_dialogs.dies_dialog(here.page)
    (dialog,) = dialogs
    assert list(within(dialog)) == ["Pitch, µm", "Die, µm", "First die, µm", "Across, up"]
    assert within(dialog)["Across, up"].least == 1
    with pytest.raises(PlanError, match="type at least one of them"):
        dialog[1]()
    for label, value in (("Die, µm", "100 × 80"), ("First die, µm", (150.0, -140.0)), ("Across, up", (2.0, 1.0))):
        within(dialog)[label].put(value)
    with pytest.raises(PlanError, match="The pitch of the dies is not given"):
        dialog[1]()
    within(dialog)["Pitch, µm"].put("120 × 90")
    dialog[1]()
    here.page.session.arrive()
    dies = here.page.session.snapshot.draft.job.dies
    assert [(die.x_um, die.y_um) for die in dies.all()] == [(150.0, -140.0), (270.0, -140.0)]


def test_corners_to_align_by_are_kept_and_the_old_alignment_goes(dialogs: list[Any]):
    here = here_of(fake.planned())
    job_dialogs.corners_dialog(here.page)
    (dialog,) = dialogs
    made = within(dialog)
    assert list(made) == ["Corner 1", "x, y, µm", "Corner 2", "Limit, µm"], "labels repeat"
    made["Corner 2"].put(" right ")
    made["x, y, µm"].put((7.0, 8.0))
    made["Limit, µm"].put(12.0)
    dialog[1]()
    here.page.session.arrive()
    marks = here.page.session.snapshot.draft.job.marks
    assert (marks.limit_um, marks.places[1].name, (marks.places[1].x_um, marks.places[1].y_um)) == (
        12.0,
        "right",
        (7, 8),
    )


def test_release_needs_a_product_and_a_revision(dialogs: list[Any]):
    here = here_of(fake.planned())
    job_dialogs.release_dialog(here.page)
    (dialog,) = dialogs
    assert list(within(dialog)) == ["Product", "Revision", "Reason"]
    with pytest.raises(PlanError, match="both need a name"):
        dialog[1]()
    within(dialog)["Product"].put("coupon ")
    within(dialog)["Revision"].put("A")
    dialog[1]()
    here.page.session.arrive()
    job = here.page.session.snapshot.draft.job
    assert (job.product, job.revision) == ("coupon", "A")


def test_feature_takes_tool_regions_and_value_of_a_kept_result(dialogs: list[Any]):
    now = dataclasses.replace(fake.measured(), draft=fake.planned().draft)
    here = here_of(now)
    job_dialogs.feature_dialog(here.page)
    (dialog,) = dialogs
    source = within(dialog)["Measured as"]
    source.put(next(name for name in source.options if "Step" in name or "drop" in name))
    made = within(dialog)
    assert float(made["Nominal, µm"].value) > 0
    assert len(made["Quantity"].options) > 1
    made["Upper limit"].put("90")
    dialog[1]()
    here.page.session.arrive()
    (feature,) = here.page.session.snapshot.draft.job.features
    assert (feature.upper_limit, feature.lower_limit, bool(feature.places)) == (90.0, None, True)
    made["Upper limit"].put("9o")
    with pytest.raises(WaferViewerError, match="Upper limit: '9o' is not a number"):
        dialog[1]()


def test_value_is_entered_once_and_a_newer_one_waits_for_its_own_answer():
    here = here_of(fake.planned())
    session: Any = here.page.session
    enter(here, "sample.lot", "L1")
    enter(here, "sample.lot", "L12")
    (first, _), _ = session.edits
    first.set_result(None)
    assert here.own.entered == {"sample.lot": "L12"}
