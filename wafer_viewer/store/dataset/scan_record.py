"""Record of a scan: its metadata in ``scan.json``, and the journal with one JSON line per event.

A torn last line, as after a power failure, is ignored, and so is a pass from its first damaged line on, if it never
ended: the disk may have kept some of its lines and lost others. A damaged line anywhere else is an error.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Annotated, ClassVar

import msgspec

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.plan import Axis, Field, ScanPlan, Shot
from wafer_viewer.model.acquisition.positioners import PositionerReading
from wafer_viewer.model.errors import DatasetError, WaferViewerError, parser_errors_as
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import Spec, Within, decode
from wafer_viewer.store.dataset.frame_pages import PageShape
from wafer_viewer.store.io.atomic_files import flush, os_errors_as_dataset_errors, to_disk
from wafer_viewer.store.io.checksums import (
    MOST_RECORD_BYTES,
    Checksum,
    FileMark,
    damaged,
    file_mark,
    line_state,
    lines_are_good,
    save_json,
    sealed_line,
    strip_checksum,
    text_state,
)
from wafer_viewer.store.io.format_version import RECORD, SCHEMA, is_compressed, require_readable, version_of
from wafer_viewer.store.io.guarded_reading import read_content

FRAMES, JOURNAL, RESULTS = "frames", "journal.jsonl", "results"
FLAT_FIELD = "flat-field.json"
"""Flat field that the calibration names; absent without one."""


_SAME_OVERLAP, _OVERLAP_DIGITS = 1e-9, 4
"""Rounding error of an overlap, and digits with which people give one."""
_MOST_OVERLAP = 0.5
"""Largest overlap from which an import makes up positions."""


class ScanRecord(Spec, frozen=True, kw_only=True):
    """Plan, job, rig, calibration, program version and format version.

    schema_version: format version, even when frame files may be compressed; bits: 8, or up to 16 stored in 16; taken:
    start of the scan, ISO 8601; positioners: positions of light, objective, zoom, tilts and rotation at its start, as
    far as they are motorised; imported_from: source of imported images, empty for a scan; frame_tag_checksums: CRC-32C
    of all bytes outside the pages in the file of each field, in the order of the fields.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    schema_version: int = version_of(SCHEMA, compressed=False)
    software_version: str
    taken: str
    rig: str = ""
    simulated: bool = False
    imported_from: str = ""
    bits: Annotated[int, Within(8, 16)] = 8
    setup: OpticalSetup = OpticalSetup()
    positioners: tuple[PositionerReading, ...] = ()
    calibration: Calibration | None = None
    job: Job
    plan: ScanPlan
    frame_tag_checksums: tuple[int, ...] = ()

    @property
    def is_compressed(self) -> bool:
        """True if frame files may be compressed."""
        return is_compressed(self.schema_version)

    @property
    def n_exposures(self) -> int:
        """Number of frames at each z."""
        return len(self.plan.exposures_us)

    def pages(self, field: Field) -> PageShape:
        """Return the page layout of the frame file of a field."""
        plan = self.plan
        return PageShape(plan.sweep.frames_of(field) * self.n_exposures, plan.rows, plan.cols, self.bits)

    def with_window(self, window: WindowChanged) -> ScanRecord:
        """Return the record with another z window of a field, which then has another frame file."""
        fields = tuple(
            msgspec.structs.replace(field, z_start_um=window.z_start_um, n_frames=window.n_frames)
            if field.number == window.field
            else field
            for field in self.plan.fields
        )
        tags = {**self.tags_crc32c(), window.field: window.tags_crc32c}
        checksums = tuple(tags[field.number] for field in fields) if self.frame_tag_checksums else ()
        plan = msgspec.structs.replace(self.plan, fields=fields)
        return msgspec.structs.replace(self, plan=plan, frame_tag_checksums=checksums)

    @property
    def pixel_um(self) -> float:
        """Calibrated pixel size in um if there is one, otherwise that of the plan."""
        return self.plan.pixel_um if self.calibration is None else self.calibration.pixel_um

    @property
    def assumed_overlap(self) -> float | None:
        """Overlap (fraction) from which an import made up the positions of its fields; None where they were stated.

        They were made up where all lie exactly on a grid from (0, 0) with one overlap along both axes, of a whole
        number of hundredths of a percent.
        """
        width_um, height_um = self.plan.cols * self.plan.pixel_um, self.plan.rows * self.plan.pixel_um
        along_rows = [(field.col * width_um, field.x_um) for field in self.plan.fields]
        along_cols = [(field.row * height_um, -field.y_um) for field in self.plan.fields]
        lengths = along_rows + along_cols
        overlaps = [1 - at_um / full_um for full_um, at_um in lengths if full_um]
        if not self.imported_from or not overlaps or any(at_um for full_um, at_um in lengths if not full_um):
            return None
        given = round(overlaps[0], _OVERLAP_DIGITS)
        same = all(abs(overlap - given) < _SAME_OVERLAP for overlap in overlaps)
        return given if same and 0 <= given <= _MOST_OVERLAP else None

    @property
    def z_scale(self) -> float:
        """Factor from stage z to calibrated length; 1 without a calibration."""
        return 1.0 if self.calibration is None else self.calibration.z_scale

    def calibration_problem(self, today: str) -> str | None:
        """Return why lengths are uncalibrated, or None if calibrated. `today`: ISO 8601 date."""
        if self.calibration is None:
            return "what was imported carries no calibration" if self.imported_from else "the rig had no calibration"
        return self.calibration.problem(self.setup, today)

    def tags_crc32c(self) -> dict[int, int]:
        """Return the CRC-32C of the bytes outside the pages, by field number; datasets of schema 1 may have none."""
        return dict(zip((field.number for field in self.plan.fields), self.frame_tag_checksums, strict=False))

    def page_of(self, k: int, exposure: int) -> int:
        """Return the page number of a slot in the file of its field."""
        return k * self.n_exposures + exposure


