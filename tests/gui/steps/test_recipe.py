"""What the Surface step says of the recipe: in one line, what the data chose, and what was noted."""

from __future__ import annotations

import dataclasses
import typing

import msgspec
import pytest

from tests.browser.sessions import fake_session as fake
from tests.gui.tools.test_clip_box import FACTS
from wafer_viewer.draw.quantities import recipe_rows
from wafer_viewer.gui.steps.surface import reconstruction as words
from wafer_viewer.model.spec import Spec, replace, settings_of
from wafer_viewer.model.surface.recipe import LEAST_PROBABILITY, READY_RECIPES, Levy, Recipe, Window


@pytest.mark.parametrize("path", settings_of(Recipe))
def test_every_choice_of_the_recipe_has_a_title(path):
    field = settings_of(Recipe)[path]
    choices = [choice for kind in parts_of(field.kind) for choice in typing.get_args(kind)]
    assert not choices or set(choices) <= {"auto", *field.setting.titles}


def parts_of(kind):
    return typing.get_args(kind) if typing.get_origin(kind) is typing.Union else (kind,)


def test_every_setting_of_the_recipe_has_a_title():
    assert sorted(settings_of(Recipe)) == sorted(paths_of(Recipe()))
    assert len({field.setting.title for field in settings_of(Recipe).values()}) == len(settings_of(Recipe))


def paths_of(spec, before=""):
    for name in spec.__struct_fields__:
        value = getattr(spec, name)
        yield from paths_of(value, f"{before}{name}.") if isinstance(value, Spec) else [f"{before}{name}"]


def test_every_window_has_a_title():
    limit = typing.get_args(Window)[1]
    titles = settings_of(Recipe)["window"].setting.titles
    assert [n for n in range(30) if n in limit] == [n for n in titles if n != "auto"]


def test_ready_recipes_go_by_their_names_and_others_are_ones_own():
    assert {words.ready_name(recipe) for recipe in READY_RECIPES.values()} == set(words.READY)
    assert words.ready_name(replace(Recipe(), window=11)) == words.OWN


def test_one_line_says_how():
    assert words.summary(fake.SETTLED) == "Log-Laplacian · window 9\u202fpx · Centred"
    assert words.summary(Recipe()) == "Log-Laplacian · window from the data · Centred"


def test_only_what_was_left_to_the_data_is_told_as_chosen_by_them():
    chosen = dict(recipe_rows(fake.SETTLED, Recipe()))
    assert chosen["Window"] == "9\u202fpx"
    assert chosen["Width of a focus curve"] == "7.6\u202fµm"
    assert chosen["Confidence from"] == "0.24"
    assert chosen["Camera noise, gain"] == "0.0213\u202fcounts"
    assert "Scale of the Lévy flights" not in chosen
    by_hand = dict(recipe_rows(fake.SETTLED, replace(Recipe(), window=9, levy=Levy(mode="none"))))
    assert "Window" not in by_hand
    assert recipe_rows(fake.SETTLED, fake.SETTLED) == []
    assert recipe_rows(Recipe(), Recipe()) == []


@pytest.mark.parametrize(("mode", "said"), [("literal", "0.5\u202fµm"), ("guided", "0.5\u202f× distance to the guide")])
def test_flights_are_told_where_there_are_any(mode, said):
    requested = replace(Recipe(), levy=Levy(mode=mode))
    settled = replace(fake.SETTLED, levy=Levy(mode=mode, n_sigma=3.0, alpha=0.5, iterations=30))
    assert dict(recipe_rows(settled, requested))["Scale of the Lévy flights"] == said


def test_only_the_papers_method_believes_every_peak():
    assert [words.accepts_all_peaks(READY_RECIPES[key]) for key in ("default", "paper")] == [False, True]


def test_the_least_probability_says_what_it_keeps_and_how_much_of_that_is_false():
    facts = msgspec.structs.replace(FACTS, by_probability=(*[0] * 50, 20, *[0] * 44, 20, *[0] * 3, 60))
    assert words.expected(facts, 0.9).endswith(
        ">Keeps 80.0\u202f% of the ground, 1.5\u202f% of that expected to be false.</div>"
    )
    assert "Keeps 100.0\u202f%" in words.expected(facts, 0.5)
    assert not words.expected(FACTS, 0.9), "nothing is told of heights without a probability"
    assert not words.expected(facts, 0.0)


def test_the_least_probability_of_auto_is_that_of_the_surface():
    info = fake.measured().surface
    assert info is not None
    settled = replace(Recipe(), least_probability=0.8)
    assert words.least_probability(Recipe(), None) == LEAST_PROBABILITY
    assert words.least_probability(Recipe(), dataclasses.replace(info, settled=settled)) == 0.8
    assert words.least_probability(replace(Recipe(), least_probability=0.5), info) == 0.5


def test_notes_that_differ_by_numbers_alone_are_told_once_and_unfold():
    text = words.notes(fake.NOTES)
    assert text.count("<details>") == 2
    assert "2 more like it" in text
    assert "1 of 60 frames of field 3 are missing." in text
    assert "longer ones × 3.98, × 15.8 as bright" in text
    assert "1.45 µm" in text
    assert words.notes(()) == ""


def test_a_note_does_not_become_markup():
    assert "<b>" not in words.notes(["<b>", "<b>"])
