"""Index of a long journal: its frames as a table, so that a dataset opens without decoding a million lines.

It holds nothing that the journal does not, and may be deleted at any time. It counts as long as the journal begins with
the bytes that it was made from, by their checksum.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.frame_lines import ROW, FrameTable
from wafer_viewer.store.dataset.scan_record import Line
from wafer_viewer.store.io.archives import open_archive
from wafer_viewer.store.io.atomic_files import atomic_write
from wafer_viewer.store.io.checksums import crc_of_file, seal_archive

INDEX = "journal.index.npz"
LONG_LINES = 100_000
"""New lines from which an index is worth its file: they take 0.2 s to decode (tests/bench/bench_index.py)."""
_LINES = msgspec.json.Decoder(list[Line])


@dataclass(frozen=True, slots=True)
class JournalIndex:
    """State of a dataset after the first `n_bytes` of its journal, `n_lines` lines.

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
