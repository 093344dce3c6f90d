"""Patterns of file names that say which field, frame and exposure an image is, such as ``r{row}_c{col}_k{k}.tif``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from wafer_viewer.model.acquisition.image_source import ImagePlane
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.image_formats import READ
from wafer_viewer.store.images.image_files import NOTHING_WRITTEN, Paths, PlanesOf, image_files, planes_of

Cell = tuple[int, int]
"""(row, col) as numbered in the files; a running number n is (0, n)."""
_PARTS = {
    "row": r"\d+",
    "col": r"\d+",
    "n": r"\d+",
    "k": r"\d+",
    "e": r"\d+",
    "z": r"[-+\u2212]?\d+(?:[.,]\d+)?",
}


@dataclass(frozen=True, slots=True)
class NamedPlane:
    """A plane with what the name of its file says. z_um: None where the pattern has no ``{z}``."""

    cell: Cell
    plane: ImagePlane


def planes_by_pattern(src: Paths, pattern: str, planes_of: PlanesOf = planes_of) -> list[NamedPlane]:
    """Return the planes of all images, with field, frame and exposure as the pattern reads them from the names.

    A pattern without ``{k}`` and ``{z}`` uses the pages of each file. A pattern with a slash is matched to the path
    relative to the given folder, otherwise to the file name.

    Raises
    ------
    DatasetError
        If a file does not match the pattern, or two files are the same frame.
    """
    expression = compile_pattern(pattern)
    found: dict[tuple[Cell, float, int], NamedPlane] = {}
    for path, name in _named_files(src, "/" in pattern):
        for named in _planes_of_file(path, name, expression, pattern, planes_of):
            plane = named.plane
            key = named.cell, plane.k if plane.z_um is None or "{z}" not in pattern else plane.z_um, plane.exposure
            if key in found:
                why = f"frame {key[1]:g} of row {named.cell[0]}, column {named.cell[1]} is there twice"
                raise DatasetError(_stopped(name, why, "Take one out."))
            found[key] = named
    return list(found.values())


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """Return the pattern as a regular expression with a named group for each part.

    The parts are row and col, or n for a running number, k or z for the frame, and e for the exposure; a single field
    with ``{z}`` or several exposures needs none for the field. A width, as in ``{row:2}``, is ignored, and
    ``{series}`` is n.

    Raises
    ------
    DatasetError
        If the pattern does not identify the field of a file, or has unknown or repeated parts.
    """
    parts = re.split(r"\{(\w+)(?::\w*)?\}", pattern.replace("{series", "{n"))
    names = parts[1::2]
    of_field = {"row", "col", "n"} & set(names)
    distinguishable = of_field in ({"row", "col"}, {"n"}) or (not of_field and {"e", "z"} & set(names))
    ambiguous = {"k", "z"} <= set(names) or len(names) != len(set(names))
    if not distinguishable or ambiguous or not set(names) <= _PARTS.keys():
        raise DatasetError(
            f"The pattern {pattern!r} does not say which field a file is: it needs {{row}} and {{col}}, or a running "
            "number {n}, {k} where each frame is a file or {z} where its z in um is in the name, and {e} where each z "
            "was taken in several exposures, once each, as in 'r{row}_c{col}_k{k}.tif'."
        )
    pieces = [rf"(?P<{part}>{_PARTS[part]})" if i % 2 else re.escape(part) for i, part in enumerate(parts)]
    return re.compile("".join(pieces), re.IGNORECASE)


def _named_files(src: Paths, deep: bool) -> list[tuple[Path, str]]:
    """Return the files, each with the name that is matched to the pattern."""
    folders = [Path(one) for one in ([src] if isinstance(src, str | Path) else src)]
    if not deep:
        return [(path, path.name) for path in image_files(src)]
    below = [(p, folder) for folder in folders for p in sorted(folder.rglob("*")) if p.suffix.lower() in READ]
    if not below:
        mend = "Give the folder that the pattern starts from."
        raise DatasetError(_stopped(str(folders[0]), "the folder holds no images", mend))
    return [(path, path.relative_to(folder).as_posix()) for path, folder in below]


def _planes_of_file(
    path: Path, name: str, expression: re.Pattern[str], pattern: str, planes_of: PlanesOf
) -> Sequence[NamedPlane]:
    match = expression.fullmatch(name)
    if match is None:
        why = f"its name does not fit the pattern {pattern!r}"
        raise DatasetError(_stopped(name, why, "Take the file out or change the pattern."))
    parts, planes = match.groupdict(), planes_of(path)
    cell = int(parts.get("row", 0)), int(parts.get("col", parts.get("n", 0)))
    if "e" in parts:
        planes = tuple(replace(plane, exposure=int(parts["e"])) for plane in planes)
    if not {"k", "z"} & parts.keys():
        return [NamedPlane(cell, plane) for plane in planes]
    if len(planes) > 1:
        why = f"it has {len(planes)} pages and the pattern says one frame a file"
        raise DatasetError(_stopped(name, why, "Leave out {k}."))
    if "k" in parts:
        return [NamedPlane(cell, replace(plane, k=int(parts["k"]))) for plane in planes]
    z_um = float(parts["z"].replace(",", ".").replace("\u2212", "-"))
    return [NamedPlane(cell, replace(plane, z_um=z_um)) for plane in planes]


def _stopped(name: str, why: str, mend: str) -> str:
    return f"Import stopped at {name}: {why}. {NOTHING_WRITTEN} {mend}"
