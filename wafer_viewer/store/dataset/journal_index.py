"""Index of a long journal: its frames as a table, so that a dataset opens without decoding a million lines.

It holds nothing that the journal does not, and may be deleted at any time. It counts as long as the journal begins with
the bytes that it was made from, by their checksum.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.frame_lines import ROW, FrameTable
from wafer_viewer.store.dataset.scan_record import Line
from wafer_viewer.store.formats.npz_file import map_member
from wafer_viewer.store.io.atomic_files import atomic_write
from wafer_viewer.store.io.checksums import crc_of_file, require_good_archive, seal_archive

INDEX = "journal.index.npz"
LONG_LINES = 100_000
"""New lines from which an index is worth its file: they take 0.2 s to decode (tests/bench/bench_index.py)."""
_LINES = msgspec.json.Decoder(list[Line])
_UNREADABLE = (
    OSError,
    KeyError,
    ValueError,
    EOFError,
    TypeError,
    zipfile.BadZipFile,
    msgspec.DecodeError,
    DatasetError,
)


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
        if not path.exists():
            return None
        try:
            require_good_archive(path)
            with np.load(path) as members:
                n_bytes, n_lines, ended, crc = members["head"].tolist()
                others = tuple(_LINES.decode(members["others"].tobytes()))
            if journal.stat().st_size < n_bytes or crc_of_file(journal, n_bytes) != crc:
                return None
            with zipfile.ZipFile(path) as archive, path.open("rb") as file:
                rows = map_member(path, file, archive.getinfo("rows.npy"))
        except _UNREADABLE:
            return None
        return cls(n_bytes, n_lines, bool(ended), others, FrameTable(rows)) if rows.dtype == ROW else None
