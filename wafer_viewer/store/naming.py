"""Which field and which frame a file is, told by its name: patterns such as ``r{row}_c{col}_k{k}.tif``."""

from __future__ import annotations

import re
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.images import NOTHING_WRITTEN, READERS, Paths, Picture, image_files, pictures, pictures_of

Cell = tuple[int, int]
"""(row, col) as the files are numbered."""
_PARTS = {"row", "col", "k"}


def stacks_by_cell(src: Paths, pattern: str | None) -> dict[Cell, list[Picture | None]]:
    """The pictures of each field in order of k, None where a field lacks a frame that others have.

    Without a pattern all pictures are one field; a pattern without ``{k}`` takes the pages of each file. A pattern
    with a slash is matched to the path below the folder given, else to the name.
    Raises DatasetError when a file does not fit the pattern, or two files are the same frame.
    """
    if pattern is None:
        return {(0, 0): list(pictures(src))}
    expression = compile_pattern(pattern)
    found: dict[Cell, dict[int, Picture]] = {}
    for path, name in _named_files(src, "/" in pattern):
        cell, frames = _frames_of(path, name, expression, pattern)
        stack = found.setdefault(cell, {})
        if twice := stack.keys() & frames.keys():
            raise _stopped(
                name, f"frame {min(twice)} of row {cell[0]}, column {cell[1]} is there twice", "Take one out."
            )
        stack |= frames
    ks = sorted({k for stack in found.values() for k in stack})
    return {cell: [found[cell].get(k) for k in ks] for cell in sorted(found)}


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """The pattern as a regular expression with the groups row, col and, where it has one, k."""
    parts = re.split(r"\{(\w+)\}", pattern)
    names = parts[1::2]
    if not {"row", "col"} <= set(names) <= _PARTS or len(names) != len(set(names)):
        raise DatasetError(
            f"The pattern {pattern!r} does not say which field a file is: it needs {{row}} and {{col}}, "
            "and {k} where each frame is a file, once each, as in 'r{row}_c{col}_k{k}.tif'."
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


def _frames_of(path: Path, name: str, expression: re.Pattern[str], pattern: str) -> tuple[Cell, dict[int, Picture]]:
    match = expression.fullmatch(name)
    if match is None:
        raise _stopped(
            name, f"its name does not fit the pattern {pattern!r}", "Take the file out or change the pattern."
        )
    cell, of_file = (int(match["row"]), int(match["col"])), pictures_of(path)
    if "k" not in match.groupdict():
        return cell, dict(enumerate(of_file))
    if len(of_file) > 1:
        raise _stopped(name, f"it has {len(of_file)} pages and the pattern says one frame a file", "Leave out {k}.")
    return cell, {int(match["k"]): of_file[0]}


def _stopped(name: str, why: str, mend: str) -> DatasetError:
    return DatasetError(f"Import stopped at {name}: {why}. {NOTHING_WRITTEN} {mend}")
