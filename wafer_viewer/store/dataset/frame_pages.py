"""Frame file of a field: a multi-page TIFF, page = k * n_exposures + exposure.

During a scan it is uncompressed and preallocated, with contiguous pages that are written and mapped by their offset.
Any TIFF reader opens it. Room is left for the OME-XML that describes the frames once the scan has ended. A file may
be compressed later.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import FileMark, closing_bytes, crc32c, crc_of_file, file_mark, remedy
from wafer_viewer.store.io.guarded_reading import opened_tiff

_UM_PER_CM = 1e4
_CLOSING_BYTES = 4
_CLASSIC_BYTES = 2**32 - 2**25
"""Size in bytes above which a file is a BigTIFF, with a margin for its tags."""


@dataclass(frozen=True, slots=True)
class Codec:
    """Lossless compression of pages: its code in a TIFF file and the arguments of tifffile that select it."""

    code: int
    arguments: dict[str, Any]


CODECS = {
    "none": Codec(0, {}),
    "zstd": Codec(50000, {"compression": "zstd", "compressionargs": {"level": 1}, "predictor": True}),
    "deflate": Codec(8, {"compression": "zlib", "compressionargs": {"level": 6}, "predictor": True}),
    "jpeg2000": Codec(34712, {"compression": "jpeg2000", "compressionargs": {"level": 0, "reversible": True}}),
}
"""All of them are read by tifffile and Bio-Formats; deflate by nearly every program."""


@dataclass(frozen=True, slots=True)
class PageShape:
    """Number, shape and bit depth of the pages in each frame file of a dataset."""

    n_pages: int
    rows: int
    cols: int
    bits: int

    @property
    def dtype(self) -> np.dtype[Any]:
        """Pixel type, little-endian as all numbers of a dataset."""
        return np.dtype(np.uint8) if self.bits == 8 else np.dtype("<u2")

    @property
    def page_bytes(self) -> int:
        """Size of one page in bytes."""
        return self.rows * self.cols * self.dtype.itemsize

    @property
    def file_bytes(self) -> int:
        """Approximate size of an uncompressed file in bytes: the pages and space for their tags."""
        return self.n_pages * (self.page_bytes + 512) + self.header_bytes

    @property
    def header_bytes(self) -> int:
        """Space in bytes for the image description, which tells the place and the time of every frame."""
        return 8192 + 640 * self.n_pages


def create_pages(path: Path, shape: PageShape, pixel_um: float, text: bytes, crc: int | None = None) -> None:
    """Create the file at its full size with black pages and an image description.

    crc: CRC-32C that the bytes outside the pages are to have; None for any. Raises DatasetError when the file cannot be
    written.
    """
    import tifffile

    with os_errors_as_dataset_errors(path):
        tifffile.imwrite(
            path,
            shape=(shape.n_pages, shape.rows, shape.cols),
            dtype=shape.dtype,
            description=" " * shape.header_bytes,
            **_tags(pixel_um),
        )
        _allocate(path)
    _write_text(path, shape, _layout(path, shape), text, crc)


def _tags(pixel_um: float) -> dict[str, Any]:
    """Return the tags that every frame file has, as arguments of tifffile."""
    return {
        "byteorder": "<",
        "photometric": "minisblack",
        "metadata": None,
        "resolution": (_UM_PER_CM / pixel_um, _UM_PER_CM / pixel_um),
        "resolutionunit": "CENTIMETER",
    }


def write_header(path: Path, shape: PageShape, text: bytes, crc: int | None = None) -> bool:
    """Replace the image description of an uncompressed file, with a single write that touches no page.

    Parameters
    ----------
    path
        The frame file.
    shape
        Its pages.
    text
        The new description, ASCII or UTF-8.
    crc
        CRC-32C of the bytes outside the pages, which stays the same: four unused bytes behind the text are chosen for
        it. None leaves them 0.

    Returns
    -------
    bool
        False, with nothing written, when the file is compressed, is damaged, or has no room for the text.

    Raises
    ------
    DatasetError
        When the file cannot be read or written.
    """
    layout = _layout(path, shape)
    fits = layout.text_at + shape.header_bytes <= layout.begin and len(text) < shape.header_bytes - _CLOSING_BYTES
    if layout.compression or not fits or crc not in (None, tags_crc32c(path, shape)):
        return False
    _write_text(path, shape, layout, text, crc)
    return True


def _write_text(path: Path, shape: PageShape, layout: _Layout, text: bytes, crc: int | None) -> None:
    """Write the image description and its length at once, with four bytes that give all tags the CRC-32C `crc`."""
    end = layout.text_at + shape.header_bytes
    with path.open("rb") as file:
        head = file.read(layout.begin)
        file.seek(layout.begin + shape.n_pages * shape.page_bytes)
        tail = file.read()
    count = struct.pack("<Q" if layout.is_bigtiff else "<I", len(text) + 1)
    before = head[: layout.count_at] + count + head[layout.count_at + len(count) : layout.text_at]
    before += text.ljust(shape.header_bytes - _CLOSING_BYTES, b"\0")
    closing = bytes(_CLOSING_BYTES) if crc is None else closing_bytes(crc32c(before), head[end:] + tail, crc)
    if (new := before + closing) != head[:end]:
        with os_errors_as_dataset_errors(path), path.open("r+b", buffering=0) as file:
            file.seek(layout.count_at)
            file.write(new[layout.count_at :])


def description_of(path: Path, shape: PageShape) -> str:
    """Return the image description of a frame file. Raises DatasetError as `map_pages` does."""
    return _layout(path, shape).text


class PageWriter:
    """Writer for the pages of one file, by page number."""

    def __init__(self, path: Path, shape: PageShape) -> None:
        layout = _layout(path, shape)
        if layout.compression:
            raise DatasetError(
                f"{path} is compressed: decompress its dataset first (wafer-viewer compress NAME.wafer --codec none)."
            )
        self._path, self._shape, self._begin = path, shape, layout.begin

    def write(self, page: int, image: Image) -> None:
        """Write one page. Raises DatasetError when it cannot be written."""
        data = np.ascontiguousarray(image, self._shape.dtype).data.cast("B")
        with os_errors_as_dataset_errors(self._path), self._path.open("r+b", buffering=0) as file:
            file.seek(self._begin + page * self._shape.page_bytes)
            while data:
                data = data[file.write(data) :]


def map_pages(path: Path, shape: PageShape) -> Image:
    """Return all pages as one read-only array [page, row, col], memory-mapped unless the file is compressed.

    The pages of a compressed file are decoded into memory; those of the file that was read last stay there.

    Raises DatasetError when the file is missing, shorter than its pages, has an unexpected layout or cannot be decoded.
    """
    layout = _layout(path, shape)
    if layout.compression:
        return _decoded.pages(path, shape)
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_ino != layout.inode:  # it was compressed meanwhile
            return map_pages(path, shape)
        return np.memmap(file, shape.dtype, "r", layout.begin, (shape.n_pages, shape.rows, shape.cols))


def decode_pages(path: Path, shape: PageShape) -> Image:
    """Return the pages of a compressed file, decoded on all cores. Raises DatasetError when one cannot be decoded."""
    damaged = DatasetError(f"{path} is damaged, a frame of it cannot be decoded: {remedy(path)}.")
    with parser_errors_as(lambda _: damaged), opened_tiff(path) as file:
        if any(page.shape != (shape.rows, shape.cols) or page.dtype != shape.dtype for page in file.pages):
            raise damaged
        pages = file.asarray(key=range(shape.n_pages), maxworkers=os.cpu_count())
        pages = np.ascontiguousarray(pages, shape.dtype).reshape(shape.n_pages, shape.rows, shape.cols)
    pages.flags.writeable = False
    return pages


class _LastDecoded:
    """Pages of the compressed file that was read last, for readers that want one frame after another."""

    def __init__(self) -> None:
        self._last: tuple[FileMark, Image] | None = None

    def pages(self, path: Path, shape: PageShape) -> Image:
        mark, last = file_mark(path), self._last
        if last is not None and last[0] == mark:
            return last[1]
        self._last = last = None  # two stacks would take twice the memory
        pages = decode_pages(path, shape)
        self._last = mark, pages
        return pages


_decoded = _LastDecoded()


def compression_of(path: Path, shape: PageShape) -> str:
    """Return the name of the compression of a frame file, or "none". Raises DatasetError as `map_pages` does."""
    codes = {codec.code: name for name, codec in CODECS.items()}
    code = _layout(path, shape).compression
    return codes.get(code, f"TIFF compression {code}")


def write_compressed(
    path: Path, parts: Iterable[Image], shape: PageShape, codec: str, pixel_um: float, text: bytes
) -> None:
    """Write all pages, a few at a time, into a new compressed file with an image description.

    Raises DatasetError when it cannot be written.
    """
    import tifffile

    tags = _tags(pixel_um)
    is_bigtiff = shape.file_bytes > _CLASSIC_BYTES
    with (
        os_errors_as_dataset_errors(path),
        tifffile.TiffWriter(path, byteorder=tags.pop("byteorder"), bigtiff=is_bigtiff) as file,
    ):
        for n, part in enumerate(parts):
            tags["description"] = None if n else text
            file.write(part, rowsperstrip=shape.rows, maxworkers=os.cpu_count(), **CODECS[codec].arguments, **tags)


def close_file(path: Path, crc: int) -> None:
    """Append four bytes to a compressed file, which make `crc` the CRC-32C of all its bytes."""
    with os_errors_as_dataset_errors(path), path.open("ab") as file:
        file.write(closing_bytes(crc_of_file(path, path.stat().st_size), b"", crc))


def tags_crc32c(path: Path, shape: PageShape) -> int:
    """Return the CRC-32C of all bytes of a file except uncompressed pages. Raises DatasetError as `map_pages` does."""
    layout = _layout(path, shape)
    if layout.compression:
        return crc_of_file(path, path.stat().st_size)
    with path.open("rb") as file:
        crc = crc32c(file.read(layout.begin))
        file.seek(layout.begin + shape.n_pages * shape.page_bytes)
        return crc32c(file.read(), crc)


@dataclass(frozen=True, slots=True)
class _Layout:
    """Layout of a frame file: offsets in bytes of the first page, of the description and of its length.

    compression: TIFF code, 0 for none; inode: the file that was read, which another one may have replaced since.
    """

    begin: int
    compression: int
    text: str
    text_at: int
    count_at: int
    is_bigtiff: bool
    inode: int


def _layout(path: Path, shape: PageShape) -> _Layout:
    """Return the layout of a file, after a check of the tags that rejects foreign files."""
    with parser_errors_as(partial(_unreadable, path)), opened_tiff(path) as file:
        first = file.pages.first
        code = int(first.compression)
        compression = code if code > 1 else 0
        begin, as_expected = first.dataoffsets[0], first.shape == (shape.rows, shape.cols)
        as_expected &= first.dtype == shape.dtype and (not compression or len(file.pages) == shape.n_pages)
        text = first.tags.get("ImageDescription")
        text_at, count_at = (text.valueoffset, text.offset + 4) if text is not None else (begin, 0)
        inode = os.fstat(file.filehandle.fileno()).st_ino
        found = _Layout(begin, compression, first.description, text_at, count_at, file.is_bigtiff, inode)
    short = not found.compression and path.stat().st_size < begin + shape.n_pages * shape.page_bytes
    if not as_expected or short:
        raise DatasetError(
            f"{path} does not hold {shape.n_pages} pages of {shape.cols} x {shape.rows} px "
            f"with {shape.bits} bits, as scan.json says: {remedy(path)}."
        )
    return found


def _unreadable(path: Path, fault: Exception) -> DatasetError:
    if isinstance(fault, FileNotFoundError):
        return DatasetError(f"{path} is missing: {remedy(path)}.")
    return DatasetError(f"{path} cannot be read as a TIFF file: {remedy(path)}.")


def _allocate(path: Path) -> None:
    """Allocate the disk space, so that the disk cannot fill up during a scan."""
    if not hasattr(os, "posix_fallocate"):
        return
    with path.open("r+b") as file:
        os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
