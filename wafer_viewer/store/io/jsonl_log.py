"""Logs that only grow: a line of JSON for each entry, each written at once and brought to the disk.

A line that was being written when the power went is ignored when it is the last one, and cut off before the next.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TypeVar

import msgspec

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.spec import Spec, decode
from wafer_viewer.store.io.atomic_files import writing
from wafer_viewer.store.io.checksums import Checksum, line_state, sealed_line, unsealed

S = TypeVar("S", bound=Spec)


def append_line(path: Path, entry: Spec) -> None:
    """Add an entry. Raises DatasetError when the disk refuses it; then nothing of it counts."""
    text = sealed_line(msgspec.json.encode(entry)) + b"\n"
    with writing(path):
        path.touch()
        os.truncate(path, _end_of_whole_lines(path.read_bytes()))
        with path.open("ab", buffering=0) as file:
            if file.write(text) != len(text):
                raise DatasetError(f"{path} cannot be written: the disk is full: free some space.")
            os.fsync(file.fileno())


def read_lines(path: Path, kind: type[S]) -> tuple[S, ...]:
    """The entries, oldest first; none where there is no log. Raises DatasetError when one is damaged."""
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
    return decode(unsealed(line), kind, name, "json")


def _end_of_whole_lines(text: bytes) -> int:
    return text.rfind(b"\n") + 1
