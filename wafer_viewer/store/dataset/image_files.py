"""Image files from other sources, and thumbnails made without reading large files.

Colour is converted to luminance (Rec. 709 weights on the stored values), 8 and 16 bits are preserved, and files are
sorted in natural order: 2 before 10.
"""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import DatasetError, detail, parser_errors_as
from wafer_viewer.store.dataset.ome_header import states_simulated
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
TIFF_ENDINGS = (".tif", ".tiff")
_PLAIN_PHOTOMETRICS = (1, 2, 6)
"""Grey with black 0, RGB, and YCbCr, which is decoded on reading: TIFF kinds whose values need no conversion."""
Paths = str | Path | Sequence[str | Path]


@dataclass(frozen=True, slots=True)
class ImageFile:
    """One image with a readable name; `read` returns it as grey [row, col], uint8 or uint16.

    simulated: True if its file says that it was not taken of a real sample.
    """

    name: str
    read: Callable[[], Image]
    simulated: bool = False


def pictures(src: Paths) -> list[ImageFile]:
    """Return the images of a folder, a file or a list of files in natural order, all pages of a multi-page TIFF.

    Raises DatasetError when there are none, or a file cannot be read as an image.
    """
    found = [picture for path in image_files(src) for picture in pictures_of(path)]
    if not found:
        raise DatasetError(f"Import stopped: no images were given. {NOTHING_WRITTEN} Name a folder, a file or several.")
    return found


def image_files(src: Paths) -> list[Path]:
    """Return the image files of a folder, or those given, in natural order."""
    if not isinstance(src, str | Path):
        return sorted((file for one in src for file in image_files(one)), key=lambda p: natural_sort_key(str(p)))
    path = Path(src)
    if path.is_dir():
        return _files_in(path)
    if not path.exists():
        raise DatasetError(f"Import stopped at {path}: it does not exist. {NOTHING_WRITTEN} Check the path.")
    if path.suffix.lower() not in READERS:
        raise DatasetError(
            f"Import stopped at {path.name}: it is not an image. {NOTHING_WRITTEN} Take one of {_endings()}."
        )
    return [path]


def damaged(name: str, fault: Exception | None = None) -> DatasetError:
    """Return the error for a file that is truncated or not an image."""
    why = "" if fault is None else detail(fault)
    return DatasetError(
        f"Import stopped at {name}: it is damaged, or not an image{why}. {NOTHING_WRITTEN} Remove it or copy it again."
    )


def _files_in(folder: Path) -> list[Path]:
    found = sorted((p for p in folder.iterdir() if p.suffix.lower() in READERS), key=lambda p: natural_sort_key(p.name))
    visible = [p for p in found if not p.name.startswith(".")]
    if not visible:
        raise DatasetError(
            f"Import stopped at {folder}: the folder holds no images. {NOTHING_WRITTEN} "
            f"Give one with {_endings()} files."
        )
    return visible


def pictures_of(path: Path) -> list[ImageFile]:
    """Return the images of one file: all pages of a TIFF, one image for any other format."""
    if path.suffix.lower() not in TIFF_ENDINGS:
        return [ImageFile(path.name, partial(_read_file, path), states_simulated(_texts_of_image(path)))]
    n_pages, texts = _pages_and_texts(path)
    names = [path.name] if n_pages == 1 else [f"{path.name}, page {k + 1}" for k in range(n_pages)]
    simulated = states_simulated(texts)
    return [ImageFile(name, partial(_read_page, path, k, name), simulated) for k, name in enumerate(names)]


def _pages_and_texts(path: Path) -> tuple[int, str]:
    """Return the number of pages of a TIFF, and the texts of its first page, that of ImageJ included."""
    with parser_errors_as(partial(damaged, path.name)), opened_tiff(path) as file:
        n_pages = len(file.pages)
        if n_pages > limit(MOST_PAGES):
            raise DatasetError(
                f"Import stopped at {path.name}: it has {n_pages} pages, more than {limit(MOST_PAGES)}. "
                f"{NOTHING_WRITTEN} Split it, or {MEND}."
            )
        by_imagej = (file.imagej_metadata or {}).get("Info", "") if n_pages else ""
        return n_pages, f"{file.pages.first.description}\n{by_imagej}" if n_pages else ""


_TEXT_BYTES = 1 << 16
"""Bytes at either end of an image file that are searched for texts."""


def _texts_of_image(path: Path) -> str:
    """Return what may be texts in an image that is no TIFF; formats have them before the pixels or after them."""
    with os_errors_as_dataset_errors(path), path.open("rb") as file:
        begin = file.read(_TEXT_BYTES)
        file.seek(max(_TEXT_BYTES, path.stat().st_size - _TEXT_BYTES))
        return (begin + file.read()).decode("latin-1")


def _read_page(path: Path, page: int, name: str) -> Image:
    with parser_errors_as(partial(damaged, name)), opened_tiff(path) as file:
        one = tiff_page(file, page, name)
        if one.photometric not in _PLAIN_PHOTOMETRICS:
            return as_grey(_read_with_pillow(path, page), name)
        values, color_first = one.asarray(), one.axes.startswith("S")
        return as_grey(np.moveaxis(values, 0, -1) if color_first else values, name)


def _read_file(path: Path) -> Image:
    with parser_errors_as(partial(damaged, path.name)):
        return as_grey(READERS[path.suffix.lower()](path), path.name)


def _read_png(path: Path) -> NDArray[Any]:
    """Read a PNG with imagecodecs, because Pillow reduces 16-bit colour PNG to 8 bits."""
    import imagecodecs

    content = read_content(path)
    require_pixels(path.name, *_PNG_SIZE.unpack_from(content)[::-1])
    return imagecodecs.png_decode(content)


