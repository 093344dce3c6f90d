"""Thumbnails of images, folders and datasets, made without reading large files."""

from __future__ import annotations

import io
import math
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.image_formats import TIFF
from wafer_viewer.store.images.image_files import (
    READERS,
    as_grey,
    damaged,
    format_of,
    image_files,
    planes_of,
    webp_shape,
)
from wafer_viewer.store.io.guarded_reading import opened_tiff, tiff_page

SIDE_PX = 96
"""Longer side of a preview in px: twice the displayed size, for high-density screens."""
JPEG_QUALITY = 80
MAX_FILE_BYTES = 64_000_000
MAX_TIFF_BYTES = 4_000_000_000
"""Largest TIFF in bytes; only one page of it is read."""
MAX_PIXELS = 40_000_000
STRETCH_PERCENT = 0.5, 99.5
"""Percentiles that are stretched to the full grey range, so that dark images are readable at this size."""


def preview(path: Path) -> bytes:
    """Return a thumbnail of a file or folder as JPEG; empty bytes if there is none.

    Parameters
    ----------
    path : Path
        An image, a multi-page TIFF, a folder of images, or a dataset NAME.wafer.
    """
    with suppress(DatasetError), parser_errors_as(partial(damaged, path.name)):
        if (image := _image_of(path)) is not None:
            return thumbnail_jpeg(image)
    return b""


def _image_of(path: Path) -> NDArray[Any] | None:
    if path.name.endswith(DATASET_ENDING) and path.is_dir():
        return _of_dataset(path)
    if path.is_dir():
        files = image_files(path)
        path = files[len(files) // 2]
    kind, ending = format_of(path), path.suffix.lower()
    if kind is TIFF:
        return _middle_page(path)
    if kind is None or kind.planes is None or path.stat().st_size > MAX_FILE_BYTES:
        return None
    if ending in READERS:
        return as_grey(READERS[ending](path), path.name) if _n_pixels(path) <= MAX_PIXELS else None
    planes = planes_of(path)
    return planes[len(planes) // 2].read()


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
            return math.prod(webp_shape(file.read(32)))
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


def thumbnail_jpeg(values: NDArray[Any]) -> bytes:
    """Return an image [row, col] as a JPEG of at most `SIDE_PX`, its contrast stretched; empty if it has no value."""
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
