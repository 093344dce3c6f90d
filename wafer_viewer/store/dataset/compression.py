"""Lossless compression of the frames of a dataset, and back.

A file is replaced only by one that is complete, on the disk, and whose frames were read back and compared with their
checksums in the journal. At every moment each field has one readable file, compressed or not, so that a process that is
killed costs nothing but the file it was at. The format version rises before the first file is replaced, so that older
programs name the reason why they cannot open the dataset.
"""

from __future__ import annotations

import zlib
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, silent
from wafer_viewer.store.dataset.frame_pages import (
    CODECS,
    PageShape,
    PageWriter,
    close_file,
    compression_of,
    create_pages,
    description_of,
    map_pages,
    tags_crc32c,
    write_compressed,
    write_header,
)
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.ome_header import ome_xml
from wafer_viewer.store.dataset.scan_record import FRAMES, FrameKept, ScanRecord, frames_file
from wafer_viewer.store.io.atomic_files import atomic_write, remove, require_space
from wafer_viewer.store.io.checksums import remedy
from wafer_viewer.store.io.format_version import set_compressed

_PAGES_AT_ONCE = 16
"""Number of pages that are compressed between two calls of the progress."""


@dataclass(frozen=True, slots=True)
class CompressionReport:
    """Result of `compress`: size of the frame files before and after, and a sentence for each file left as it was."""

    codec: str
    bytes_before: int
    bytes_after: int
    n_changed: int
    left: tuple[str, ...]


class FramesOnDisk(Protocol):
    """Frames of a dataset on disk, with their record and their journal."""

    path: Path
    scan: ScanRecord

    @property
    def fields(self) -> tuple[Field, ...]:
        """Planned fields."""
        ...

    def require_frames(self, what: str) -> None:
        """Raise DatasetError, which begins with `what`, if the frames were removed."""
        ...

    def refresh(self) -> None:
        """Read the journal's new lines."""
        ...

    def journal_lines(self, field: Field) -> list[FrameKept]:
        """Return the journal lines of a field's frames."""
        ...

    def frame_bytes(self) -> int:
        """Return the size of all frame files in bytes."""
        ...


def compress(data: FramesOnDisk, codec: str, progress: Progress, should_stop: ShouldStop) -> CompressionReport:
    """Compress the frames of a dataset without loss, one field after the other.

    Parameters
    ----------
    data
        The dataset, opened for this; no scan may be writing to it.
    codec
        ``"zstd"``, ``"deflate"``, ``"jpeg2000"``, or ``"none"`` to decompress.
    progress, should_stop
        Called with the completed fraction, and polled for a stop request.

    Returns
    -------
    CompressionReport
        Sizes, and the files that were left as they were because a frame in them is damaged.

    Raises
    ------
    DatasetError
        When the codec is unknown, the dataset is being written, the disk is full, or the work is stopped. Fields that
        are done stay so, and all others are as before.
    """
    if codec not in CODECS:
        raise DatasetError(f"There is no codec '{codec}': choose one of {', '.join(CODECS)}.")
    if not (data.path / FRAMES).is_dir():
        raise DatasetError(f"{data.path.name} is a surface without its frames: there is nothing to compress.")
    data.require_frames("There is nothing to compress")
    lock = Lock.take(data.path)
    try:
        data.refresh()
        return _compress(data, codec, progress, should_stop)
    finally:
        lock.release()


def decompress_fields(data: FramesOnDisk, fields: Sequence[Field]) -> None:
    """Decompress the files of some fields, so that frames can be written into them; the caller holds the lock."""
    for field in fields:
        if compression_of(frames_file(data.path, field), data.scan.pages(field)) != "none":
            _replace(data, field, "none", silent)


def rewrite_field(data: FramesOnDisk, field: Field) -> None:
    """Write the uncompressed file of a field again from its frames; the caller holds the lock.

    Raises DatasetError when one of them is damaged.
    """
    _replace(data, field, "none", silent)


def write_headers(data: FramesOnDisk, changed: Container[int] = ()) -> None:
    """Write the OME-XML of the fields that have none yet, and of those with changed frames, by number.

    The caller holds the lock. Files without room for it, and damaged ones, are left as they are.
    """
    checksums = data.scan.tags_crc32c()
    for field in data.fields:
        path = frames_file(data.path, field)
        lines = data.journal_lines(field)
        if lines and (field.number in changed or not description_of(path, data.scan.pages(field)).startswith("<?xml")):
            write_header(path, data.scan.pages(field), ome_xml(data.scan, field, lines), checksums.get(field.number))


def _compress(data: FramesOnDisk, codec: str, progress: Progress, should_stop: ShouldStop) -> CompressionReport:
    _remove_partial_files(data.path / FRAMES)
    before = data.frame_bytes()
    pending, left = _pending(data, codec)
    n_done = len(data.fields) - len(pending)
    if codec == "none":
        require_space(data.path, _growth(data, pending), data.path.name)
    elif pending:
        set_compressed(data.path, True)

    def tick(done: float) -> None:
        progress((n_done + done) / len(data.fields))
        if should_stop():
            raise DatasetError(
                f"The compression was stopped at {n_done} of {len(data.fields)} fields, which stay as they are: "
                "start it again to continue."
            )

    n_changed = 0
    for field in pending:
        tick(0.0)
        try:
            _replace(data, field, codec, tick)
            n_changed += 1
        except _DamagedFrames as fault:
            left.append(str(fault))
        n_done += 1
    progress(1.0)
    if codec == "none" and not left:
        write_headers(data)
        set_compressed(data.path, False)
    return CompressionReport(codec, before, data.frame_bytes(), n_changed, tuple(left))


