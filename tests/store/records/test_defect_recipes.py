"""Recipes for defects are kept by product; a field that is not known is told."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe
from wafer_viewer.model.inspection.defect_classes import ClassRules
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.store.records.inspection_records import (
    delete_defect_recipe,
    read_defect_recipe,
    readable_recipes,
    rename_defect_recipe,
    save_defect_recipe,
)


def test_a_recipe_is_read_as_it_was_kept(tmp_path: Path):
    areas = (Region.rectangle(1.0, 2.0, 3.5, 4.0), Region.polygon((0.0, 0.0), (9.0, 0.0), (0.0, 9.0)))
    rules = ClassRules(scratch_ratio=6.0)
    recipe = DefectRecipe(product="LX 7/b", name="keen", sensitivity=0.7, excluded=areas, rules=rules)
    path = save_defect_recipe(tmp_path, recipe)
    assert path == tmp_path / "recipes" / "LX-7-b-keen.defects.toml"
    assert read_defect_recipe(path) == recipe
    save_defect_recipe(tmp_path, other := DefectRecipe(product="LX-8"))
    kept, problems = readable_recipes(tmp_path)
    assert (set(kept), len(kept), problems) == ({recipe, other}, 2, ())


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sensitvity = 0.5", "unknown key 'sensitvity'"),
        ("sensitivity = 1.5", "sensitivity is 1.5: it must be between 0 and 1"),
        ("[rules]\nscratch = 3", "unknown key 'scratch'"),
        ("sensitivity = ", r"r\.toml: "),
    ],
)
def test_errors_are_reported(tmp_path: Path, text: str, says: str):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(MeasureError, match=says):
        read_defect_recipe(path)


def test_one_without_a_product_or_a_file_is_refused(tmp_path: Path):
    with pytest.raises(DatasetError, match="under a product and a name"):
        save_defect_recipe(tmp_path, DefectRecipe())
    with pytest.raises(DatasetError, match="cannot be read"):
        read_defect_recipe(tmp_path / "gone.toml")


def test_the_recipe_saved_last_comes_first_and_damaged_files_are_reported(tmp_path: Path):
    for n, name in enumerate(("standard", "keen", "dull")):
        path = save_defect_recipe(tmp_path, DefectRecipe(product="LX-7", name=name))
        os.utime(path, ns=(n, n))
    (tmp_path / "recipes" / "LX-8-old.defects.toml").write_text("sensitvity = 0.5")
    recipes, problems = readable_recipes(tmp_path)
    assert [recipe.name for recipe in recipes] == ["dull", "keen", "standard"]
    assert len(problems) == 1
    assert problems[0].startswith("LX-8-old.defects.toml: ")
    assert "unknown key 'sensitvity'" in problems[0]


def test_a_recipe_gets_another_name_or_goes(tmp_path: Path):
    keen = DefectRecipe(product="LX-7", name="keen", sensitivity=0.7, limits=DefectLimits(max_per_die=2))
    save_defect_recipe(tmp_path, keen)
    save_defect_recipe(tmp_path, DefectRecipe(product="LX-7"))
    with pytest.raises(DatasetError, match="a recipe 'standard' of LX-7 already"):
        rename_defect_recipe(tmp_path, keen, "standard")
    rename_defect_recipe(tmp_path, keen, "night shift")
    night = replace(keen, name="night shift")
    kept, problems = readable_recipes(tmp_path)
    assert (set(kept), problems) == ({night, DefectRecipe(product="LX-7")}, ())
    with pytest.raises(DatasetError, match="no recipe 'keen' of LX-7 any more"):
        rename_defect_recipe(tmp_path, keen, "dull")
    delete_defect_recipe(tmp_path, night)
    assert readable_recipes(tmp_path) == ((DefectRecipe(product="LX-7"),), ())
    with pytest.raises(DatasetError, match="any more: choose one of the list"):
        delete_defect_recipe(tmp_path, night)


def test_names_that_come_to_one_file_do_not_write_over_each_other(tmp_path: Path):
    save_defect_recipe(tmp_path, DefectRecipe(product="LX 7"))
    with pytest.raises(DatasetError, match="is the recipe 'standard' of LX 7: choose another name"):
        save_defect_recipe(tmp_path, DefectRecipe(product="LX/7"))


def test_a_full_disk_is_reported_and_nothing_is_left_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(DatasetError, match="the disk is full: free some space"):
        save_defect_recipe(tmp_path, DefectRecipe(product="LX-7"))
    assert list((tmp_path / "recipes").iterdir()) == []


def test_a_folder_that_cannot_be_written_is_reported(tmp_path: Path):
    (tmp_path / "recipes").write_text("a file")
    with pytest.raises(DatasetError, match=r"cannot be written: .*choose another"):
        save_defect_recipe(tmp_path, DefectRecipe(product="LX-7"))
