"""GSF, Gwyddion Simple Field: lines of text, then 32-bit floats from the top row down.

Lengths are in m. Its y axis points downward, so YOffset is minus the stage y of the top edge. Source: Gwyddion user
guide, 'Gwyddion Simple Field file format'.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.reader_support import (
    OURS,
    ReadOptions,
    about,
    heights_only,
    on_square_pixels,
    parse_metadata,
    provenance_of,
    scaled,
    title,
)
from wafer_viewer.store.formats.surface_strips import Strips

MAGIC = b"Gwyddion Simple Field 1.0\n"
_LARGEST_HEADER = 1_000_000
_M = 1e-6
"""Metres per um."""


def write_gsf(strips: Strips, path: Path) -> None:
    """Write heights in m as 32-bit floats, NaN where unmeasured."""
    with path.open("wb") as file:
        file.write(_header(strips))
        for z_um in strips.layer("z_um"):
            file.write((z_um.astype(np.float64) * _M).astype("<f4").tobytes())


def read_gsf(path: Path, options: ReadOptions) -> HeightMap:
    """Read the heights of a GSF file. Raises DatasetError when it is no such file or states no units."""
    header, begin = _read_header(path, options)
    rows, cols = (_count(header, name, options) for name in ("YRes", "XRes"))
    if path.stat().st_size != begin + 4 * rows * cols:
        raise options.refuse("is cut off or too long: its header and its numbers do not fit, so write it again.")
    options.require_heights_up(header.get("Title", ""))
    z_scale = options.z_scale_um(header.get("ZUnits"))
    unit_um = options.lateral_um(header.get("XYUnits"))
    dx_um, dy_um = (_pitch_um(header, name, n, unit_um, options) for name, n in (("XReal", cols), ("YReal", rows)))
    dx_um, dy_um = options.pitches_um(dx_um, dy_um)
    raw = np.memmap(path, "<f4", "r", begin, (rows, cols))
    z_um = scaled(options, raw, z_scale, is_ours=OURS in header)
    z_um, pixel_um = on_square_pixels(options, z_um, dx_um, dy_um)
    x0_um, y0_um = (_number(header, name, options, 0.0) * (unit_um or 0.0) for name in ("XOffset", "YOffset"))
    embedded = header.pop(OURS, None)
    came_from = provenance_of(parse_metadata(embedded), embedded, *header.values())
    return heights_only(options, z_um, pixel_um, x0_um + dx_um / 2, -y0_um - dy_um / 2, came_from)


def _header(strips: Strips) -> bytes:
    surface, (rows, cols), pixel_um = strips.surface, strips.shape, strips.pixel_um
    lines = {
        "XRes": cols,
        "YRes": rows,
        "XReal": cols * pixel_um * _M,
        "YReal": rows * pixel_um * _M,
        "XOffset": (surface.x0_um - pixel_um / 2) * _M,
        "YOffset": -(surface.y0_um + pixel_um / 2) * _M,
        "XYUnits": "m",
        "ZUnits": "m",
        "Title": title(surface),
        OURS: about(strips),
    }
    text = MAGIC + "".join(f"{name} = {value}\n" for name, value in lines.items()).encode("ascii", "replace")
    return text + b"\0" * (4 - len(text) % 4)


def _read_header(path: Path, options: ReadOptions) -> tuple[dict[str, str], int]:
    """Return the header entries, and the offset of the numbers."""
    with path.open("rb") as file:
        content = file.read(_LARGEST_HEADER)
    end = content.find(b"\0")
    if content[: len(MAGIC)] != MAGIC or end < 0:
        raise options.refuse("has no header of a GSF file: give a file that begins with 'Gwyddion Simple Field 1.0'.")
    header: dict[str, str] = {}
    for line in content[len(MAGIC) : end].decode("utf-8", "replace").splitlines():
        name, _, value = (part.strip() for part in line.partition("="))
        if header.get(name, value) != value:
            raise options.refuse(f"states {name} twice, {header[name][:80]} and {value[:80]}: remove the wrong line.")
        header[name] = value
    return header, end + 4 - end % 4


def _count(header: dict[str, str], name: str, options: ReadOptions) -> int:
    if not header.get(name, "").isdigit() or int(header[name]) < 1:
        raise options.refuse(f"has no {name} in its header: write it again with its numbers of rows and columns.")
    return int(header[name])


def _number(header: dict[str, str], name: str, options: ReadOptions, otherwise: float) -> float:
    try:
        return float(header.get(name, otherwise))
    except ValueError as fault:
        raise options.refuse(f"has {header[name]!r} for {name} in its header: it must be a number.") from fault


def _pitch_um(header: dict[str, str], name: str, n: int, unit_um: float | None, options: ReadOptions) -> float | None:
    if name not in header or unit_um is None:
        return None
    return _number(header, name, options, 0.0) / n * unit_um
