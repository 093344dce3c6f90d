"""Height maps as files that other programs read. The ending picks the format.

Every format that can hold a text says what is simulated or uncalibrated.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface import HeightMap, Mosaic, Origin, Provenance
from wafer_viewer.store.files import replacing
from wafer_viewer.store.npz import write_npz

Triangles = NDArray[np.int32]
_UM_PER_CM = 1e4


def export(surface: HeightMap | Mosaic, path: str | Path) -> Path:
    """Write a surface, whole or not at all; a mosaic is read at its full resolution.

    Raises DatasetError when the ending names no format or the file cannot be written.
    """
    target = Path(path)
    write = require_known(target)
    with replacing(target) as beside:
        write(surface if isinstance(surface, HeightMap) else surface.window(), beside)
    return target


def require_known(path: Path) -> Callable[[HeightMap, Path], None]:
    """The exporter of a file's ending. Raises DatasetError when there is none."""
    if (found := EXPORTERS.get(path.suffix.lower())) is None:
        raise DatasetError(f"{path.name} has no ending that is known: take one of {', '.join(EXPORTERS)}.")
    return found


def caveats(provenance: Provenance, today: str | None = None) -> tuple[str, ...]:
    """What a reader of the numbers must know: 'SIMULATED', and 'uncalibrated' with the reason; empty when all is well.

    today: an ISO 8601 day, the present one when left out.
    """
    day = today or datetime.date.today().isoformat()
    calibration = provenance.calibration
    problem = "no calibration" if calibration is None else calibration.problem(calibration.setup, day)
    return (("SIMULATED",) if provenance.simulated else ()) + ((f"uncalibrated: {problem}",) if problem else ())


def write_tiff(surface: HeightMap, path: Path) -> None:
    """z_um as 32-bit floats, NaN where unmeasured, with the pixel size as resolution; filled pixels are as others."""
    import tifffile

    per_cm = _UM_PER_CM / surface.pixel_um
    tifffile.imwrite(
        path,
        surface.z_um,
        photometric="minisblack",
        metadata=None,
        description=msgspec.json.encode(_about(surface)).decode(),
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
    )


def write_ply(surface: HeightMap, path: Path) -> None:
    """Points with a height, in stage um, grey as the all-in-focus image, with the code of their origin; binary."""
    rows, cols = np.nonzero(np.isfinite(surface.z_um))
    point = np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3), ("origin", "u1")])
    points = np.empty(len(rows), point)
    points["xyz"] = np.stack([surface.x_um[cols], surface.y_um[rows], surface.z_um[rows, cols]], axis=1)
    points["rgb"] = _eight_bits(surface.all_in_focus)[rows, cols, None]
    points["origin"] = surface.origin[rows, cols]
    properties = [*(f"double {c}" for c in "xyz"), *(f"uchar {c}" for c in ("red", "green", "blue", "origin"))]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in _heading(surface)),
        f"element vertex {len(points)}",
        *(f"property {name}" for name in properties),
        "end_header",
    ]
    with path.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode())
        points.tofile(file)


def write_stl(surface: HeightMap, path: Path) -> None:
    """Triangles between neighbours that all have a height, in um from pixel (0, 0): STL numbers have seven digits.

    Raises DatasetError when no four neighbours have a height.
    """
    from trimesh import Trimesh
    from trimesh.exchange.stl import export_stl

    rows, cols = np.indices(surface.shape, dtype=np.float32) * np.float32(surface.pixel_um)
    vertices = np.stack([cols, -rows, np.nan_to_num(surface.z_um)], axis=-1).reshape(-1, 3)
    faces = _triangles(np.isfinite(surface.z_um))
    if not len(faces):
        raise DatasetError(f"{path.name} would hold no triangle: no four neighbouring pixels have a height.")
    solid = Trimesh(vertices, faces, process=False, validate=False)
    binary: bytes = export_stl(solid)
    title = f"Wafer Viewer, um, {'; '.join(caveats(surface.provenance)) or 'calibrated'}"
    path.write_bytes(title.encode("ascii", "replace")[:80].ljust(80) + binary[80:])


def write_csv(surface: HeightMap, path: Path) -> None:
    """One line for each pixel with a height: x_um, y_um, z_um and the code of its origin, below lines with #."""
    rows, cols = np.nonzero(np.isfinite(surface.z_um))
    table = np.stack([surface.x_um[cols], surface.y_um[rows], surface.z_um[rows, cols], surface.origin[rows, cols]], 1)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {line}\n" for line in _heading(surface))
        file.write("x_um,y_um,z_um,origin\n")
        np.savetxt(file, table, fmt=("%.4f", "%.4f", "%.5f", "%d"), delimiter=",")


EXPORTERS: dict[str, Callable[[HeightMap, Path], None]] = {
    ".npz": write_npz,
    ".tif": write_tiff,
    ".tiff": write_tiff,
    ".ply": write_ply,
    ".stl": write_stl,
    ".csv": write_csv,
}
"""How a surface is written, by the ending of the file."""


def _heading(surface: HeightMap) -> list[str]:
    """What stands above numbers in a text, a line each."""
    provenance, pixel_um = surface.provenance, surface.pixel_um
    return [
        f"Wafer Viewer {provenance.software_version}: heights in um, stage coordinates",
        *caveats(provenance),
        f"x = {surface.x0_um:.4f} + col * {pixel_um:.8g}, y = {surface.y0_um:.4f} - row * {pixel_um:.8g}",
        f"{surface.shape[0]} rows, {surface.shape[1]} columns; {_filled_share(surface):.2%} filled, not measured",
        f"origin: {', '.join(f'{o.value} {o.name.lower()}' for o in Origin if o < Origin.NOT_COVERED)}",
        f"input checksum: {provenance.input_checksum or 'none'}",
    ]


def _about(surface: HeightMap) -> dict[str, object]:
    """The same for a program to read."""
    return {
        "software": f"Wafer Viewer {surface.provenance.software_version}",
        "unit": "um",
        "caveats": caveats(surface.provenance),
        "pixel_um": surface.pixel_um,
        "x0_um": surface.x0_um,
        "y0_um": surface.y0_um,
        "filled_fraction": round(_filled_share(surface), 6),
        "provenance": surface.provenance,
    }


def _filled_share(surface: HeightMap) -> float:
    return float(np.mean(surface.origin == Origin.FILLED)) if surface.origin.size else math.nan


def _eight_bits(grey: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Grey as it is shown: 16-bit images are stretched to their brightest pixel."""
    if grey.dtype.itemsize == 1:
        return grey.astype(np.uint8, copy=False)
    return (grey * (255.0 / max(1, int(grey.max(initial=1))))).astype(np.uint8)


def _triangles(known: NDArray[np.bool_]) -> Triangles:
    """Two triangles, facing up, for each square of four known pixels; indices into the flattened lattice."""
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    cols = known.shape[1]
    a = np.flatnonzero(np.pad(whole, ((0, 1), (0, 1)))).astype(np.int32)
    b, c, d = a + 1, a + cols, a + cols + 1
    return np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