def frames_file(folder: Path, field: Field) -> Path:
    """Return the path of a field's frame file."""
    return folder / FRAMES / f"{field.name}.tif"


def write_record(folder: Path, record: ScanRecord) -> None:
    """Write ``scan.json``, which makes the folder a dataset."""
    save_json(folder / RECORD, record)


def read_record(folder: Path) -> ScanRecord:
    """Read ``scan.json``; an unchanged large one is read once per process, as each task of a worker opens its dataset.

    Raises DatasetError when the folder is no dataset or has a newer format.
    """
    path = folder / RECORD
    if path.is_file() and path.stat().st_size >= _LARGE_BYTES:
        return _large_record(folder, file_mark(path))
    return _record(folder)


@lru_cache(maxsize=2)
def _large_record(folder: Path, mark: FileMark) -> ScanRecord:
    """Return the record in a state of its file."""
    return _record(folder)


def _record(folder: Path) -> ScanRecord:
    text = _record_text(folder)
    if text_state(text) is Checksum.DAMAGED:
        raise damaged(folder / RECORD)
    require_readable(folder, _schema_version(text))
    return decode(strip_checksum(text), ScanRecord, str(folder / RECORD), "json")


def _record_text(folder: Path) -> bytes:
    if not folder.exists():
        raise DatasetError(f"{folder} does not exist: check the path.")
    if not (folder / RECORD).is_file():
        raise DatasetError(f"{folder} is not a dataset, it has no {RECORD}: import images into one first.")
    return read_content(folder / RECORD, most=MOST_RECORD_BYTES)


class _Version(msgspec.Struct):
    schema_version: int


def _schema_version(text: bytes) -> int:
    """Return the format version, so that another format is not reported as damage; the present one if unreadable."""
    with suppress(DatasetError), parser_errors_as(lambda _: DatasetError("The version cannot be read.")):
        return msgspec.json.decode(text, type=_Version).schema_version
    return version_of(SCHEMA, compressed=False)


class PassBegun(msgspec.Struct, frozen=True, tag="pass_begun", omit_defaults=True):
    """Start of a leg.

    provisional: the frames count only once the pass has ended, and those that are later reported as missed do not.
    Otherwise, as in schema 1, every frame counts at once.
    """

    number: int
    axis: Axis
    n_frames: int
    time: str
    provisional: bool = False


class FrameKept(msgspec.Struct, frozen=True, tag="frame", gc=False):
    """Frame written to its page: slot, trigger pulse, stage position at mid-exposure, checksum of the page."""

    shot: Shot
    pulse_count: int
    x_um: float
    y_um: float
    z_um: float
    exposure_us: float
    device_time_us: int
    crc32: int


class Missed(msgspec.Struct, frozen=True, tag="missed", omit_defaults=True):
    """Slot without a frame, or rejected frame of the current pass, with the reason.

    voids: the frame that the slot had since an earlier pass does not count any more, either.
    """

    shot: Shot
    pulse_count: int
    why: str
    voids: bool = False


