"""Systematic defects: the same place of several dies, and nothing that chance brings together."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.datasets.inspections import GRID, defect, inspection
from wafer_viewer.measure.defects.defect_builder import repeated_places
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace

DIES = [GRID.name(*place) for place in GRID.places]


def at(places: list[tuple[float, float]], first: int = 1, dies: list[str] | None = None, **changes) -> list[Defect]:
    """A defect on each die, a little off the same place."""
    on = zip(dies or DIES, places, strict=False)
    made = [defect(first + k, die, *place) for k, (die, place) in enumerate(on)]
    return [replace(one, **changes) for one in made]


def test_a_place_that_several_dies_share_is_counted_with_its_defects():
    off = np.random.default_rng(3).normal(0, 1.2, (5, 2))
    here = at([(300 + dx, 200 + dy) for dx, dy in off], kind="pattern")
    alone = [defect(20, DIES[0], 700, 500), defect(21, DIES[1], 701, 501)]
    (place,) = repeated_places(inspection(*alone, *here))
    assert sorted(place.numbers) == [1, 2, 3, 4, 5]
    assert (len(place.dies), place.of_dies, place.kind) == (5, 6, "pattern")
    assert (place.in_die.x_um, place.in_die.y_um) == pytest.approx((300, 200), abs=1.5)
    assert place.reach_um < 5
    assert place.words == "in 5 of 6 whole dies"


def test_the_place_in_most_dies_comes_first_and_no_defect_counts_twice():
    three, six = at([(100, 100)] * 3, 1), at([(500, 300)] * 6, 10)
    first, second = repeated_places(inspection(*three, *six))
    assert (len(first.dies), len(second.dies)) == (6, 3)
    assert not set(first.numbers) & set(second.numbers)


def test_many_defects_on_one_die_are_no_repetition():
    assert repeated_places(inspection(*at([(300, 200)] * 5, dies=[DIES[0]] * 5))) == ()
    assert repeated_places(inspection()) == ()


def test_what_people_rejected_areas_without_heights_and_the_street_do_not_count():
    for changes in ({"judgement": "nuisance"}, {"kind": "unmeasured"}, {"die": "", "in_die": None}):
        assert repeated_places(inspection(*at([(300, 200)] * 6, **changes))) == ()
    assert len(repeated_places(inspection(*at([(300, 200)] * 6, judgement="real")))) == 1


def test_how_near_is_near_can_be_given_and_else_grows_with_the_defects():
    apart = at([(300 + 18 * k, 200) for k in range(3)])
    assert repeated_places(inspection(*apart)) == ()
    assert len(repeated_places(inspection(*apart), within_um=20)) == 1
    long = at([(300 + 18 * k, 200) for k in range(3)], major=Length(value_um=40.0))
    assert len(repeated_places(inspection(*long))) == 1
    for wrong, text in (({"within_um": 0.0}, "within_um is 0"), ({"least_dies": 1}, "two dies at least")):
        with pytest.raises(MeasureError, match=text):
            repeated_places(inspection(*apart), **wrong)


def test_a_long_scratch_near_a_place_does_not_belong_to_it():
    scratch = replace(defect(20, DIES[5], 320, 200), major=Length(value_um=90.0))
    (place,) = repeated_places(inspection(scratch, *at([(300, 200)] * 4)))
    assert sorted(place.numbers) == [1, 2, 3, 4]


def test_thousands_by_chance_make_few_places_and_planted_ones_are_found_among_them():
    rng = np.random.default_rng(5)
    noise = [defect(100 + k, DIES[k % 6], float(rng.uniform(0, 950)), float(rng.uniform(0, 760))) for k in range(600)]
    planted = at([(400 + dx, 400 + dy) for dx, dy in rng.normal(0, 0.8, (6, 2))], 1)
    found = repeated_places(inspection(*noise, *planted), within_um=5.0)
    assert set(range(1, 7)) <= set(found[0].numbers)
    assert len(found[0].dies) == 6
    assert sum(len(place.dies) >= 4 for place in found) == 1


def scattered(rng: np.random.Generator, n: int) -> list[Defect]:
    """Defects at uniform places, as many on each die."""
    places = rng.uniform((0, 0), (GRID.width_um, GRID.height_um), (n, 2))
    return [defect(100 + k, DIES[k % 6], float(x), float(y)) for k, (x, y) in enumerate(places)]


def test_probability_of_chance_is_that_of_a_binomial_for_each_defect():
    (place,) = repeated_places(inspection(*at([(300, 200)] * 3)), within_um=10.0)
    p = np.pi * 100 / (GRID.width_um * GRID.height_um)
    assert place.by_chance == pytest.approx(3 * p**2, rel=1e-9)
    assert place.chance_words == "by chance <0.1 %"


@pytest.mark.campaign
def test_probability_of_chance_bounds_the_rate_on_random_maps():
    maps = [repeated_places(inspection(*scattered(np.random.default_rng(seed), 90)), 14.0) for seed in range(300)]
    threes = {place.by_chance for places in maps for place in places if len(place.dies) == 3}
    (stated,) = {round(chance, 9) for chance in threes}
    rate = np.mean([len(places) > 0 for places in maps])
    assert stated / 4 < rate <= stated


def test_planted_place_is_beyond_chance_and_random_ones_are_not():
    noise = scattered(np.random.default_rng(5), 600)
    first, *others = repeated_places(inspection(*noise, *at([(400, 400)] * 6)), within_um=8.0)
    assert first.by_chance < 0.01
    threes = [place.by_chance for place in others if len(place.dies) == 3]
    assert threes
    assert min(threes) > 0.5
