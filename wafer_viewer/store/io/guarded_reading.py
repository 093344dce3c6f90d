"""Guarded reading of files from outside: limits, and the program's own error for whatever a parser raises.

A file may be damaged, of another program or made to do harm. Its readers ask here before they unpack, and run their
parsers under `parser_errors_as`. Limits on plans and on the nesting of settings are in model/spec.py;
limits on messages of browsers in gui/incoming.py. The reference is assets/docs/reference/reading-limits.md.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.store.io.atomic_files import size

if TYPE_CHECKING:
    import tifffile

FACTOR = "WAFER_VIEWER_READ_LIMITS"
"""Environment variable with a factor for the limits of this module."""
MOST_TEXT_BYTES = 256_000_000
"""Largest text that is read at once, in bytes: a KLARF file of three million defects."""
MOST_PIXELS = 178_956_970
"""Largest image in px: the limit of Pillow, above the 151 million of the largest common sensors."""
MOST_PAGES = 100_000
"""Largest number of pages of a TIFF file that is imported."""
FREE_UNPACKED_BYTES = 256_000_000
MOST_UNPACKED_RATIO = 20
"""Compressed arrays may unpack to this many times the size of their file, and to `FREE_UNPACKED_BYTES` in any case.

Heights and images with noise unpack to 1.1 to 3 times, dies that are half unmeasured to 6 times their size.
"""


def limit(most: int) -> int:
    """Return a limit of this module times the factor of the user. Raises DatasetError for an invalid factor."""
    return int(most * _factor(os.environ.get(FACTOR, "1")))


@cache
def _factor(text: str) -> float:
    try:
        factor = float(text)
    except ValueError:
        factor = 0.0
    if not 1 <= factor <= 1000:
        raise DatasetError(f"{FACTOR} is {text!r}: it must be a number between 1 and 1000.")
    return factor


def read_content(path: Path, refuse: type[WaferViewerError] = DatasetError, most: int = MOST_TEXT_BYTES) -> bytes:
    """Return the content of a file that is read at once.

    Raises `refuse` when it does not exist, cannot be read, or has more bytes than `most`.
    """
    try:
        with path.open("rb") as file:
            expected = min(os.fstat(file.fileno()).st_size, limit(most))
            content = file.read(expected + 1)  # a read allocates all that it asks for
            if len(content) > expected:  # the file grows, or is a pipe, which has no size
                content += file.read(limit(most) + 1 - len(content))
    except FileNotFoundError as fault:
        raise refuse(f"{path} cannot be read, it does not exist: check the path.") from fault
    except OSError as fault:
        raise refuse(f"{path} cannot be read: {(fault.strerror or str(fault)).lower()}.") from fault
    if len(content) > limit(most):
        raise refuse(f"{path} has more than {size(limit(most))}, too much for a file of its kind: {MEND}.")
    return content


MEND = f"check what it is, or raise the limits ({FACTOR}, see reading-limits in the reference)"
"""What to do about a file beyond a limit."""


def require_unpacked(name: str | Path, n_bytes: int, unpacked: int) -> None:
    """Raise DatasetError when a compressed file of `n_bytes` states to unpack to far more than good files do."""
    most = max(limit(FREE_UNPACKED_BYTES), limit(MOST_UNPACKED_RATIO) * n_bytes)
    if unpacked > most:
        sizes = f"{size(n_bytes)} and unpacks to {size(unpacked)}, more than {size(most)}"
        raise DatasetError(f"{name} has {sizes}: {MEND}.")


def require_pixels(name: str, rows: int, cols: int) -> None:
    """Raise DatasetError when an image has no pixel, or more than `MOST_PIXELS`."""
    if rows < 1 or cols < 1:
        raise DatasetError(f"{name} states {cols} x {rows} pixels: copy it again.")
    if rows * cols > limit(MOST_PIXELS):
        millions = limit(MOST_PIXELS) / 1e6
        raise DatasetError(f"{name} has {cols} x {rows} pixels, more than {millions:.0f} million: {MEND}.")


@contextmanager
def opened_tiff(path: Path) -> Generator[tifffile.TiffFile]:
    """Open a TIFF file without the warnings of its library on the terminal; run under `parser_errors_as`."""
    import tifffile

    _quieten_tifffile()
    with tifffile.TiffFile(path) as file:
        yield file


def tiff_page(file: tifffile.TiffFile, number: int, name: str) -> tifffile.TiffPage:
    """Return a page of a TIFF after a check of its size. Raises DatasetError beyond the limit."""
    page = file.pages[number].aspage()
    sizes: tuple[Any, ...] = page.imagelength, page.imagewidth, page.imagedepth, page.samplesperpixel
    if not all(isinstance(n, int) for n in sizes):  # a damaged tag has any value
        raise ValueError("a size is no number")
    n_layers = page.imagedepth * -(-page.samplesperpixel // _MOST_SAMPLES)
    require_pixels(name, page.imagelength * n_layers, page.imagewidth)
    return page


_MOST_SAMPLES = 4
"""Samples of a pixel that count once: red, green, blue and transparency."""


@cache
def _quieten_tifffile() -> None:
    """Give the library a handler, so that Python does not print its remarks on every damaged tag."""
    logging.getLogger("tifffile").addHandler(logging.NullHandler())
