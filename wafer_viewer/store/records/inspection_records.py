"""Records of inspection: recipes and judged defects by product, ``defects.json``, and ``notebook.json``."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import numpy as np

from wafer_viewer.model.errors import DatasetError, MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import Defect, DefectRecipe, Inspection
from wafer_viewer.model.inspection.defect_classes import FabClasses, require_distinct
from wafer_viewer.model.inspection.learned_classes import JudgedDefects
from wafer_viewer.model.job import Notebook
from wafer_viewer.model.spec import Spec, decode, encode, replace
from wafer_viewer.store.io.atomic_files import make_folder, os_errors_as_dataset_errors, remove, write_text
from wafer_viewer.store.io.checksums import require_good_json
from wafer_viewer.store.io.guarded_reading import read_content
from wafer_viewer.store.records.manifest import load_record, save_record

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
    return decode(read_content(place), DefectRecipe, place.name)


class _ClassFile(Spec, frozen=True, kw_only=True):
    """File with a class table."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    classes: FabClasses

    def __post_init__(self) -> None:
        super().__post_init__()
        require_distinct(self.classes)


def read_class_table(path: str | Path) -> FabClasses:
    """Read a fab's class table from a file.

    Parameters
    ----------
    path : str or Path
        TOML file with a section ``[[classes]]`` for each class: name, code, colour, key, klarf_number, and kind where
        it stands for a built-in class.

    Returns
    -------
    tuple of FabClass
        The classes, for the field `classes` of `DefectRecipe`.

    Raises
    ------
    DatasetError
        When the file cannot be read.
    MeasureError
        When it is no valid TOML, a field is missing, unknown or invalid, or two classes share a name, code, key, KLARF
        number or built-in class.
    """
    place = Path(path)
    return decode(read_content(place), _ClassFile, place.name).classes


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
    make_folder(path.parent)
    write_text(path, encode(recipe))
    return path


def rename_defect_recipe(folder: Path, recipe: DefectRecipe, name: str) -> Path:
    """Rename a saved recipe. Raises DatasetError when it does not exist, or the name is taken."""
    old, new = _existing(folder, recipe), _place(folder, recipe.product, name)
    if new.exists():
        raise DatasetError(f"There is a recipe '{name}' of {recipe.product} already: choose another name.")
    save_defect_recipe(folder, replace(read_defect_recipe(old), name=name))
    remove(old)
    return new


def delete_defect_recipe(folder: Path, recipe: DefectRecipe) -> None:
    """Delete a saved recipe. Raises DatasetError when it does not exist or cannot be deleted."""
    path = _existing(folder, recipe)
    with os_errors_as_dataset_errors(path):
        path.unlink()


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
        raise DatasetError("A defect recipe is saved under a product and a name: give both.")
    path = folder / FOLDER / f"{_plain(product)}-{_plain(name)}{ENDING}"
    if path.exists():
        existing = read_defect_recipe(path)
        if (existing.product, existing.name) != (product, name):
            raise DatasetError(
                f"{path.name} is the recipe '{existing.name}' of {existing.product}: choose another name."
            )
    return path


def _existing(folder: Path, recipe: DefectRecipe) -> Path:
    path = _place(folder, recipe.product, recipe.name)
    if not path.exists():
        raise DatasetError(f"There is no recipe '{recipe.name}' of {recipe.product} any more: choose one of the list.")
    return path


def _plain(name: str) -> str:
    """Return a name reduced to valid characters of a file name."""
    return re.sub(r"[^\w.+-]+", "-", name.strip())


JUDGED = ".judged.json"


def read_judged(folder: Path, product: str) -> JudgedDefects:
    """Read the judged defects of a product; none without a product or a file.

    Parameters
    ----------
    folder : Path
        Folder of the datasets.
    product : str
        Name of the product; may be empty.

    Returns
    -------
    JudgedDefects
        Judged defects of all of its inspections.

    Raises
    ------
    DatasetError
        When the file is unreadable, or that of another product.
    """
    path = folder / FOLDER / f"{_plain(product)}{JUDGED}"
    if not product.strip() or not path.exists():
        return JudgedDefects(product=product)
    judged = load_record(path, JudgedDefects)
    if judged.product != product:
        raise DatasetError(f"{path.name} holds judged defects of {judged.product}: rename the product or the file.")
    return judged


