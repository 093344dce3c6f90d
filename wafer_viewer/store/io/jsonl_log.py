"""Append-only logs: one JSON line per entry, each written and synced to disk at once.

A torn last line, as after a power failure, is ignored and truncated before the next entry.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TypeVar

import msgspec

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.spec import Spec, decode
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import Checksum, line_state, sealed_line, strip_checksum

S = TypeVar("S", bound=Spec)


def append_line(path: Path, entry: Spec) -> None:
    """Append an entry. Raises DatasetError when it cannot be written; the entry then does not count."""
    text = sealed_line(msgspec.json.encode(entry)) + b"\n"
    with os_errors_as_dataset_errors(path):
        path.touch()
        os.truncate(path, _end_of_whole_lines(path.read_bytes()))
        with path.open("ab", buffering=0) as file:
            if file.write(text) != len(text):
                raise DatasetError(f"{path} cannot be written: the disk is full: free some space.")
            os.fsync(file.fileno())


def read_lines(path: Path, kind: type[S]) -> tuple[S, ...]:
    """Return the entries, oldest first; empty if there is no log. Raises DatasetError when one is damaged."""
    if not path.exists():
        return ()
    try:
        text = path.read_bytes()
    except OSError as fault:
        raise DatasetError(f"{path} cannot be read: {fault.strerror}.") from fault
    lines = text[: _end_of_whole_lines(text)].splitlines()
    return tuple(_decoded(line, kind, f"{path}, line {n}") for n, line in enumerate(lines, 1))


def _decoded(line: bytes, kind: type[S], name: str) -> S:
    if line_state(line) is Checksum.DAMAGED:
        raise DatasetError(f"{name} is damaged, its checksum differs: restore it from a copy.")
    return decode(strip_checksum(line), kind, name, "json")


def _end_of_whole_lines(text: bytes) -> int:
    return text.rfind(b"\n") + 1