class Repaired(msgspec.Struct, frozen=True, tag="repaired"):
    """Slot that was empty and now has its frame."""

    shot: Shot


class PassEnded(msgspec.Struct, frozen=True, tag="pass_ended", omit_defaults=True):
    """End of a leg, with the counts of the pulse box; before: SHA-256 of all bytes before the line, hex."""

    number: int
    summary: PulseSummary
    time: str
    before: str = ""


class FaultNoted(msgspec.Struct, frozen=True, tag="fault"):
    """Fault report for the operator."""

    what: str
    time: str


class FocusAtEnd(msgspec.Struct, frozen=True, tag="focus_at_end"):
    """Field with heights in focus at the lowest or the highest frame of its window."""

    field: int
    low: bool
    high: bool


class WindowChanged(msgspec.Struct, frozen=True, tag="window_changed"):
    """Another z window of a field, which is taken again: its earlier frames do not count.

    n_frames: None for the whole sweep; tags_crc32c: CRC-32C of all bytes outside the pages of its new file.
    """

    field: int
    z_start_um: float
    n_frames: int | None
    tags_crc32c: int
    time: str


class Finished(msgspec.Struct, frozen=True, tag="finished"):
    """End of the scan; slots that are empty now stay empty."""

    time: str


class Held(msgspec.Struct, frozen=True, tag="held"):
    """Frames that are not to be removed, however old they are."""

    by: str
    why: str
    time: str


class HoldEnded(msgspec.Struct, frozen=True, tag="hold_ended"):
    """End of a hold."""

    by: str
    why: str
    time: str


class FramesRemoved(msgspec.Struct, frozen=True, tag="frames_removed"):
    """Removal of all frames of an accepted scan after a number of days; from this line on their files may be gone."""

    by: str
    why: str
    days: int
    n_files: int
    n_bytes: int
    time: str

    def sentence(self, name: str) -> str:
        """Return what is said of a dataset whose frames were removed."""
        why = f" ({self.why})" if self.why else ""
        return f"The frames of {name} were removed by {self.by} on {self.time[:10]}, after {self.days} days{why}."


RetentionLine = Held | HoldEnded | FramesRemoved
Line = (
    PassBegun
    | FrameKept
    | Missed
    | Repaired
    | PassEnded
    | FaultNoted
    | FocusAtEnd
    | WindowChanged
    | Finished
    | RetentionLine
)
_WAITED_FOR = PassBegun | PassEnded | WindowChanged | Finished
"""Lines that are on the disk before the next one is written, as everything before them."""
_DECODER = msgspec.json.Decoder(Line)
_DAMAGE = (msgspec.DecodeError, ValueError, RecursionError)
_LARGE_BYTES = 1 << 22
"""Size from which a record takes 50 ms and more to decode."""
_BATCH_BYTES = 1 << 24
"""Part of a journal in memory, far longer than a line."""


