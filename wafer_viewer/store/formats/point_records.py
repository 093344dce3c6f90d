"""Shared functions of the point formats: counting, coordinates, block-wise reading, grey values and units."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.embedded_metadata import EmbeddedMetadata
from wafer_viewer.store.formats.reader_support import UNITS_UM, ReadOptions
from wafer_viewer.store.formats.surface_strips import Strips

AT_A_TIME = 1_000_000
"""Number of points in memory at a time."""
_CUT_OFF = "is cut off: it has fewer points than it says, so copy it again."


def count(strips: Strips, part: int, of: int) -> int:
    """Return the number of pixels with a height."""
    return sum(int(np.isfinite(z_um).sum()) for z_um in strips.layer("z_um", part, of))


def points_of(part: HeightMap, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return stage x, y and z of pixels, [point, 3]."""
    return np.stack([part.x_um[cols], part.y_um[rows], part.z_um[rows, cols].astype(np.float64)], axis=1)


def eight_bits(grey: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Convert 16-bit grey to 8 bits by its upper byte, with the same scale in all strips."""
    return grey.astype(np.uint8) if grey.dtype.itemsize == 1 else (grey >> 8).astype(np.uint8)


def units_of(said: str | None, about: EmbeddedMetadata | None, asked: ReadOptions) -> tuple[float, float, float]:
    """Return the units of x, y and z in um; a point cloud has one unit, given by the file or the user."""
    unit = "um" if about is not None else said
    z_um = asked.z_scale_um(unit)
    lateral_um = UNITS_UM[(unit or asked.says.z_unit or "").strip().lower()]
    return lateral_um, lateral_um, z_um


def records(path: Path, begin: int, n_points: int, fields: list[tuple[str, str]], asked: ReadOptions) -> Iterator[Any]:
    """Yield binary points in blocks, as views of the file. Raises DatasetError when the file ends too early."""
    point = np.dtype(fields)
    if path.stat().st_size < begin + n_points * point.itemsize:
        raise asked.refuse(_CUT_OFF)
    whole = np.memmap(path, point, "r", begin, (n_points,)) if n_points else np.empty(0, point)
    for start in range(0, n_points, AT_A_TIME):
        yield whole[start : start + AT_A_TIME]


def text_records(
    path: Path, begin: int, n_points: int, fields: list[tuple[str, str]], asked: ReadOptions
) -> Iterator[Any]:
    """Yield points from lines of text in blocks. Raises DatasetError for a truncated or non-numeric file."""
    with path.open("rb") as file:
        file.seek(begin)
        for start in range(0, n_points, AT_A_TIME):
            wanted = min(AT_A_TIME, n_points - start)
            lines = list(islice(file, wanted))
            if len(lines) != wanted:
                raise asked.refuse(_CUT_OFF)
            try:
                yield np.loadtxt(lines, np.dtype(fields), ndmin=1)
            except ValueError as fault:
                raise asked.refuse("has points that are not numbers: write it again.") from fault
