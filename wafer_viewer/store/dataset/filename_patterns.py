"""Field, frame and exposure numbers parsed from file names by a pattern such as ``r{row}_c{col}_k{k}_e{e}.tif``."""

from __future__ import annotations

import re
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.image_files import (
    NOTHING_WRITTEN,
    READERS,
    ImageFile,
    Paths,
    image_files,
    pictures,
    pictures_of,
)

Cell = tuple[int, int]
"""(row, col) as numbered in the files."""
Slot = tuple[ImageFile | None, ...]
"""Images taken at one z: one per exposure, None where it is missing."""
_PARTS = {"row", "col", "k", "e"}


def stacks_by_cell(src: Paths, pattern: str | None) -> dict[Cell, list[Slot]]:
    """Return the slots of each field in order of k, all with the same number of exposures in numerical order.

    Without a pattern all images form one field with one exposure; a pattern without ``{k}`` uses the pages of each
    file. A pattern with a slash is matched to the path relative to the given folder, otherwise to the file name.

    Raises DatasetError when a file does not match the pattern, or two files are the same frame.
    """
    if pattern is None:
        return {(0, 0): [(picture,) for picture in pictures(src)]}
    expression = compile_pattern(pattern)
    found: dict[Cell, dict[tuple[int, int], ImageFile]] = {}
    for path, name in _named_files(src, "/" in pattern):
        cell, frames = _frames_of(path, name, expression, pattern)
        stack = found.setdefault(cell, {})
        if twice := stack.keys() & frames.keys():
            raise _stopped(
                name, f"frame {min(twice)[0]} of row {cell[0]}, column {cell[1]} is there twice", "Take one out."
            )
        stack |= frames
    ks, es = (sorted({of_frame[i] for stack in found.values() for of_frame in stack}) for i in (0, 1))
    return {cell: [tuple(found[cell].get((k, e)) for e in es) for k in ks] for cell in sorted(found)}


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """Return the pattern as a regular expression with a named group for each part.

    The parts are row, col, k and e; a single field with several exposures needs neither row nor col.
    """
    parts = re.split(r"\{(\w+)\}", pattern)
    names = parts[1::2]
    told_apart = {"row", "col"} <= set(names) or ("e" in names and not {"row", "col"} & set(names))
    if not told_apart or not set(names) <= _PARTS or len(names) != len(set(names)):
        raise DatasetError(
            f"The pattern {pattern!r} does not say which field a file is: it needs {{row}} and {{col}}, "
            "{k} where each frame is a file, and {e} where each z was taken in several exposures, once each, "
            "as in 'r{row}_c{col}_k{k}.tif'."
        )
    pieces = [rf"(?P<{part}>\d+)" if i % 2 else re.escape(part) for i, part in enumerate(parts)]
    return re.compile("".join(pieces), re.IGNORECASE)


def _named_files(src: Paths, deep: bool) -> list[tuple[Path, str]]:
    """Return the files, each with the name that is matched to the pattern."""
    folders = [Path(one) for one in ([src] if isinstance(src, str | Path) else src)]
    if not deep:
        return [(path, path.name) for path in image_files(src)]
    below = [(p, folder) for folder in folders for p in sorted(folder.rglob("*")) if p.suffix.lower() in READERS]
    if not below:
        raise _stopped(str(folders[0]), "the folder holds no images", "Give the folder that the pattern starts from.")
    return [(path, path.relative_to(folder).as_posix()) for path, folder in below]


def _frames_of(
    path: Path, name: str, expression: re.Pattern[str], pattern: str
) -> tuple[Cell, dict[tuple[int, int], ImageFile]]:
    """Return the field of a file, and its images by (k, exposure)."""
    match = expression.fullmatch(name)
    if match is None:
        raise _stopped(
            name, f"its name does not fit the pattern {pattern!r}", "Take the file out or change the pattern."
        )
    numbers, of_file = {part: int(digits) for part, digits in match.groupdict().items()}, pictures_of(path)
    cell, exposure = (numbers.get("row", 0), numbers.get("col", 0)), numbers.get("e", 0)
    if "k" not in numbers:
        return cell, {(k, exposure): picture for k, picture in enumerate(of_file)}
    if len(of_file) > 1:
        raise _stopped(name, f"it has {len(of_file)} pages and the pattern says one frame a file", "Leave out {k}.")
    return cell, {(numbers["k"], exposure): of_file[0]}


def _stopped(name: str, why: str, mend: str) -> DatasetError:
    return DatasetError(f"Import stopped at {name}: {why}. {NOTHING_WRITTEN} {mend}")