def save_judged(folder: Path, judged: JudgedDefects) -> Path:
    """Save the judged defects of a product, in place of those before. Raises DatasetError as `read_judged`."""
    read_judged(folder, judged.product)
    path = folder / FOLDER / f"{_plain(judged.product)}{JUDGED}"
    make_folder(path.parent)
    save_record(path, judged)
    return path


DEFECTS = "defects.json"
WORDS = ("judgement", "judged_kind", "note", "judged_by", "judged_at")
"""Fields of a defect set by reviewers; all others are measured."""


def read_inspection(result: Path) -> Inspection | None:
    """Read the inspection of a result; None if there is none. Raises DatasetError when it is unreadable."""
    path = result / DEFECTS
    return load_record(path, Inspection) if path.exists() else None


def write_inspection(result: Path, inspection: Inspection) -> None:
    """Save an inspection atomically, replacing an earlier one."""
    make_folder(result)
    save_record(result / DEFECTS, inspection, anew=True)


def carry_over(before: Inspection, after: Inspection) -> Inspection:
    """Return `after` with the review data of matching defects in `before`; its notes list unmatched judged ones.

    Two defects match if their centres are no further apart than half the length of the longer one; the nearest pairs
    are matched first, each defect once.
    """
    judged = [defect for defect in before.defects if is_judged(defect)]
    pairs = _pairs(judged, after.defects)
    review_by_index = {new: _words(judged[old]) for old, new in pairs}
    defects = tuple(replace(defect, **review_by_index.get(n, {})) for n, defect in enumerate(after.defects))
    gone = sorted(judged[k].number for k in set(range(len(judged))) - {old for old, _ in pairs})
    return replace(after, defects=defects, notes=(*after.notes, *_unmatched_note(gone)))


def is_judged(defect: Defect) -> bool:
    """Return whether a reviewer judged, classified or commented on a defect."""
    return defect.judgement != "open" or defect.judged_kind is not None or bool(defect.note)


def _words(defect: Defect) -> dict[str, str | None]:
    return {name: getattr(defect, name) for name in WORDS}


def _pairs(old: list[Defect], new: tuple[Defect, ...]) -> list[tuple[int, int]]:
    """Return index pairs of matching old and new defects, nearest first and each once."""
    near = sorted((distance, i, j) for i, a in enumerate(old) for distance, j in _within_reach(a, new))
    taken_old: set[int] = set()
    taken_new: set[int] = set()
    pairs: list[tuple[int, int]] = []
    for _, i, j in near:
        if i not in taken_old and j not in taken_new:
            pairs.append((i, j))
            taken_old.add(i)
            taken_new.add(j)
    return pairs


def _within_reach(a: Defect, others: tuple[Defect, ...]) -> list[tuple[float, int]]:
    """Return (distance, index) of the candidates for a match."""
    x, y = (np.array([getattr(b.center, axis) for b in others]) for axis in ("x_um", "y_um"))
    reach_um = np.maximum([b.major.value_um for b in others], a.major.value_um) / 2
    distance_um = np.hypot(x - a.center.x_um, y - a.center.y_um)
    return [(float(distance_um[j]), int(j)) for j in np.flatnonzero(distance_um <= reach_um)]


def _unmatched_note(numbers: Iterable[int]) -> tuple[str, ...]:
    listed = ", ".join(str(number) for number in numbers)
    return (f"Judged before and not found this time: {listed} of the inspection before.",) if listed else ()


NOTEBOOK = "notebook.json"


def read_notebook(result: Path) -> Notebook:
    """Read the notebook of a result; an empty one if there is none. Raises DatasetError when it is unreadable."""
    path = result / NOTEBOOK
    return load_record(path, Notebook) if path.exists() else Notebook()


def write_notebook(result: Path, notebook: Notebook) -> None:
    """Save a notebook, replacing the earlier one. Raises DatasetError when that is damaged."""
    make_folder(result)
    require_good_json(result / NOTEBOOK)
    save_record(result / NOTEBOOK, notebook)
