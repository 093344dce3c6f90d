"""How defects are looked for, kept by product: ``recipes/PRODUCT-NAME.defects.toml`` beside the datasets."""

from __future__ import annotations

import re
from pathlib import Path

from wafer_viewer.model.defects import DefectRecipe
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.spec import decode, encode
from wafer_viewer.store.files import write_text, writing

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

    Raises DatasetError where it has no product or no name, or cannot be written.
    """
    if not recipe.product.strip() or not recipe.name.strip():
        raise DatasetError("A defect recipe is kept under a product and a name: give both.")
    path = folder / FOLDER / f"{_plain(recipe.product)}-{_plain(recipe.name)}{ENDING}"
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, encode(recipe))
    return path


def defect_recipes(folder: Path, product: str = "") -> tuple[DefectRecipe, ...]:
    """The recipes beside the datasets, of one product where it is named, by product and name; damaged ones raise."""
    read = (read_defect_recipe(path) for path in sorted((folder / FOLDER).glob(f"*{ENDING}")))
    return tuple(recipe for recipe in read if not product or recipe.product == product)


def _plain(name: str) -> str:
    """What a file may be called."""
    return re.sub(r"[^\w.+-]+", "-", name.strip())
