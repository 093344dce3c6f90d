"""OME-TIFF with pyramids, as image viewers open large pictures: tiles, and levels as SubIFDs, each half the one before.

A level is made while the one below it is written, on disk, so that no image is ever completely in memory.
"""

from __future__ import annotations

import html
import json
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.region import Region
from wafer_viewer.store.formats.reader_support import about, caveats
from wafer_viewer.store.formats.surface_strips import Strips

if TYPE_CHECKING:
    from tifffile import TiffWriter

Bands = Iterable[NDArray[Any]]
"""Rows of an image from the top edge down, some at a time."""
TILE_PX = 256
COARSEST_PX = 512
"""Largest longer side of the coarsest level."""
_CLASSIC_BYTES = 3_500_000_000
"""Size of all images up to which a file has no need of BigTIFF."""
_UM_PER_CM = 1e4
_FACTS = re.compile(r'<M K="wafer_viewer">(.*?)</M>', re.DOTALL)


@dataclass(frozen=True, slots=True)
class PyramidImage:
    """One image of a file."""

    name: str
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    bands: Bands


@dataclass(frozen=True, slots=True)
class PyramidHeader:
    """Text and place of the images of a file: pixel size and centre in um on the stage, and machine-readable facts."""

    pixel_um: float
    x_um: float
    y_um: float
    description: str
    facts: str


def write_ome_tiff(strips: Strips, path: Path) -> None:
    """Write z_um as 32-bit floats, NaN where unmeasured, and the all-in-focus image, each with a pyramid."""
    surface, (rows, cols) = strips.surface, strips.shape
    corner = surface.window(Region.point(surface.x0_um, surface.y0_um))
    layers = {"z_um": np.dtype("<f4"), "all_in_focus": corner.all_in_focus.dtype}
    images = [
        PyramidImage(name, strips.shape, dtype, strips.layer(name, part, len(layers)))
        for part, (name, dtype) in enumerate(layers.items())
    ]
    centre_um = (
        surface.x0_um + (cols - 1) / 2 * strips.pixel_um,
        surface.y0_um - (rows - 1) / 2 * strips.pixel_um,
    )
    text = ". ".join(caveats(surface.provenance))
    write_pyramids(path, images, PyramidHeader(strips.pixel_um, *centre_um, text and f"{text}.", about(strips)))


def facts_of(ome_xml: str) -> dict[str, Any]:
    """Return the machine-readable facts that `write_pyramids` has put into the OME-XML; empty without."""
    found = _FACTS.search(ome_xml)
    try:
        facts: Any = json.loads(html.unescape(found[1])) if found else {}
    except ValueError:
        return {}
    return facts if isinstance(facts, dict) else {}


def write_pyramids(path: Path, images: Sequence[PyramidImage], header: PyramidHeader) -> None:
    """Write images of one pixel size, one after the other, each with its levels."""
    import tifffile

    n_bytes = sum(np.prod(image.shape, dtype=np.int64) * image.dtype.itemsize for image in images)
    with tifffile.TiffWriter(path, bigtiff=bool(n_bytes > _CLASSIC_BYTES), ome=True) as file:
        for image in images:
            _write_image(file, image, header, path.parent)


def write_picture(path: Path, image: PyramidImage, header: PyramidHeader, *, with_levels: bool) -> None:
    """Write a single image: with levels as OME-TIFF, without as a plain TIFF with its pixel size and facts as JSON."""
    import tifffile

    if with_levels:
        write_pyramids(path, [image], header)
        return
    per_cm = _UM_PER_CM / header.pixel_um
    n_bytes = int(np.prod(image.shape, dtype=np.int64)) * image.dtype.itemsize
    tifffile.imwrite(
        path,
        _tiles(image.bands, image.shape[1], image.dtype),
        shape=image.shape,
        dtype=image.dtype,
        tile=(TILE_PX, TILE_PX),
        bigtiff=n_bytes > _CLASSIC_BYTES,
        photometric="minisblack",
        compression="zlib",
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
        description=header.facts,
        metadata=None,
    )


