"""Recipes that go by a name are complete, and the one in assets is the one of that name."""

from __future__ import annotations

import pytest

import wafer_viewer as wv
from tests.support.paths import ASSETS
from wafer_viewer.cli.parser import recipe_file
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import decode
from wafer_viewer.model.surface.recipe import READY_RECIPES, Recipe

PAPER = ASSETS / "recipes" / "paper.toml"


def test_the_paper_s_recipe_in_assets_is_the_one_that_goes_by_its_name() -> None:
    assert decode(PAPER.read_bytes(), Recipe, PAPER.name) == Recipe.paper() == READY_RECIPES["paper"]


def test_the_paper_s_recipe_leaves_nothing_of_the_cleaning_to_the_data() -> None:
    assert "auto" not in repr(Recipe.paper().levy) + repr(Recipe.paper().outliers) + repr(Recipe.paper().fill)
    assert wv.Recipe.paper().levy.mode == "literal"


@pytest.mark.parametrize(
    "argv", [["a.tif", "--recipe", "paper", "-o", "b.npz"], ["a.tif", "--recipe=paper", "-o", "b.npz"]]
)
def test_a_recipe_is_taken_by_name_or_file(argv: list[str]) -> None:
    named = recipe_file(argv)
    assert named == (Recipe.paper(), ["a.tif", "-o", "b.npz"])
    assert (
        recipe_file([str(PAPER) if word == "paper" else word.replace("=paper", f"={PAPER}") for word in argv]) == named
    )


def test_an_unknown_name_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(
        PlanError, match=r"papr cannot be read, it does not exist: check the path, or take a ready one: default, paper"
    ):
        recipe_file(["--recipe", "papr"])
