"""Journal lines of frames by field and slot, also of so many that they are rows of a table until a field is read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.store.dataset.scan_record import FrameKept

ROW = np.dtype(
    [
        *((name, "<i8") for name in ("field", "k", "exposure", "pulse_count")),
        *((name, "<f8") for name in ("x_um", "y_um", "z_um", "exposure_us")),
        ("device_time_us", "<i8"),
        ("crc32", "<i8"),
    ]
)


@dataclass(frozen=True)
class FrameTable:
    """Journal lines of frames as rows of a table, those of a field together."""

    rows: NDArray[Any]

    @classmethod
    def of(cls, lines: Iterable[FrameKept], before: FrameTable | None = None) -> FrameTable:
        """Return the table of lines, and of those of another table for fields that have none."""
        values = [(*msgspec.structs.astuple(line.shot), *msgspec.structs.astuple(line)[1:]) for line in lines]
        rows = np.array(values, ROW)
        if before is not None:
            others = before.rows[~np.isin(before.rows["field"], rows["field"])]
            rows = np.concatenate([others, rows])
        return cls(rows[np.argsort(rows["field"], kind="stable")])

    def without(self, fields: list[int]) -> FrameTable:
        """Return the table without some fields."""
        return FrameTable(self.rows[~np.isin(self.rows["field"], fields)]) if fields else self

    @cached_property
    def parts(self) -> dict[int, tuple[int, int]]:
        """First row and end of each field, by its number."""
        fields, first = np.unique(self.rows["field"], return_index=True)
        ends = [*first[1:].tolist(), len(self.rows)]
        return dict(zip(fields.tolist(), zip(first.tolist(), ends, strict=True), strict=True))

    def lines(self, field: int) -> dict[Shot, FrameKept]:
        """Return the lines of a field by slot."""
        first, end = self.parts.get(field, (0, 0))
        lines = (FrameKept(Shot(*row[:3]), *row[3:]) for row in self.rows[first:end].tolist())
        return {line.shot: line for line in lines}


class FrameLines:
    """Journal lines of frames by field and slot; the first line of a slot counts.

    table: lines of fields that no later line changed.
    """

    def __init__(self, table: FrameTable | None = None) -> None:
        self._table = table
        self._of: dict[int, dict[Shot, FrameKept]] = {}

    def __contains__(self, shot: Shot) -> bool:
        return shot in self.of(shot.field)

    def of(self, field: int) -> Mapping[Shot, FrameKept]:
        """Return the lines of a field."""
        lines = self._of.get(field)
        return lines if lines is not None else {} if self._table is None else self._table.lines(field)

    def count(self, field: int) -> int:
        """Return the number of lines of a field."""
        if self._table is not None and field not in self._of:
            first, end = self._table.parts.get(field, (0, 0))
            return end - first
        return len(self._of.get(field, ()))

    def shots(self) -> set[Shot]:
        """Return all slots."""
        return {shot for field in self._fields() for shot in self.of(field)}

    def table(self) -> FrameTable:
        """Return all lines as a table."""
        new = (line for lines in self._of.values() for line in lines.values())
        gone = [field for field, lines in self._of.items() if not lines]
        return FrameTable.of(new, None if self._table is None else self._table.without(gone))

    def add(self, line: FrameKept) -> None:
        """Add a line."""
        self._own(line.shot.field).setdefault(line.shot, line)

    def add_all(self, others: FrameLines) -> None:
        """Add the lines of another table, which gives them up."""
        for field, lines in others._of.items():
            if self.count(field):
                own = self._own(field)
                for shot, line in lines.items():
                    own.setdefault(shot, line)
            else:
                self._of[field] = lines

    def drop(self, shot: Shot) -> None:
        """Remove a slot."""
        if self.count(shot.field):
            self._own(shot.field).pop(shot, None)

    def drop_field(self, field: int) -> None:
        """Remove all slots of a field."""
        self._of[field] = {}

    def _own(self, field: int) -> dict[Shot, FrameKept]:
        """Return the lines of a field to be changed."""
        lines = self._of.get(field)
        if lines is None:
            lines = self._of[field] = {} if self._table is None else self._table.lines(field)
        return lines

    def _fields(self) -> Iterable[int]:
        return self._of.keys() | (self._table.parts.keys() if self._table is not None else set[int]())
