"""How defects are looked for, kept by product: ``recipes/PRODUCT-NAME.defects.toml`` beside the datasets."""

from __future__ import annotations

import re
from pathlib import Path

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.store.io.atomic_files import remove, write_text, writing

FOLDER, ENDING = "recipes", ".defects.toml"


def read_defect_recipe(path: str | Path) -> DefectRecipe:
    """Read a recipe. Raises DatasetError when there is none, MeasureError when a field is unknown or out of limits."""
    place = Path(path)
    try:
        return decode(place.read_bytes(), DefectRecipe, place.name)
    except OSError as fault:
        raise DatasetError(f"{place} cannot be read: {(fault.strerror or str(fault)).lower()}.") from fault


def save_defect_recipe(folder: Path, recipe: DefectRecipe) -> Path:
    """Keep a recipe under its product and name, in place of the one before; `folder` is that of the datasets.

    Raises DatasetError where it has no product or no name, the file is another recipe's, or cannot be written.
    """
    path = _place(folder, recipe.product, recipe.name)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, encode(recipe))
    return path


def rename_defect_recipe(folder: Path, recipe: DefectRecipe, name: str) -> Path:
    """Give a kept recipe another name. Raises DatasetError where there is none, or the name is taken."""
    old, new = _kept(folder, recipe), _place(folder, recipe.product, name)
    if new.exists():
        raise DatasetError(f"There is a recipe '{name}' of {recipe.product} already: choose another name.")
    save_defect_recipe(folder, replace(read_defect_recipe(old), name=name))
    remove(old)
    return new


def delete_defect_recipe(folder: Path, recipe: DefectRecipe) -> None:
    """Remove a kept recipe. Raises DatasetError where there is none, or it cannot be removed."""
    path = _kept(folder, recipe)
    with writing(path):
        path.unlink()


def defect_recipes(folder: Path, product: str = "") -> tuple[DefectRecipe, ...]:
    """The recipes beside the datasets, of one product where it is named, by product and name; damaged ones raise."""
    read = (read_defect_recipe(path) for path in _files(folder))
    return tuple(recipe for recipe in read if not product or recipe.product == product)


def readable_recipes(folder: Path) -> tuple[tuple[DefectRecipe, ...], tuple[str, ...]]:
    """The recipes beside the datasets, saved last first; and a sentence for each file that cannot be read as one."""
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
    """Where a recipe is kept. Raises DatasetError where it has no name, or that of another comes to the same file."""
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
    """What a file may be called."""
    return re.sub(r"[^\w.+-]+", "-", name.strip())
