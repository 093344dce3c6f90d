"""Planted defects and the counting of what was found, against their own word."""

from __future__ import annotations

import numpy as np
import pytest

from tests.truth.matching import Rate, capture, false_limit_per_mm2, match, plain
from tests.truth.patterned import scene_of
from tests.truth.planted import DIE_UM, GEOMETRIC, PITCH_UM, Plan, Planted, die_errors, planted
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region

PARTICLE = Planted("particle", 50.0, 40.0, (0, 0), 20, 6, 10.0, 10.0, 1.0)
SCRATCH = Planted("scratch", 200.0, 40.0, (1, 0), 20, 6, 40.0, 2.0, -1.0, 0.5)


def found(x_um: float, y_um: float, size_um: float = 6.0) -> Defect:
    half = size_um / 2
    return Defect(
        center=Point(x_um=x_um, y_um=y_um),
        outline=Region.rectangle(x_um - half, y_um - half, x_um + half, y_um + half),
        kind="particle",
        major=Length(value_um=size_um),
        minor=Length(value_um=size_um),
        height=Length(value_um=1.0),
        area=Quantity(value=1.0, unit="um2"),
        volume=Quantity(value=1.0, unit="um3"),
        score=9.0,
    )


def test_each_planted_defect_takes_the_nearest_found_one_and_the_rest_are_parts_or_false():
    matched = match((PARTICLE, SCRATCH), [found(51, 41), found(54, 40), found(202, 41), found(300, 200)])
    assert [(one.kind, other.center.x_um) for one, other in matched.pairs] == [("particle", 51), ("scratch", 202)]
    assert [d.center.x_um for d in matched.parts] == [54]
    assert [d.center.x_um for d in matched.false] == [300]
    assert not matched.missed


def test_a_place_next_to_a_scratch_is_false_and_the_scratch_is_missed():
    matched = match((SCRATCH,), [found(200, 60)])
    assert (matched.missed, len(matched.false)) == ((SCRATCH,), 1)


def test_one_huge_region_does_not_catch_what_lies_in_it():
    assert match((PARTICLE,), [found(80, 60, 120)]).missed == (PARTICLE,)


def test_nothing_found_is_everything_missed():
    assert capture([match((PARTICLE, SCRATCH), [])], plain) == Rate(0, 2)


@pytest.mark.parametrize(("hits", "of", "low", "high"), [(95, 100, 0.887, 0.984), (0, 10, 0, 0.308), (9, 9, 0.664, 1)])
def test_limits_of_a_rate_are_those_of_the_tables(hits: int, of: int, low: float, high: float):
    assert (Rate(hits, of).low, Rate(hits, of).high) == pytest.approx((low, high), abs=1e-3)


def test_no_false_one_on_thirty_mm2_shows_a_tenth_a_mm2():
    assert false_limit_per_mm2(0, 30.0) == pytest.approx(0.1, abs=1e-3)


def test_every_seed_plants_other_defects_each_on_its_die():
    one, other = planted(Plan(seed=1), 0.2), planted(Plan(seed=2), 0.2)
    assert one != other
    assert one == planted(Plan(seed=1), 0.2)
    assert {defect.kind for defect in one} == {*GEOMETRIC, "missing die", "tilted die"}
    assert len({defect.die for defect in one}) == len(one)
    for defect in one:
        assert abs(defect.x_um - (defect.die[0] + 0.5) * PITCH_UM[0]) <= DIE_UM[0] / 2 + 1e-6
        assert abs(defect.y_um - (defect.die[1] + 0.5) * PITCH_UM[1]) <= DIE_UM[1] / 2 + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["particle", "pit", "residue", "edge chip"])
def test_the_true_surface_has_the_height_of_what_was_planted(kind: str):
    plan = Plan(seed=4, odd_dies=False)
    what = next(one for one in planted(plan, 0.2) if one.kind == kind and one.diameter_px >= 20)
    x_um, y_um = np.linspace([what.x_um, what.y_um], _middle_um(what), 41)[: 4 if kind == "edge chip" else 1].T
    with_it, without = (scene_of(plan, defects).truth(x_um, y_um) for defects in ((what,), ()))
    changed = with_it - without
    assert changed[np.abs(changed).argmax()] == pytest.approx(what.height_um, rel=0.05, abs=0.02)


def _middle_um(what: Planted) -> tuple[float, float]:
    return (what.die[0] + 0.5) * PITCH_UM[0], (what.die[1] + 0.5) * PITCH_UM[1]


def test_dies_lie_off_their_lattice_by_what_the_plan_says():
    off = die_errors(Plan(cols=40, rows=40, misplaced_px=0.5))[..., :2]
    assert off.std() == pytest.approx(0.5 * 0.46729, rel=0.05)
