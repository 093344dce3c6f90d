"""Frame file of a field: one uncompressed, preallocated multi-page TIFF with contiguous pages.

Any TIFF reader opens it; this program writes and maps the pages by their offset. page = k * n_exposures + exposure.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import crc32c

_UM_PER_CM = 1e4


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
        """Approximate file size in bytes: the pages and space for their tags."""
        return self.n_pages * (self.page_bytes + 512)


def create_pages(path: Path, shape: PageShape, pixel_um: float, description: str) -> None:
    """Create the file at its full size with black pages. Raises DatasetError when it cannot be written."""
    import tifffile

    with os_errors_as_dataset_errors(path):
        tifffile.imwrite(
            path,
            shape=(shape.n_pages, shape.rows, shape.cols),
            dtype=shape.dtype,
            byteorder="<",
            photometric="minisblack",
            metadata=None,
            description=description,
            resolution=(_UM_PER_CM / pixel_um, _UM_PER_CM / pixel_um),
            resolutionunit="CENTIMETER",
        )
        _allocate(path)


class PageWriter:
    """Writer for the pages of one file, by page number."""

    def __init__(self, path: Path, shape: PageShape) -> None:
        self._path, self._shape, self._begin = path, shape, _first_page(path, shape)

    def write(self, page: int, image: Image) -> None:
        """Write one page. Raises DatasetError when it cannot be written."""
        data = np.ascontiguousarray(image, self._shape.dtype).data.cast("B")
        with os_errors_as_dataset_errors(self._path), self._path.open("r+b", buffering=0) as file:
            file.seek(self._begin + page * self._shape.page_bytes)
            while data:
                data = data[file.write(data) :]


def map_pages(path: Path, shape: PageShape) -> Image:
    """Return all pages as one read-only memory-mapped array [page, row, col].

    Raises DatasetError when the file is missing, shorter than its pages, or has an unexpected layout.
    """
    begin = _first_page(path, shape)
    return np.memmap(path, shape.dtype, "r", begin, (shape.n_pages, shape.rows, shape.cols))


def tags_crc32c(path: Path, shape: PageShape) -> int:
    """Return the CRC-32C of all bytes of a file except its pages. Raises DatasetError as `map_pages` does."""
    begin = _first_page(path, shape)
    with path.open("rb") as file:
        crc = crc32c(file.read(begin))
        file.seek(begin + shape.n_pages * shape.page_bytes)
        return crc32c(file.read(), crc)


def _first_page(path: Path, shape: PageShape) -> int:
    """Return the offset of the first page, after a check of the tags that rejects foreign files."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            first = file.pages.first
            begin, as_expected = first.dataoffsets[0], first.shape == (shape.rows, shape.cols)
            as_expected &= first.dtype == shape.dtype and not first.compression > 1
    except FileNotFoundError as fault:
        raise DatasetError(f"{path} is missing: restore it from a copy, or scan its field again.") from fault
    except (tifffile.TiffFileError, OSError, ValueError, IndexError) as fault:
        raise DatasetError(f"{path} cannot be read as a TIFF file: restore it from a copy.") from fault
    if not as_expected or path.stat().st_size < begin + shape.n_pages * shape.page_bytes:
        raise DatasetError(
            f"{path} does not hold {shape.n_pages} uncompressed pages of {shape.cols} x {shape.rows} px "
            f"with {shape.bits} bits, as scan.json says: restore it from a copy."
        )
    return begin


def _allocate(path: Path) -> None:
    """Allocate the disk space, so that the disk cannot fill up during a scan."""
    if not hasattr(os, "posix_fallocate"):
        return
    with path.open("r+b") as file:
        os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
