"""Image files from other sources: listing, and decoding to grey.

Colour is converted to luminance (Rec. 709 weights on the stored values), 8 and 16 bits are preserved, and files are
sorted in natural order: 2 before 10.
"""

from __future__ import annotations

import importlib
import io
import re
import struct
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.image_source import ImagePlane
from wafer_viewer.model.errors import DatasetError, detail, parser_errors_as
from wafer_viewer.model.image_formats import BY_SUFFIX, IMAGE_FORMATS, READ, ImageFormat, needs_library, why_not_read
from wafer_viewer.model.surface_format import imported
from wafer_viewer.store.io.atomic_files import natural_sort_key, os_errors_as_dataset_errors, size
from wafer_viewer.store.io.guarded_reading import (
    MEND,
    MOST_PAGES,
    limit,
    opened_tiff,
    read_content,
    require_pixels,
    tiff_page,
)

REC_709 = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in luminance, ITU-R BT.709."""
NOTHING_WRITTEN = "Nothing was written."
_PLAIN_PHOTOMETRICS = (1, 2, 6)
"""Grey with black 0, RGB, and YCbCr, which is decoded on reading: TIFF kinds whose values need no conversion."""
Paths = str | Path | Sequence[str | Path]
PlanesOf = Callable[[Path], tuple[ImagePlane, ...]]


def image_files(src: Paths) -> list[Path]:
    """Return the image files of a folder in natural order, or those listed in their order."""
    if not isinstance(src, str | Path):
        return [file for one in src for file in image_files(one)]
    path = Path(src)
    if path.is_dir() and format_of(path) is None:
        return _files_in(path)
    if not path.exists():
        raise DatasetError(f"Import stopped at {path}: it does not exist. {NOTHING_WRITTEN} Check the path.")
    if (kind := format_of(path)) is None or kind.planes is None:
        raise DatasetError(f"{why_not_read(path.name, path.suffix)} {NOTHING_WRITTEN}")
    return [path]


def format_of(path: Path) -> ImageFormat | None:
    """Return the format of a file by its suffix, or of a folder that is one image; None if it is neither."""
    if not path.is_dir():
        return BY_SUFFIX.get(path.suffix.lower())
    return next((one for one in IMAGE_FORMATS for mark in one.marks if (path / mark).is_file()), None)


def planes_of(path: Path) -> tuple[ImagePlane, ...]:
    """Return the planes of an image file, in the format of its suffix.

    Raises DatasetError when the file is damaged, or of a format that is not read.
    """
    kind = format_of(path)
    if kind is None or kind.planes is None:
        raise DatasetError(f"{why_not_read(path.name, path.suffix)} {NOTHING_WRITTEN}")
    if kind.library:
        try:
            importlib.import_module(kind.library)
        except ImportError as fault:
            raise DatasetError(f"{needs_library(path.name, kind)} {NOTHING_WRITTEN}") from fault
    return imported(kind.planes)(path)


def damaged(name: str, fault: Exception | None = None) -> DatasetError:
    """Return the error for a file that is truncated or not an image."""
    why = "" if fault is None else detail(fault)
    return DatasetError(
        f"Import stopped at {name}: it is damaged, or not an image{why}. {NOTHING_WRITTEN} Remove it or copy it again."
    )


def require_planes(name: str, n_planes: int) -> None:
    """Raise DatasetError when a file has more pages or planes than the limit."""
    if n_planes > limit(MOST_PAGES):
        raise DatasetError(
            f"Import stopped at {name}: it has {n_planes} pages, more than {limit(MOST_PAGES)}. {NOTHING_WRITTEN} "
            f"Split it, or {MEND}."
        )


def _files_in(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if not path.name.startswith(".") and _is_read(path)]
    visible = sorted(found, key=lambda path: natural_sort_key(path.name))
    if not visible:
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in BY_SUFFIX:
                raise DatasetError(f"{why_not_read(path.name, path.suffix)} {NOTHING_WRITTEN}")
        raise DatasetError(
            f"Import stopped at {folder}: the folder holds no images. {NOTHING_WRITTEN} "
            f"Give one with {', '.join(READ)} files."
        )
    return visible


def _is_read(path: Path) -> bool:
    kind = format_of(path)
    return kind is not None and kind.planes is not None


_TEXT_BYTES = 1 << 16
"""Bytes at either end of an image file that are searched for texts."""


def texts_of_image(path: Path) -> str:
    """Return what may be texts in an image that is no TIFF; formats have them before the pixels or after them."""
    with os_errors_as_dataset_errors(path), path.open("rb") as file:
        begin = file.read(_TEXT_BYTES)
        file.seek(max(_TEXT_BYTES, path.stat().st_size - _TEXT_BYTES))
        return (begin + file.read()).decode("latin-1")


def read_page(path: Path, page: int, name: str) -> Image:
    """Return one page of a TIFF as grey, upright as its orientation says."""
    with parser_errors_as(partial(damaged, name)), opened_tiff(path) as file:
        one = tiff_page(file, page, name)
        tag = one.tags.get(_ORIENTATION)
        turn = 1 if tag is None else tag.value
        if one.photometric not in _PLAIN_PHOTOMETRICS:
            return as_grey(as_shown(_read_with_pillow(path, page, upright=False), turn), name)
        values, color_first = one.asarray(), one.axes.startswith("S")
        return as_grey(as_shown(np.moveaxis(values, 0, -1) if color_first else values, turn), name)


def read_file(path: Path) -> Image:
    """Return the image of a file as grey, upright as its orientation says."""
    with parser_errors_as(partial(damaged, path.name)):
        return as_grey(READERS[path.suffix.lower()](path), path.name)


def _read_png(path: Path) -> NDArray[Any]:
    """Read a PNG with imagecodecs, because Pillow reduces 16-bit colour PNG to 8 bits."""
    import imagecodecs

    content = read_content(path)
    require_pixels(path.name, *_PNG_SIZE.unpack_from(content)[::-1])
    values = imagecodecs.png_decode(content)
    return as_shown(values, _exif_orientation(content)) if b"eXIf" in content else values


def _exif_orientation(content: bytes) -> int:
    import PIL.Image

    with PIL.Image.open(io.BytesIO(content), formats=("PNG",)) as image:
        return image.getexif().get(_ORIENTATION, 1)


_PNG_SIZE = struct.Struct(">16xII")
"""Columns and rows in the header of a PNG."""


def _read_with_pillow(path: Path, page: int = 0, *, upright: bool = True) -> NDArray[Any]:
    """Read an image with Pillow, as it is to be shown; palettes, CMYK and similar modes are converted to 8-bit RGB."""
    import PIL.Image

    with PIL.Image.open(path) as image:
        image.seek(page)
        require_pixels(path.name, image.height, image.width)
        grey = image.mode in ("L", "I;16", "I;16B", "I;16L")
        values = np.asarray(image if grey else image.convert("RGB"))
        turn = image.getexif().get(_ORIENTATION, 1) if upright else 1
        return as_shown(values, turn)


_ORIENTATION = 0x0112
"""Tag of the orientation in EXIF and TIFF."""


def as_shown(values: NDArray[Any], orientation: object) -> NDArray[Any]:
    """Return an image as its orientation says it is to be shown; 1 to 8 as in EXIF and TIFF, else as it is."""
    match orientation:
        case 2:
            return values[:, ::-1]
        case 3:
            return values[::-1, ::-1]
        case 4:
            return values[::-1]
        case 5:
            return np.swapaxes(values, 0, 1)
        case 6:
            return np.rot90(values, -1)
        case 7:
            return np.swapaxes(values[::-1, ::-1], 0, 1)
        case 8:
            return np.rot90(values)
        case _:
            return values


_WEBP_FREE_PIXELS, _WEBP_PIXELS_PER_BYTE = 6_000_000, 1000
"""Pixels that any WebP may state, and for each of its bytes: a blank lossy one has 580, an unsharp frame 30 to 60."""
_WEBP_ANIMATED = 0x02


def _read_webp(path: Path) -> NDArray[Any]:
    """Read a still WebP; its decoder takes memory for all pixels that are stated as soon as it opens a file."""
    import PIL.Image

    content = read_content(path)
    rows, cols = webp_shape(content)
    require_pixels(path.name, rows, cols)
    if rows * cols > limit(max(_WEBP_FREE_PIXELS, _WEBP_PIXELS_PER_BYTE * len(content))):
        sizes = f"{cols} x {rows} pixels in {size(len(content))}"
        raise DatasetError(f"{path.name} states {sizes}, more than a WebP of that size can hold: {MEND}.")
    if _is_animated(content):
        n_frames = content.count(b"ANMF")
        raise DatasetError(
            f"Import stopped at {path.name}: it is an animation of {n_frames} frames. {NOTHING_WRITTEN} "
            "Save each frame as an image of its own."
        )
    with PIL.Image.open(io.BytesIO(content), formats=("WEBP",)) as image:
        return np.asarray(image.convert("RGB"))


def webp_shape(content: bytes) -> tuple[int, int]:
    """Return rows and columns that the header of a WebP states. Raises ValueError for another file."""
    match content[12:16]:
        case b"VP8X":
            cols, rows = (1 + int.from_bytes(content[at : at + 3], "little") for at in (24, 27))
        case b"VP8L":
            packed = int.from_bytes(content[21:25], "little")
            cols, rows = 1 + (packed & 0x3FFF), 1 + (packed >> 14 & 0x3FFF)
        case b"VP8 ":
            cols, rows = (int.from_bytes(content[at : at + 2], "little") & 0x3FFF for at in (26, 28))
        case _:
            raise ValueError("it has no header of a WebP")
    return rows, cols


def _is_animated(content: bytes) -> bool:
    return content[12:16] == b"VP8X" and bool(content[20] & _WEBP_ANIMATED)


def _read_tiff(path: Path) -> NDArray[Any]:
    return read_page(path, 0, path.name)


READERS: dict[str, Callable[[Path], NDArray[Any]]] = {
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
    ".png": _read_png,
    ".jpg": _read_with_pillow,
    ".jpeg": _read_with_pillow,
    ".bmp": _read_with_pillow,
    ".pgm": _read_with_pillow,
    ".webp": _read_webp,
}
"""Image readers by file suffix."""


def as_grey(values: NDArray[Any], name: str) -> Image:
    """Return the luminance of [row, col] or [row, col, channel] values; a fourth channel (transparency) is ignored.

    Raises DatasetError when the values are neither 8 nor 16 bits.
    """
    if values.dtype.kind not in "bu" or values.dtype.itemsize > 2 or values.ndim not in (2, 3):
        raise DatasetError(
            f"Import stopped at {name}: its values are {values.dtype} of shape {values.shape}. {NOTHING_WRITTEN} "
            "Save it as a grey or colour image of 8 or 16 bits."
        )
    native = values.astype(np.uint8) * np.uint8(255) if values.dtype.kind == "b" else values
    native = native.astype(native.dtype.newbyteorder("="), copy=False)
    if native.ndim == 2:
        return np.ascontiguousarray(native)
    if native.shape[2] < 3:
        return np.ascontiguousarray(native[:, :, 0])
    grey = np.empty(native.shape[:2], native.dtype)
    for top in range(0, len(grey), _ROWS_AT_A_TIME):  # products in double precision take eight bytes per pixel
        rows = slice(top, top + _ROWS_AT_A_TIME)
        grey[rows] = np.rint(native[rows, :, :3] @ REC_709)
    return grey


_ROWS_AT_A_TIME = 256


_STATED = re.compile(r'\bSIMULATED\. |"SIMULATED": ?true|K="simulated">yes<')


def states_simulated(text: str) -> bool:
    """Return whether a text beside an image, such as its description, is that of a simulated frame or picture.

    It may be one of ours, finished or of a scan that was not, or one of ours that another program has quoted.
    """
    return _STATED.search(text) is not None
