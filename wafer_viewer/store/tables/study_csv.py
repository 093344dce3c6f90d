"""Table of a repeatability study: one line per value, with part and appraiser."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError

COLUMNS = ("part", "appraiser", "value")
HOW = "a study has the columns part, appraiser and value, and a line for each trial"


def read_study(path: Path) -> NDArray[np.float64]:
    """Read the values of a CSV file, [part, appraiser, trial]; trials in line order. Lines with # are skipped.

    Raises MeasureError when the file cannot be read, lacks a column, holds a non-number, or has unequal numbers of
    trials.
    """
    cells: dict[tuple[str, str], list[float]] = defaultdict(list)
    for number, line in _lines(path):
        try:
            cells[line["part"].strip(), line["appraiser"].strip()].append(float(line["value"]))
        except (ValueError, TypeError, AttributeError) as fault:
            raise MeasureError(
                f"{path.name}, line {number}: {line.get('value')!r} is not a number: correct the line."
            ) from fault
    if not cells:
        raise MeasureError(f"{path.name} holds no values: {HOW}.")
    parts, appraisers = (list(dict.fromkeys(key[k] for key in cells)) for k in range(2))
    trials = len(next(iter(cells.values())))
    for part in parts:
        for appraiser in appraisers:
            if (found := len(cells.get((part, appraiser), ()))) != trials:
                raise MeasureError(
                    f"{path.name}: part {part} has {found} values of {appraiser}, the first has {trials}: "
                    f"everyone measures every part equally often."
                )
    return np.array([[cells[part, appraiser] for appraiser in appraisers] for part in parts])


def _lines(path: Path) -> list[tuple[int, dict[str, str]]]:
    try:
        kept = [(n, text) for n, text in enumerate(path.read_text("utf-8-sig").splitlines(), 1) if _counts(text)]
    except (OSError, UnicodeDecodeError) as fault:
        raise MeasureError(f"{path} cannot be read ({fault}): {HOW}.") from fault
    table = csv.DictReader(text for _, text in kept)
    missing = [name for name in COLUMNS if name not in (table.fieldnames or ())]
    if missing:
        raise MeasureError(f"{path.name} has no column {missing[0]}: {HOW}.")
    return [(n, line) for (n, _), line in zip(kept[1:], table, strict=False)]


def _counts(text: str) -> bool:
    return bool(text.strip()) and not text.startswith("#")
