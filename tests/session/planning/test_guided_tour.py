"""The tour on the true session: its wafer, and what Inspect finds on it with nothing changed on the page."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from wafer_viewer.gui.steps.review.defect_form import DefectForm, against_of, dies_of, form_of, recipe_of
from wafer_viewer.model.inspection.defect import Defect, DefectRecipe
from wafer_viewer.model.region import Region
from wafer_viewer.rigs.virtual.scenes.tour_wafer import DEPTH_UM, DROP_HEIGHT_UM, Planted, planted, scratch_middle

pytestmark = pytest.mark.campaign(together=True)
NEAR_UM = 6.0


@pytest.fixture(scope="module")
def inspection(session, surfaced, patience_s):
    """As a person gets it: take the tour, wait for the surface, press Inspect."""
    session.take_tour().result(patience_s)
    session.start_scan().result(patience_s)
    session.wait_until(surfaced, 2 * patience_s)
    recipe = DefectRecipe(product=session.snapshot.dataset.job.sample.product)
    form: DefectForm = form_of(recipe, None)
    command = session.defects.inspect(recipe_of(form, recipe), dies_of(form), against_of(form))
    return command.result(2 * patience_s)


def near(found: tuple[Defect, ...], one: Planted) -> list[Defect]:
    """What was found of a planted defect: of a scratch, its parts on each die."""
    if one.kind == "scratch":
        return [d for d in found if _along(d.center.x_um, d.center.y_um, one)]
    return [d for d in found if math.hypot(d.center.x_um - one.x_um, d.center.y_um - one.y_um) <= NEAR_UM]


def _along(x_um: float, y_um: float, scratch: Planted) -> bool:
    """Whether a place lies on the bent line of the scratch."""
    return abs(x_um - scratch.x_um) <= scratch.length_um / 2 and abs(y_um - scratch_middle(x_um)) <= NEAR_UM


def test_the_rig_carries_the_sample_of_the_tour_until_another_plan_is_taken_up(session, inspection, patience_s):
    title = session.snapshot.overview.title
    assert title.startswith("A small diced wafer")
    own = session.snapshot.draft.job
    session.load_plan(Path("assets/jobs/demonstration-wafer-A.toml")).result(patience_s)
    session.wait_until(lambda now: now.overview.title != title, patience_s)
    session.edit_job(own).result(patience_s)
    session.wait_until(lambda now: now.overview.title == title, patience_s)


def test_nine_dies_lie_whole_and_no_sliver_is_a_die(inspection):
    assert inspection.reference == "dies"
    assert [die.state for die in inspection.dies] == ["whole"] * 9
    assert inspection.grid.pitch_x_um == pytest.approx(302.0, abs=0.3)
    assert inspection.grid.pitch_y_um == pytest.approx(231.0, abs=0.3)


@pytest.mark.parametrize("one", planted(), ids=lambda one: f"{one.kind} {one.x_um:.0f} {one.y_um:.0f}")
def test_each_planted_defect_is_found_and_classed(inspection, one):
    found = near(inspection.defects, one)
    assert found
    assert {defect.kind for defect in found} == {one.kind}
    if one.kind == "particle":
        (particle,) = found
        assert particle.major.value_um == pytest.approx(one.length_um, rel=0.5)  # the focus window widens it
        assert 0 < particle.height.value_um <= 1.1 * one.height_um


def test_the_drop_is_as_high_as_it_is_within_its_uncertainty_and_the_focus_step(inspection):
    (drop,) = near(inspection.defects, planted()[0])
    assert drop.height.expanded_um is not None
    assert drop.height.value_um == pytest.approx(DROP_HEIGHT_UM, abs=0.5)


def test_the_scratch_is_found_on_both_dies_and_lower_than_they_are(inspection):
    scratch = planted()[1]
    parts = near(inspection.defects, scratch)
    assert len({part.die for part in parts}) == 2
    assert sum(part.major.value_um for part in parts) > 0.7 * scratch.length_um
    assert all(part.height.value_um < 0 for part in parts)


def test_hardly_anything_else_is_found(inspection):
    true = [defect for one in planted() for defect in near(inspection.defects, one)]
    assert len(inspection.defects) - len(true) <= 1


def test_a_die_stands_over_its_street(session, inspection):
    surface = session.mosaic()
    top = surface.window(Region.rectangle(-100.0, 50.0, 20.0, 60.0)).z_um
    street = surface.window(Region.rectangle(-40.0, 108.0, 40.0, 122.0)).z_um
    assert _median(top) - _median(street) == pytest.approx(DEPTH_UM, abs=1.0)


def _median(z_um) -> float:
    return float(np.nanmedian(z_um))
