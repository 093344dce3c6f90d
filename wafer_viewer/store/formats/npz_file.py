"""Height map as ``.npz``: uncompressed, so that its layers can be memory-mapped.

Keys: z_um, z_raw_um, confidence, all_in_focus, origin [row, col]; u_um, if it is known; for a mosaic also overlap_um;
for a field also refused_at, refused_z_um, refused_reason [n]; pixel_um, x0_um, y0_um; provenance, a JSON text.
"""

from __future__ import annotations

import zipfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import decode, encode
from wafer_viewer.model.surface.height_map import HeightMap, Provenance, RefusedHeights
from wafer_viewer.store.io.archives import Archive, open_archive
from wafer_viewer.store.io.checksums import SURFACES, remedy, seal_archive

if TYPE_CHECKING:
    from wafer_viewer.store.formats.reader_support import ReadOptions
    from wafer_viewer.store.formats.surface_strips import Strips

LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")
OPTIONAL = ("overlap_um", "u_um")
"""Layers that not every surface has."""
THINNED = ("u_um",)
"""Those of them that every n-th pixel of a surface keeps."""
REFUSED = {"at": "refused_at", "z_um": "refused_z_um", "reason": "refused_reason"}
"""Attributes of `RefusedHeights` and their keys."""
PLACE = ("pixel_um", "x0_um", "y0_um")


def write_npz(surface: HeightMap, path: Path) -> None:
    """Write a height map to a path with any suffix."""
    arrays: dict[str, Any] = {name: getattr(surface, name) for name in (*LAYERS, *PLACE)}
    arrays |= {name: layer for name in OPTIONAL if (layer := getattr(surface, name)) is not None}
    if surface.refused is not None:
        arrays |= {key: getattr(surface.refused, name) for name, key in REFUSED.items()}
    with path.open("wb") as file:
        np.savez(file, provenance=np.array(encode(surface.provenance, "json")), **arrays)
    seal_archive(path)


def write_npz_strips(strips: Strips, path: Path) -> None:
    """Write a surface layer by layer and strip by strip, with only a few rows in memory."""
    surface, (rows, cols) = strips.surface, strips.shape
    corner = surface.window(Region.point(surface.x0_um, surface.y0_um))
    optional = OPTIONAL if strips.every == 1 else THINNED
    names = (*LAYERS, *(name for name in optional if getattr(corner, name) is not None))
    header = {"provenance": encode(surface.provenance, "json"), "x0_um": surface.x0_um, "y0_um": surface.y0_um}
    with zipfile.ZipFile(path, "w", allowZip64=True) as archive:
        for part, name in enumerate(names):
            dtype = getattr(corner, name).dtype
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                head = {"descr": dtype.str, "fortran_order": False, "shape": (rows, cols)}
                np.lib.format.write_array_header_1_0(file, head)
                for layer in strips.layer(name, part, len(names)):
                    file.write(np.ascontiguousarray(layer).tobytes())
        for name, value in {**header, "pixel_um": strips.pixel_um}.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, np.array(value))
    seal_archive(path)


def read_npz_surface(path: Path, options: ReadOptions) -> HeightMap:
    """Read a height map, for which no options are needed. Raises DatasetError if there is no height."""
    from wafer_viewer.store.formats.reader_support import require_some

    surface = read_npz(path)
    require_some(options, np.isfinite(surface.z_um))
    return surface


def read_npz(path: str | Path, *, verify: bool = True) -> HeightMap:
    """Read a height map from an ``.npz`` file.

    The layers are mapped copy-on-write, so changes do not reach the file.

    Parameters
    ----------
    path : str or Path
        The ``.npz``.
    verify : bool, default True
        Test the checksum of the file, which reads all of it, once per process as long as it does not change. Without it
        only the position and the provenance are verified, not the layers.

    Returns
    -------
    HeightMap
        Heights in um; see `HeightMap`.

    Raises
    ------
    DatasetError
        When the file does not exist, is no ``.npz`` of a height map, its layers differ in shape, or its checksum
        differs.
    WaferViewerError
        When the provenance in the file is invalid.

    Notes
    -----
    Compressed layers cannot be mapped and are read into memory.
    """
    place = Path(path)
    with open_archive(place, partial(_unreadable, place), verify=verify) as archive:
        names = (*LAYERS, *(name for name in OPTIONAL if name in archive))
        layers = {name: archive.mapped(name) for name in names}
        where: dict[str, Any] = {name: archive.number(name) for name in PLACE}
        provenance = decode(archive.text("provenance"), Provenance, place.name, "json")
        refused = _read_refused(archive)
        try:
            return HeightMap(**layers, **where, provenance=provenance, refused=refused)
        except WaferViewerError as fault:
            raise DatasetError(f"{place}: {fault}") from fault


def _unreadable(path: Path, fault: Exception) -> DatasetError:
    match fault:
        case FileNotFoundError():
            return DatasetError(f"{path} does not exist: check the path.")
        case KeyError():
            return DatasetError(f"{path} is not a height map, it has no {fault}: give a file that Wafer Viewer wrote.")
        case _:
            mend = remedy(path) if path.parent.name == SURFACES else "give a file that Wafer Viewer wrote"
            return DatasetError(f"{path} cannot be read as .npz: {mend}.")


def _read_refused(archive: Archive) -> RefusedHeights | None:
    """Read the refused heights; None in files without them."""
    if REFUSED["at"] not in archive:
        return None
    return RefusedHeights(**{name: archive.mapped(key) for name, key in REFUSED.items()})