_PNG_SIZE = struct.Struct(">16xII")
"""Columns and rows in the header of a PNG."""


def _read_with_pillow(path: Path, page: int = 0) -> NDArray[Any]:
    """Read an image with Pillow; palettes, CMYK and similar modes are converted to 8-bit RGB."""
    import PIL.Image

    with PIL.Image.open(path) as image:
        image.seek(page)
        require_pixels(path.name, image.height, image.width)
        grey = image.mode in ("L", "I;16", "I;16B", "I;16L")
        return np.asarray(image if grey else image.convert("RGB"))


_WEBP_FREE_PIXELS, _WEBP_PIXELS_PER_BYTE = 6_000_000, 1000
"""Pixels that any WebP may state, and for each of its bytes: a blank lossy one has 580, an unsharp frame 30 to 60."""
_WEBP_ANIMATED = 0x02


def _read_webp(path: Path) -> NDArray[Any]:
    """Read a still WebP; its decoder takes memory for all pixels that are stated as soon as it opens a file."""
    import PIL.Image

    content = read_content(path)
    rows, cols = _webp_shape(content)
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


def _webp_shape(content: bytes) -> tuple[int, int]:
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
    return _read_page(path, 0, path.name)


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


def _endings() -> str:
    return ", ".join(READERS)


SIDE_PX = 96
"""Longer side of a preview in px: twice the displayed size, for high-density screens."""
JPEG_QUALITY = 80
MAX_FILE_BYTES = 64_000_000
MAX_TIFF_BYTES = 4_000_000_000
"""Largest TIFF in bytes; only one page of it is read."""
MAX_PIXELS = 40_000_000
STRETCH_PERCENT = 0.5, 99.5
"""Percentiles that are stretched to the full grey range, so that dark images are readable at this size."""
DATASET_ENDING = ".wafer"


def preview(path: Path) -> bytes:
    """Return a thumbnail of a file or folder as JPEG; empty bytes if there is none.

    Parameters
    ----------
    path : Path
        An image, a multi-page TIFF, a folder of images, or a dataset NAME.wafer.
    """
    with suppress(DatasetError), parser_errors_as(partial(damaged, path.name)):
        if (image := _image_of(path)) is not None:
            return _jpeg(image)
    return b""


def _image_of(path: Path) -> NDArray[Any] | None:
    if path.name.endswith(DATASET_ENDING) and path.is_dir():
        return _of_dataset(path)
    if path.is_dir():
        files = image_files(path)
        path = files[len(files) // 2]
    if not path.is_file():
        return None
    ending = path.suffix.lower()
    if ending in TIFF_ENDINGS:
        return _middle_page(path)
    if ending not in READERS or path.stat().st_size > MAX_FILE_BYTES or _n_pixels(path) > MAX_PIXELS:
        return None
    return as_grey(READERS[ending](path), path.name)


def _middle_page(path: Path) -> NDArray[Any] | None:
    if path.stat().st_size > MAX_TIFF_BYTES:
        return None
    with opened_tiff(path) as file:
        page = tiff_page(file, len(file.pages) // 2, path.name)
        if page.imagewidth * page.imagelength > MAX_PIXELS:
            return None
        values = np.asarray(page.asarray())
    values = np.moveaxis(values, 0, -1) if page.axes.startswith("S") else values
    return values if values.dtype.kind == "f" and values.ndim == 2 else as_grey(values, path.name)


def _n_pixels(path: Path) -> int:
    import PIL.Image

    if path.suffix.lower() == ".webp":
        with path.open("rb") as file:
            return math.prod(_webp_shape(file.read(32)))
    with PIL.Image.open(path) as image:  # reads the header alone
        return image.width * image.height


def _of_dataset(path: Path) -> NDArray[Any] | None:
    """Return the all-in-focus image of the stitched surface, or the middle frame of the first field with frames."""
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic

    dataset = Dataset.open(path)
    for name in dataset.results():
        result = dataset.result(name)
        if result.has_mosaic and isinstance(mosaic := result.mosaic(), ZarrMosaic):
            level = next((n for n in range(mosaic.levels) if _small(mosaic, n)), mosaic.levels - 1)
            rows, cols = mosaic.header.shape_of(level)
            return mosaic.read("all_in_focus", level, slice(0, rows), slice(0, cols))
    for field in dataset.fields:
        frames = sorted({shot.k for shot in dataset.kept() if shot.field == field.number})
        if frames:
            return np.asarray(dataset.stack(field.number, verify=False).images[frames[len(frames) // 2]])
    return None


def _small(mosaic: Any, level: int) -> bool:
    rows, cols = mosaic.header.shape_of(level)
    return max(rows, cols) <= 4 * SIDE_PX


def _jpeg(values: NDArray[Any]) -> bytes:
    from PIL import Image

    step = max(1, max(values.shape) // (4 * SIDE_PX))  # a percentile of all pixels would be slow for no visible gain
    thin = np.asarray(values[::step, ::step], np.float32)
    finite = thin[np.isfinite(thin)]
    if not finite.size:
        return b""
    low, high = (float(v) for v in np.percentile(finite, STRETCH_PERCENT))
    grey = np.nan_to_num((thin - low) / max(high - low, 1e-9)).clip(0, 1) * 255
    picture = Image.fromarray(grey.astype(np.uint8))
    picture.thumbnail((SIDE_PX, SIDE_PX))
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=JPEG_QUALITY)
    return out.getvalue()
