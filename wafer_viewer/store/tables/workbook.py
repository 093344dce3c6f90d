"""Tables as Excel workbooks, by openpyxl; the same table makes the same cells."""

from __future__ import annotations

import datetime
import importlib.util
from collections.abc import Iterable, Sequence
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import atomic_write

WORKBOOK = ".xlsx"
_EPOCH = datetime.datetime(2000, 1, 1)
"""Date in the file: when it was written is not part of a table."""


def require_openpyxl() -> None:
    """Raise DatasetError where Excel files cannot be written: asked before the work whose table one shall be."""
    if importlib.util.find_spec("openpyxl") is None:
        raise DatasetError("Excel files are written by openpyxl: pip install 'wafer-viewer[tables]', or choose .csv.")


def write_workbook(path: Path, title: str, heads: Sequence[str], lines: Iterable[Sequence[object]]) -> None:
    """Write a sheet with a line of heads that stays in sight; numbers are numbers, every text is a text, no formula.

    Raises DatasetError when openpyxl is missing or the file cannot be written.
    """
    require_openpyxl()
    from openpyxl import Workbook
    from openpyxl.cell import WriteOnlyCell
    from openpyxl.styles import Font

    book = Workbook(write_only=True)
    book.properties.creator, book.properties.created, book.properties.modified = "Wafer Viewer", _EPOCH, _EPOCH
    sheet = book.create_sheet(title)
    sheet.freeze_panes = "B2"

    def cell(value: object, bold: bool = False) -> object:
        made = WriteOnlyCell(sheet, value=_number_or_text(value))
        if isinstance(made.value, str):
            made.data_type = "s"  # what begins with = would be a formula
        if bold:
            made.font = Font(bold=True)
        return made

    sheet.append([cell(head, bold=True) for head in heads])
    for line in lines:
        sheet.append([cell(value) for value in line])
    with atomic_write(path) as temporary:
        book.save(temporary)


def _number_or_text(value: object) -> str | float | None:
    """Return a value as number where it is one, also as text out of a CSV file."""
    if not isinstance(value, str):
        return value if isinstance(value, int | float) and not isinstance(value, bool) else f"{value}"
    try:
        return float(value) if value.strip() else None
    except ValueError:
        return value
