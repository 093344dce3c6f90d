"""What the Surface step says of the recipe: in one line, what the data chose, and what was noted."""

from __future__ import annotations

import typing

import pytest

from tests.browser.sessions import fake_session as fake
from wafer_viewer.gui.steps.surface import reconstruction as words
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import READY_RECIPES, Fill, Levy, Outliers, Recipe, Window

CHOICES = [
    (Recipe, "drift", words.DRIFT),
    (Recipe, "focus_measure", words.FOCUS),
    (Recipe, "peak", words.PEAK),
    (Recipe, "edges", words.EDGES),
    (Levy, "mode", words.SMOOTHING),
    (Outliers, "mode", words.OUTLIERS),
    (Fill, "mode", words.FILL),
]


@pytest.mark.parametrize(("spec", "name", "names"), CHOICES)
def test_every_choice_of_the_recipe_has_a_name(spec, name, names):
    choices = typing.get_args(typing.get_type_hints(spec)[name])
    assert sorted(names.values()) == sorted(choices)


def test_every_window_has_a_name():
    limit = typing.get_args(Window)[1]
    assert [n for n in range(30) if n in limit] == [n for n in words.WINDOW.values() if n != "auto"]


def test_ready_recipes_go_by_their_names_and_others_are_ones_own():
    assert {words.ready_name(recipe) for recipe in READY_RECIPES.values()} == set(words.READY)
    assert words.ready_name(replace(Recipe(), window=11)) == words.OWN


def test_one_line_says_how():
    assert words.summary(fake.SETTLED) == "Log-Laplacian · window 9\u202fpx · Centred"
    assert words.summary(Recipe()) == "Log-Laplacian · window from the data · Centred"


def test_only_what_was_left_to_the_data_is_told_as_chosen_by_them():
    chosen = dict(words.chosen_by_data(Recipe(), fake.SETTLED))
    assert chosen["Window"] == "9\u202fpx"
    assert chosen["Width of a focus curve"] == "7.6\u202fµm"
    assert chosen["Confidence from"] == "0.24"
    assert chosen["Camera noise, gain"] == "0.021 counts"
    assert "Scale of the Lévy flights" not in chosen
    by_hand = dict(words.chosen_by_data(replace(Recipe(), window=9, levy=Levy(mode="none")), fake.SETTLED))
    assert "Window" not in by_hand
    assert words.chosen_by_data(fake.SETTLED, fake.SETTLED) == []
    assert words.chosen_by_data(Recipe(), Recipe()) == []


@pytest.mark.parametrize(("mode", "said"), [("literal", "0.50 µm"), ("guided", "0.50 × distance to the guide")])
def test_flights_are_told_where_there_are_any(mode, said):
    requested = replace(Recipe(), levy=Levy(mode=mode))
    settled = replace(fake.SETTLED, levy=Levy(mode=mode, n_sigma=3.0, alpha=0.5, iterations=30))
    assert dict(words.chosen_by_data(requested, settled))["Scale of the Lévy flights"] == said


def test_only_the_papers_method_believes_every_peak():
    assert [words.accepts_all_peaks(READY_RECIPES[key]) for key in ("default", "paper")] == [False, True]


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
