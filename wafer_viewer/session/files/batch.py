"""The same work on many sources, with a table that grows line by line and from which an ended run goes on."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.store.io.atomic_files import atomic_write, natural_sort_key
from wafer_viewer.store.tables.csv_tables import TableWriter, without_apostrophe
from wafer_viewer.store.tables.workbook import WORKBOOK, require_openpyxl, write_workbook

Work = Callable[[Path], Any]
DONE, FAILED = "done", "failed"
_FIXED = ("source", "status", "seconds", "message", "work", "stamp")
"""Columns of every table. work: words of the task; stamp: size and time of the source when it was worked on."""


@dataclass(frozen=True, slots=True)
class BatchReport:
    """End of a batch. done, failed: sources worked on now; kept: those that the table had as done and unchanged.

    stopped: True if it was stopped before the last source. rows: all lines of the table.
    """

    done: int
    failed: int
    kept: int
    stopped: bool
    rows: tuple[Mapping[str, Any], ...]


def run_batch(
    sources: Sequence[str | Path],
    work: Work,
    table: str | Path | None = None,
    *,
    name: str = "",
    again: bool = False,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
    told: Callable[[Mapping[str, Any]], None] = lambda row: None,
) -> BatchReport:
    """Do the same work on many sources, and write a table of what it returns.

    A source that fails is told in its line, and the next one follows. The table is written after every source: when
    it is there already, sources that it has as done, with the same work and unchanged since, are left as they are.

    Parameters
    ----------
    sources : sequence of str or Path
        Files and folders; patterns such as ``data/*.tif`` are expanded, in natural order.
    work : callable
        Receives a path. What it returns fills the columns: a mapping, a measured result, or None.
    table : str or Path, optional
        CSV file, or Excel file (.xlsx) with the CSV beside it. Default: no table is written.
    name : str, optional
        Words of the work, which tell one task from another in the table.
    again : bool, default False
        Also do what the table has as done.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop; asked between sources.
    told : callable, optional
        Receives the line of every source when it is done.

    Returns
    -------
    BatchReport
        How many were done, failed and kept, and all lines.

    Raises
    ------
    DatasetError
        If there is no source, or the table is not one of a batch or cannot be written.
    """
    paths = expanded(sources)
    out = None if table is None else Path(table)
    workbook = out if out is not None and out.suffix == WORKBOOK else None
    if workbook is not None:
        require_openpyxl()
        out = workbook.with_suffix(".csv")
    known = {} if out is None or not out.exists() else _read(out)
    rows: dict[str, Mapping[str, Any]] = dict(known)
    done = failed = kept = 0
    stopped = False
    for n, path in enumerate(paths):
        if should_stop():
            stopped = True
            break
        progress(n / len(paths))
        key, stamp = str(path), _stamp(path)
        before = known.get(key, {})
        if not again and _is_done(before, name, stamp):
            kept += 1
            continue
        row = {"source": key, **_worked_on(path, work), "work": name, "stamp": stamp}
        done, failed = done + (row["status"] == DONE), failed + (row["status"] != DONE)
        rows[key] = row
        if out is not None:
            _write(out, list(rows.values()))
        told(row)
    progress(1.0)
    if workbook is not None:
        columns = _columns(list(rows.values()))
        lines = ([row.get(column, "") for column in columns] for row in rows.values())
        write_workbook(workbook, "Results", columns, lines)
    return BatchReport(done, failed, kept, stopped, tuple(rows[str(path)] for path in paths if str(path) in rows))


def expanded(sources: Sequence[str | Path]) -> list[Path]:
    """Return the sources, with those of patterns in natural order, each once.

    Raises
    ------
    DatasetError
        If a pattern fits nothing, or there is no source.
    """
    found: dict[Path, None] = {}
    for source in sources:
        text = str(source)
        if Path(text).exists() or not set(text) & set("*?["):
            found[Path(text)] = None
            continue
        root = Path(Path(text).anchor) if Path(text).is_absolute() else Path()
        fitting = sorted(root.glob(text.removeprefix(str(root)) if root.anchor else text), key=_natural)
        if not fitting:
            raise DatasetError(f"Nothing is named like {text}: check the pattern.")
        found |= dict.fromkeys(fitting)
    if not found:
        raise DatasetError("There are no sources: name files, folders, or a pattern such as 'data/*.tif'.")
    return list(found)


def _natural(path: Path) -> list[str | int]:
    return natural_sort_key(str(path))


def output_names(paths: Sequence[Path], folder: Path, ending: str) -> dict[Path, Path]:
    """Return an output file in `folder` for each source, named after it, and its folder where names are alike.

    Raises
    ------
    DatasetError
        If two sources would be written to one file.
    """
    stems = {path: path.name.split(".")[0] if path.is_dir() else path.stem for path in paths}
    alike = {stem for stem in stems.values() if list(stems.values()).count(stem) > 1}
    names = {path: f"{path.absolute().parent.name}_{stem}" if stem in alike else stem for path, stem in stems.items()}
    by_name: dict[str, Path] = {}
    for path, name in names.items():
        if name in by_name:
            raise DatasetError(f"{by_name[name]} and {path} would both be written to {name}{ending}: rename one.")
        by_name[name] = path
    return {path: folder / f"{name}{ending}" for path, name in names.items()}


def _is_done(before: Mapping[str, Any], name: str, stamp: str) -> bool:
    """Return whether a line of the table is that of the same work on the unchanged source, with its output there."""
    same = (before.get("status"), before.get("work", ""), before.get("stamp")) == (DONE, name, stamp)
    return same and (not before.get("output") or Path(before["output"]).exists())


def _worked_on(path: Path, work: Work) -> dict[str, Any]:
    began = time.monotonic()
    try:
        numbers = columns_of(work(path))
        status, message = DONE, ""
    except WaferViewerError as fault:
        numbers, status, message = {}, FAILED, str(fault)
    except OSError as fault:
        numbers, status, message = {}, FAILED, f"{fault.filename or path}: {fault.strerror or fault}."
    return {"status": status, "seconds": f"{time.monotonic() - began:.1f}", "message": message, **numbers}


def columns_of(found: Any) -> dict[str, Any]:
    """Return numbers and texts of a result as columns: a quantity gives its value, with its unit, and U (95 %)."""
    known = msgspec.to_builtins(found)
    columns: dict[str, Any] = {}
    for key, value in known.items() if isinstance(known, dict) else ():
        if isinstance(value, dict) and (number := _quantity(value)) is not None:
            title = f"{key}, {number[2]}" if number[2] else key
            columns |= {title: number[0], f"U of {title}": "" if number[1] is None else number[1]}
        elif isinstance(value, str | int | float | bool):
            columns[key] = value
    return columns


def _quantity(known: Mapping[str, Any]) -> tuple[float, float | None, str] | None:
    """Return value, U and unit of a number with an uncertainty; None for anything else."""
    if isinstance(known.get("value_um"), int | float):
        return known["value_um"], known.get("expanded_um"), "um"
    if isinstance(known.get("value"), int | float):
        return known["value"], known.get("expanded"), known.get("unit", "")
    return None


def _stamp(path: Path) -> str:
    """Return size and time of a source, of a folder those of its files; empty if it does not exist."""
    states = [file.stat() for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file()]
    return (
        "" if not states else f"{sum(state.st_size for state in states)} {max(state.st_mtime_ns for state in states)}"
    )


def _read(table: Path) -> dict[str, Mapping[str, Any]]:
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            lines = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as fault:
        raise DatasetError(f"{table} cannot be read as the table of a batch: choose another --table.") from fault
    if lines and not set(_FIXED) <= set(lines[0]):
        raise DatasetError(f"{table} is no table of a batch: choose another --table.")
    return {line["source"]: {without_apostrophe(key): value for key, value in line.items() if key} for line in lines}


def _columns(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    numbers = dict.fromkeys(key for row in rows for key in row if key not in _FIXED)
    return [*_FIXED[:4], *numbers, *_FIXED[4:]]


def _write(table: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    columns = _columns(rows)
    text = io.StringIO()
    writer = TableWriter(text)
    writer.writerow(columns)
    writer.writerows([row.get(column, "") for column in columns] for row in rows)
    with atomic_write(table) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")
