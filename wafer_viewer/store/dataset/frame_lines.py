"""Journal lines of frames by field and slot, and the index of a long journal as a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.scan_record import FrameKept, Line
from wafer_viewer.store.io.archives import open_archive
from wafer_viewer.store.io.atomic_files import atomic_write
from wafer_viewer.store.io.checksums import crc_of_file, seal_archive

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


INDEX = "journal.index.npz"
LONG_LINES = 100_000
"""New lines from which an index is worth its file: they take 0.2 s to decode (tests/bench/bench_index.py)."""
_LINES = msgspec.json.Decoder(list[Line])


@dataclass(frozen=True, slots=True)
class JournalIndex:
    """State of a dataset after the first `n_bytes` of its journal, `n_lines` lines.

    It holds nothing that the journal does not, and may be deleted at any time. It counts as long as the journal begins
    with the bytes that it was made from, by their checksum.

    others: its lines that tell more than that a frame was kept, in order; ended: True if the scan had finished.
    """

    n_bytes: int
    n_lines: int
    ended: bool
    others: tuple[Line, ...]
    table: FrameTable

    def write(self, journal: Path) -> None:
        """Write the index beside its journal. Raises DatasetError when that is impossible."""
        head = np.array([self.n_bytes, self.n_lines, self.ended, crc_of_file(journal, self.n_bytes)], np.int64)
        others = np.frombuffer(msgspec.json.encode(self.others), np.uint8)
        with atomic_write(journal.with_name(INDEX)) as temporary:
            with temporary.open("wb") as file:
                np.savez(file, allow_pickle=False, head=head, others=others, rows=self.table.rows)
            seal_archive(temporary)

    @classmethod
    def read(cls, journal: Path) -> JournalIndex | None:
        """Read the index of a journal; None if there is none, or if it is damaged or of another journal."""
        path = journal.with_name(INDEX)
        unreadable = DatasetError(f"{path} cannot be read.")
        with suppress(DatasetError), open_archive(path, lambda _: unreadable) as archive:
            n_bytes, n_lines, ended, crc = archive.array("head").tolist()
            others = tuple(_LINES.decode(archive.array("others").tobytes()))
            rows = archive.mapped("rows")
            if rows.dtype == ROW and journal.stat().st_size >= n_bytes and crc_of_file(journal, n_bytes) == crc:
                return cls(n_bytes, n_lines, bool(ended), others, FrameTable(rows))
        return None
