"""Which field, frame and exposure a file is, told by its name: patterns such as ``r{row}_c{col}_k{k}_e{e}.tif``."""

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
"""(row, col) as the files are numbered."""
Slot = tuple[ImageFile | None, ...]
"""What was taken at one z: a picture in each exposure, None where there is none."""
_PARTS = {"row", "col", "k", "e"}


def stacks_by_cell(src: Paths, pattern: str | None) -> dict[Cell, list[Slot]]:
    """The slots of each field in order of k, all with as many exposures, in the order of their numbers.

    Without a pattern all pictures are one field in one exposure; a pattern without ``{k}`` takes the pages of each
    file. A pattern with a slash is matched to the path below the folder given, else to the name.
    Raises DatasetError when a file does not fit the pattern, or two files are the same frame.
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
    """The pattern as a regular expression with a group for each part it names.

    Those are row and col, of which one field in several exposures needs none, k and e.
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
    """Files with the name that the pattern is matched to."""
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
    """The field of a file, and its pictures by (k, exposure)."""
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
