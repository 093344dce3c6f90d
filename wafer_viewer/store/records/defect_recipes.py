"""Defect recipes by product: ``recipes/PRODUCT-NAME.defects.toml`` in the folder of the datasets."""

from __future__ import annotations

import re
from pathlib import Path

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors, remove, write_text

FOLDER, ENDING = "recipes", ".defects.toml"


def read_defect_recipe(path: str | Path) -> DefectRecipe:
    """Read a defect recipe from a file.

    Parameters
    ----------
    path : str or Path
        TOML file with the fields of `DefectRecipe`.

    Returns
    -------
    DefectRecipe
        Settings of the defect inspection; fields that are not in the file have their default values.

    Raises
    ------
    DatasetError
        When the file cannot be read.
    MeasureError
        When it is no valid TOML, or has an unknown or invalid field.
    """
    place = Path(path)
    try:
        return decode(place.read_bytes(), DefectRecipe, place.name)
    except OSError as fault:
        raise DatasetError(f"{place} cannot be read: {(fault.strerror or str(fault)).lower()}.") from fault


def save_defect_recipe(folder: Path, recipe: DefectRecipe) -> Path:
    """Save a defect recipe under its product and name.

    An earlier version of the recipe is replaced.

    Parameters
    ----------
    folder : Path
        Folder of the datasets.
    recipe : DefectRecipe
        Recipe to save; its product and its name must not be empty.

    Returns
    -------
    Path
        The file written, ``recipes/PRODUCT-NAME.defects.toml`` in `folder`. Characters other than letters, digits and
        ``_ . + -`` become hyphens in its name.

    Raises
    ------
    DatasetError
        When product or name is empty, the file belongs to another recipe, or it cannot be written.
    MeasureError
        When a file of that name exists and is no valid recipe.
    """
    path = _place(folder, recipe.product, recipe.name)
    with os_errors_as_dataset_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, encode(recipe))
    return path


def rename_defect_recipe(folder: Path, recipe: DefectRecipe, name: str) -> Path:
    """Rename a saved recipe. Raises DatasetError when it does not exist, or the name is taken."""
    old, new = _kept(folder, recipe), _place(folder, recipe.product, name)
    if new.exists():
        raise DatasetError(f"There is a recipe '{name}' of {recipe.product} already: choose another name.")
    save_defect_recipe(folder, replace(read_defect_recipe(old), name=name))
    remove(old)
    return new


def delete_defect_recipe(folder: Path, recipe: DefectRecipe) -> None:
    """Delete a saved recipe. Raises DatasetError when it does not exist or cannot be deleted."""
    path = _kept(folder, recipe)
    with os_errors_as_dataset_errors(path):
        path.unlink()


def defect_recipes(folder: Path, product: str = "") -> tuple[DefectRecipe, ...]:
    """Return the saved recipes, optionally of one product, by product and name; damaged ones raise."""
    read = (read_defect_recipe(path) for path in _files(folder))
    return tuple(recipe for recipe in read if not product or recipe.product == product)


def readable_recipes(folder: Path) -> tuple[tuple[DefectRecipe, ...], tuple[str, ...]]:
    """Return the readable recipes, most recently saved first, and one sentence per unreadable file."""
    recipes: list[DefectRecipe] = []
    problems: list[str] = []
    for path in sorted(_files(folder), key=lambda path: -path.stat().st_mtime_ns):
        try:
            recipes.append(read_defect_recipe(path))
        except WaferViewerError as fault:
            problems.append(str(fault))
    return tuple(recipes), tuple(problems)


def _files(folder: Path) -> list[Path]:
    return sorted((folder / FOLDER).glob(f"*{ENDING}"))


def _place(folder: Path, product: str, name: str) -> Path:
    """Return the path of a recipe. Raises DatasetError for an empty name, or if another recipe has the same file."""
    if not product.strip() or not name.strip():
        raise DatasetError("A defect recipe is kept under a product and a name: give both.")
    path = folder / FOLDER / f"{_plain(product)}-{_plain(name)}{ENDING}"
    if path.exists():
        there = read_defect_recipe(path)
        if (there.product, there.name) != (product, name):
            raise DatasetError(f"{path.name} is the recipe '{there.name}' of {there.product}: choose another name.")
    return path


def _kept(folder: Path, recipe: DefectRecipe) -> Path:
    path = _place(folder, recipe.product, recipe.name)
    if not path.exists():
        raise DatasetError(f"There is no recipe '{recipe.name}' of {recipe.product} any more: choose one of the list.")
    return path


def _plain(name: str) -> str:
    """Return a name reduced to valid characters of a file name."""
    return re.sub(r"[^\w.+-]+", "-", name.strip())
