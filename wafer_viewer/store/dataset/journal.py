"""Journal of a dataset: one JSON line per event, in order; a frame's line is written after its page.

A torn last line, as after a power failure, is ignored; a damaged line anywhere else is an error.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import msgspec

from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.plan import Axis, Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import Checksum, line_state, sealed_line


class PassBegun(msgspec.Struct, frozen=True, tag="pass_begun", omit_defaults=True):
    """Start of a leg.

    provisional: the frames count only once the pass has ended, and those that are later reported as missed do not.
    Older programs counted every frame at once.
    """

    number: int
    axis: Axis
    n_frames: int
    time: str
    provisional: bool = False


class FrameKept(msgspec.Struct, frozen=True, tag="frame"):
    """Frame written to its page: slot, trigger pulse, stage position at mid-exposure, checksum of the page."""

    shot: Shot
    pulse_count: int
    x_um: float
    y_um: float
    z_um: float
    exposure_us: float
    device_time_us: int
    crc32: int


class Missed(msgspec.Struct, frozen=True, tag="missed"):
    """Slot without a frame, or rejected frame of the current pass, with the reason."""

    shot: Shot
    pulse_count: int
    why: str


class Repaired(msgspec.Struct, frozen=True, tag="repaired"):
    """Slot that was empty and now has its frame."""

    shot: Shot


class PassEnded(msgspec.Struct, frozen=True, tag="pass_ended"):
    """End of a leg, with the counts of the pulse box."""

    number: int
    summary: PulseSummary
    time: str


class FaultNoted(msgspec.Struct, frozen=True, tag="fault"):
    """Fault report for the operator."""

    what: str
    time: str


class Finished(msgspec.Struct, frozen=True, tag="finished"):
    """End of the scan; slots that are empty now stay empty."""

    time: str


Line = PassBegun | FrameKept | Missed | Repaired | PassEnded | FaultNoted | Finished
_DECODER = msgspec.json.Decoder(Line)
_DAMAGE = (msgspec.DecodeError, ValueError)


class JournalReader:
    """Incremental reader, which can follow a growing journal."""

    def __init__(self, path: Path) -> None:
        self._path, self._offset, self._number = path, 0, 0

    def new_lines(self) -> Iterator[Line]:
        """Yield the complete lines added since the last call. Raises DatasetError when one is damaged."""
        for text in self._new_text():
            line = self._decode(text)
            if line is None:
                return
            self._offset += len(text) + 1
            self._number += 1
            yield line

    def _new_text(self) -> list[bytes]:
        try:
            with self._path.open("rb") as file:
                file.seek(self._offset)
                text = file.read()
        except OSError as fault:
            raise DatasetError(f"{self._path} cannot be read: {fault.strerror}.") from fault
        whole = text[: text.rfind(b"\n") + 1]
        return whole.split(b"\n")[:-1]

    def _decode(self, text: bytes) -> Line | None:
        try:
            return _decoded(text)
        except _DAMAGE as fault:
            if self._offset + len(text) + 1 >= self._path.stat().st_size:
                return None
            raise DatasetError(
                f"{self._path} is damaged in line {self._number + 1}: restore it from a copy, "
                "or delete that line and those after it and scan the rest again."
            ) from fault


class JournalWriter:
    """Appends lines, each with one write; a torn last line of an earlier writer is truncated first."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with os_errors_as_dataset_errors(path):
            path.touch()
            os.truncate(path, _end_of_whole_lines(path))
            self._file = path.open("ab", buffering=0)

    def write(self, line: Line) -> None:
        """Append a line. Raises DatasetError when it cannot be written."""
        text = sealed_line(msgspec.json.encode(line)) + b"\n"
        with os_errors_as_dataset_errors(self._path):
            if self._file.write(text) != len(text):
                raise DatasetError(f"{self._path} cannot be written: the disk is full: free some space.")

    def close(self) -> None:
        """Close the file; idempotent."""
        self._file.close()


def _decoded(text: bytes) -> Line:
    """Decode a line. Raises ValueError when it is damaged."""
    if line_state(text) is Checksum.DAMAGED:
        raise ValueError("its checksum differs")
    return _DECODER.decode(text)


def _end_of_whole_lines(path: Path) -> int:
    """Return the end offset of the last complete and readable line."""
    text = path.read_bytes()
    end = text.rfind(b"\n") + 1
    begin = text.rfind(b"\n", 0, max(0, end - 1)) + 1
    try:
        _decoded(text[begin:end].rstrip(b"\n"))
    except _DAMAGE:
        return begin
    return end