def _write_image(file: TiffWriter, image: PyramidImage, header: PyramidHeader, folder: Path) -> None:
    shapes = _shapes(image.shape)
    bands = image.bands
    metadata = {
        "axes": "YX",
        "Name": image.name,
        "Description": header.description,
        "PhysicalSizeX": header.pixel_um,
        "PhysicalSizeY": header.pixel_um,
        "Plane": {"PositionX": header.x_um, "PositionXUnit": "µm", "PositionY": header.y_um, "PositionYUnit": "µm"},
        "MapAnnotation": {"Namespace": "wafer_viewer", "wafer_viewer": header.facts},
    }
    for level, shape in enumerate(shapes):
        per_cm = _UM_PER_CM / (header.pixel_um * 2**level)
        with tempfile.TemporaryFile(dir=folder) as coarser:
            file.write(
                _tiles(_halving(bands, coarser), shape[1], image.dtype),
                shape=shape,
                dtype=image.dtype,
                tile=(TILE_PX, TILE_PX),
                photometric="minisblack",
                compression="zlib",
                subifds=len(shapes) - 1 if level == 0 else None,
                subfiletype=1 if level else 0,
                resolution=(per_cm, per_cm),
                resolutionunit="CENTIMETER",
                metadata=metadata if level == 0 else None,
            )
            coarser.flush()
            half: NDArray[Any] = np.memmap(coarser, image.dtype, "r", shape=_half(shape))
        bands = (half[top : top + TILE_PX] for top in range(0, len(half), TILE_PX))


def _shapes(shape: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the sizes of all levels."""
    shapes = [shape]
    while max(shapes[-1]) > COARSEST_PX:
        shapes.append(_half(shapes[-1]))
    return shapes


def _half(shape: tuple[int, int]) -> tuple[int, int]:
    return -(-shape[0] // 2), -(-shape[1] // 2)


def _tiles(bands: Bands, cols: int, dtype: np.dtype[Any]) -> Iterator[NDArray[Any]]:
    """Yield the tiles of an image row by row, those at the edges padded with 0."""
    for band in _of_rows(bands, TILE_PX):
        for left in range(0, cols, TILE_PX):
            tile = np.zeros((TILE_PX, TILE_PX), dtype)
            part = band[:, left : left + TILE_PX]
            tile[: part.shape[0], : part.shape[1]] = part
            yield tile


def _halving(bands: Bands, file: IO[bytes]) -> Iterator[NDArray[Any]]:
    """Yield the bands, and write them to a file at half of the resolution."""
    for band in _of_rows(bands, TILE_PX):
        file.write(_halved(band).tobytes())
        yield band


def _of_rows(bands: Bands, n_rows: int) -> Iterator[NDArray[Any]]:
    """Yield bands of that many rows, the last one of the rest."""
    rest: list[NDArray[Any]] = []
    for band in bands:
        rest.append(band)
        if sum(map(len, rest)) >= n_rows:
            joined = np.concatenate(rest)
            whole = len(joined) // n_rows * n_rows
            yield from np.split(joined[:whole], whole // n_rows)
            rest = [joined[whole:]]
    if sum(map(len, rest)):
        yield np.concatenate(rest)


def _halved(band: NDArray[Any]) -> NDArray[Any]:
    """Return means of 2 x 2 pixels, of heights of those that are not NaN; an odd edge is that of its last pixels."""
    rows, cols = band.shape
    even = np.pad(band, ((0, rows % 2), (0, cols % 2)), mode="edge")
    four = np.stack([even[row::2, col::2] for row in (0, 1) for col in (0, 1)])
    if band.dtype.kind != "f":
        return np.rint(four.mean(0)).astype(band.dtype)
    known = np.isfinite(four)
    total, count = np.where(known, four, 0).sum(0, dtype=np.float64), known.sum(0)
    return np.where(count, total / np.maximum(count, 1), np.nan).astype(band.dtype)