class JournalReader:
    """Incremental reader, which can follow a growing journal."""

    def __init__(self, path: Path) -> None:
        self._path, self._offset, self._number = path, 0, 0
        self._digest = _FileDigest(path)
        self._in_pass = False
        """Whether the frames of the lines before the next one count only once their pass has ended."""

    @property
    def n_bytes(self) -> int:
        """Bytes that were read."""
        return self._offset

    @property
    def n_lines(self) -> int:
        """Lines that were read."""
        return self._number

    def skip(self, n_bytes: int, n_lines: int) -> None:
        """Continue after lines that are known."""
        self._offset, self._number = n_bytes, n_lines

    def new_lines(self) -> Iterator[Line]:
        """Yield the complete lines added since the last call. Raises DatasetError when one is damaged."""
        while text := self._new_text():
            lines = _decoded_lines(text)
            if lines is None:
                if not (yield from self._line_by_line(text)):
                    return
                continue
            for one, line in zip(text.split(b"\n"), lines, strict=False):
                self._follow(line)
                self._offset += len(one) + 1
                self._number += 1
                yield line

    def _line_by_line(self, text: bytes) -> Generator[Line, None, bool]:
        """Yield lines one by one; return whether all of them were complete."""
        for one in text.split(b"\n")[:-1]:
            line = self._decode(one)
            if line is None:
                return False
            self._follow(line)
            self._offset += len(one) + 1
            self._number += 1
            yield line
        return True

    def _follow(self, line: Line) -> None:
        """Note what the next line says; the end of a pass has the digest of all lines before it."""
        if isinstance(line, PassBegun):
            self._in_pass = line.provisional
        elif isinstance(line, PassEnded):
            self._in_pass = False
            if line.before and line.before != self._digest.up_to(self._offset):
                raise DatasetError(
                    f"{self._path} was altered before line {self._number + 1}, which has another digest of the lines "
                    "before it: restore it from a copy."
                )

    def _new_text(self) -> bytes:
        """Return the next complete lines, of about `_BATCH_BYTES` together."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._offset)
                text = file.read(_BATCH_BYTES)
        except OSError as fault:
            raise DatasetError(f"{self._path} cannot be read: {fault.strerror}.") from fault
        return text[: text.rfind(b"\n") + 1]

    def _decode(self, text: bytes) -> Line | None:
        try:
            return _decoded(text)
        except _DAMAGE as fault:
            if self._offset + len(text) + 1 >= self._path.stat().st_size or (self._in_pass and self._never_ends()):
                return None
            raise DatasetError(
                f"{self._path} is damaged in line {self._number + 1}: restore it from a copy, "
                "or delete that line and those after it and scan the rest again."
            ) from fault

    def _never_ends(self) -> bool:
        """Return whether nothing that is waited for, so that all before it is on the disk, follows in the journal."""
        text = self._path.read_bytes()[self._offset :]
        return not any(isinstance(line, _WAITED_FOR) for line in _readable(text.split(b"\n")))


class _FileDigest:
    """SHA-256 of the first bytes of a growing file."""

    def __init__(self, path: Path) -> None:
        self._path, self._n_bytes, self._sha256 = path, 0, hashlib.sha256()

    def up_to(self, n_bytes: int) -> str:
        """Return the digest of more bytes than before, hex."""
        with self._path.open("rb") as file:
            file.seek(self._n_bytes)
            while self._n_bytes < n_bytes and (piece := file.read(min(_BATCH_BYTES, n_bytes - self._n_bytes))):
                self._sha256.update(piece)
                self._n_bytes += len(piece)
        return self._sha256.hexdigest()


def _readable(lines: Iterable[bytes]) -> Iterator[Line]:
    """Yield the lines that are not damaged."""
    for line in lines:
        with suppress(*_DAMAGE):
            yield _decoded(line)


class JournalWriter:
    """Appends lines, each with one write; what a power cut left behind the first `n_bytes` is truncated first.

    n_bytes: None for all but a torn last line.
    """

    def __init__(self, path: Path, n_bytes: int | None = None) -> None:
        self._path = path
        with os_errors_as_dataset_errors(path):
            path.touch()
            end = _end_of_complete_lines(path) if n_bytes is None else n_bytes
            if path.stat().st_size > end:
                os.truncate(path, end)
                to_disk(path)
            self._file = path.open("ab", buffering=0)
        self._digest = _FileDigest(path)

    def write(self, line: Line) -> None:
        """Append a line. Raises DatasetError when it cannot be written."""
        text = sealed_line(msgspec.json.encode(line)) + b"\n"
        with os_errors_as_dataset_errors(self._path):
            if self._file.write(text) != len(text):
                raise DatasetError(f"{self._path} cannot be written: the disk is full: free some space.")

    def sha256(self) -> str:
        """Return the digest of all bytes, hex."""
        return self._digest.up_to(self._path.stat().st_size)

    def to_disk(self) -> None:
        """Wait until all lines are on the disk."""
        with os_errors_as_dataset_errors(self._path):
            flush(self._file.fileno())

    def close(self) -> None:
        """Close the file; idempotent."""
        self._file.close()


def _decoded_lines(text: bytes) -> list[Line] | None:
    """Decode complete lines together, in half the time; None if one is damaged or unsealed."""
    lines = text.split(b"\n")[:-1]
    if not lines_are_good(lines):
        return None
    try:
        decoded = _DECODER.decode_lines(text)
    except _DAMAGE:
        return None
    return decoded if len(decoded) == len(lines) else None


def _decoded(text: bytes) -> Line:
    """Decode a line. Raises ValueError when it is damaged."""
    if line_state(text) is Checksum.DAMAGED:
        raise ValueError("its checksum differs")
    return _DECODER.decode(text)


def _end_of_complete_lines(path: Path) -> int:
    """Return the end offset of the last complete and readable line."""
    text = path.read_bytes()
    end = text.rfind(b"\n") + 1
    begin = text.rfind(b"\n", 0, max(0, end - 1)) + 1
    try:
        _decoded(text[begin:end].rstrip(b"\n"))
    except _DAMAGE:
        return begin
    return end
