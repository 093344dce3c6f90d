"""Recipes for defects are kept by product; a field that is not known is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from wafer_viewer.model.class_rules import ClassRules
from wafer_viewer.model.defects import DefectRecipe
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.store.defect_recipes import defect_recipes, read_defect_recipe, save_defect_recipe


def test_a_recipe_is_read_as_it_was_kept(tmp_path: Path):
    recipe = DefectRecipe(product="LX 7/b", name="keen", sensitivity=0.7, rules=ClassRules(scratch_ratio=6.0))
    path = save_defect_recipe(tmp_path, recipe)
    assert path == tmp_path / "recipes" / "LX-7-b-keen.defects.toml"
    assert read_defect_recipe(path) == recipe
    save_defect_recipe(tmp_path, DefectRecipe(product="LX-8"))
    assert defect_recipes(tmp_path, "LX 7/b") == (recipe,)
    assert len(defect_recipes(tmp_path)) == 2


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sensitvity = 0.5", "unknown key 'sensitvity'"),
        ("sensitivity = 1.5", "sensitivity is 1.5: it must be between 0 and 1"),
        ("[rules]\nscratch = 3", "unknown key 'scratch'"),
        ("sensitivity = ", r"r\.toml: "),
    ],
)
def test_what_is_wrong_is_told(tmp_path: Path, text: str, says: str):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(MeasureError, match=says):
        read_defect_recipe(path)


def test_one_without_a_product_or_a_file_is_refused(tmp_path: Path):
    with pytest.raises(DatasetError, match="under a product and a name"):
        save_defect_recipe(tmp_path, DefectRecipe())
    with pytest.raises(DatasetError, match="cannot be read"):
        read_defect_recipe(tmp_path / "gone.toml")