class _DamagedFrames(DatasetError):
    """Frames that differ from their checksums, in a file that is to be replaced."""


def _pending(data: FramesOnDisk, codec: str) -> tuple[list[Field], list[str]]:
    """Return the fields whose files have another compression, and a sentence for each file that cannot be read."""
    pending: list[Field] = []
    left: list[str] = []
    for field in data.fields:
        try:
            if compression_of(frames_file(data.path, field), data.scan.pages(field)) != codec or (
                codec == "none" and not _are_tags_good(data, field)
            ):
                pending.append(field)
        except DatasetError as fault:
            left.append(str(fault))
    return pending, left


def _are_tags_good(data: FramesOnDisk, field: Field) -> bool:
    expected = data.scan.tags_crc32c().get(field.number)
    return expected in (None, tags_crc32c(frames_file(data.path, field), data.scan.pages(field)))


def _growth(data: FramesOnDisk, pending: Sequence[Field]) -> int:
    """Return the free bytes that decompression needs: the growth of all files, and a copy of the largest one."""
    stored = [frames_file(data.path, field).stat().st_size for field in pending]
    return sum(data.scan.pages(field).file_bytes for field in pending) - sum(stored) + max(stored, default=0)


def _replace(data: FramesOnDisk, field: Field, codec: str, tick: Progress) -> None:
    """Replace the file of a field by one with another compression, after a check of every frame in both."""
    path, shape = frames_file(data.path, field), data.scan.pages(field)
    lines = data.journal_lines(field)
    text = ome_xml(data.scan, field, lines) if lines else description_of(path, shape).encode()
    crc = data.scan.tags_crc32c().get(field.number)
    source = _good_pages(data, path, shape, lines)
    with atomic_write(path) as temporary:
        if codec == "none":
            create_pages(temporary, shape, data.scan.pixel_um, text, crc)
            writer = PageWriter(temporary, shape)
            for page, image in _present(data, source, lines):
                writer.write(page, image)
                tick(page / shape.n_pages)
        else:
            parts = _parts(data, source, lines, tick)
            write_compressed(temporary, parts, shape, codec, data.scan.pixel_um, text)
            close_file(temporary, crc if crc is not None else 0)
        del source
        _require_read_back(data, temporary, shape, lines)


def _good_pages(data: FramesOnDisk, path: Path, shape: PageShape, lines: Sequence[FrameKept]) -> Image:
    """Return the pages of a file that is to be replaced. Raises _DamagedFrames when one of them is damaged."""
    try:
        pages = map_pages(path, shape)
    except DatasetError as fault:
        raise _DamagedFrames(str(fault)) from fault
    if (page := _first_damaged(data, pages, lines)) is not None:
        raise _DamagedFrames(f"{path} is left as it is, the checksum of page {page} differs: {remedy(path)}.")
    return pages


def _require_read_back(data: FramesOnDisk, path: Path, shape: PageShape, lines: Sequence[FrameKept]) -> None:
    """Raise DatasetError when a frame of a new file differs from its checksum in the journal."""
    if (page := _first_damaged(data, map_pages(path, shape), lines)) is not None:
        raise DatasetError(
            f"{path} was not replaced: page {page} of the new file reads back differently: check the disk and the "
            "memory of this machine."
        )


def _first_damaged(data: FramesOnDisk, pages: Image, lines: Sequence[FrameKept]) -> int | None:
    """Return the first page that differs from its checksum in the journal, None if there is none."""
    by_page = {data.scan.page_of(line.shot.k, line.shot.exposure): line.crc32 for line in lines}
    return next((page for page, image in _present(data, pages, lines) if zlib.crc32(image.data) != by_page[page]), None)


def _present(data: FramesOnDisk, pages: Image, lines: Sequence[FrameKept]) -> Iterator[tuple[int, Image]]:
    """Yield number and image of every page that has a frame."""
    for page in sorted(data.scan.page_of(line.shot.k, line.shot.exposure) for line in lines):
        yield page, pages[page]


def _parts(data: FramesOnDisk, pages: Image, lines: Sequence[FrameKept], tick: Progress) -> Iterator[Image]:
    """Yield a few pages at a time; those without a frame that counts are black, as in a new file."""
    present = np.zeros(len(pages), bool)
    present[[data.scan.page_of(line.shot.k, line.shot.exposure) for line in lines]] = True
    for first in range(0, len(pages), _PAGES_AT_ONCE):
        tick(first / len(pages))
        part = slice(first, first + _PAGES_AT_ONCE)
        yield np.where(present[part, None, None], pages[part], pages.dtype.type(0))


def _remove_partial_files(folder: Path) -> None:
    """Remove what a killed process left, which nobody reads; the lock says that none is at work."""
    for path in folder.glob(".*.part"):
        remove(path)
