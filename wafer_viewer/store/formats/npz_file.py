"""Height map as ``.npz``: uncompressed, so that its layers can be memory-mapped.

Keys: z_um, z_raw_um, confidence, all_in_focus, origin [row, col]; u_um, if it is known; for a mosaic also overlap_um;
for a field also refused_at, refused_z_um, refused_reason [n]; pixel_um, x0_um, y0_um; provenance, a JSON text.
"""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import decode, encode
from wafer_viewer.model.surface.height_map import HeightMap, Provenance, RefusedHeights
from wafer_viewer.store.io.checksums import SURFACES, remedy, require_good_archive, seal_archive

if TYPE_CHECKING:
    from wafer_viewer.store.formats.reader_support import ReadOptions
    from wafer_viewer.store.formats.surface_strips import Strips

LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")
OPTIONAL = ("overlap_um", "u_um")
"""Layers that not every surface has; older files lack u_um."""
THINNED = ("u_um",)
"""Those of them that every n-th pixel of a surface keeps."""
REFUSED = {"at": "refused_at", "z_um": "refused_z_um", "reason": "refused_reason"}
"""Attributes of `RefusedHeights` and their keys; older files have none of them."""
PLACE = ("pixel_um", "x0_um", "y0_um")
_LOCAL_HEADER = struct.Struct("<26xHH")
"""End of the local header of a zip member: lengths of its name and of its extra field."""


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
    try:
        if verify:
            require_good_archive(place)
        with zipfile.ZipFile(place) as archive, place.open("rb") as file:
            names = (*LAYERS, *(name for name in OPTIONAL if f"{name}.npy" in archive.namelist()))
            layers = {name: map_member(place, file, archive.getinfo(f"{name}.npy")) for name in names}
            refused = _read_refused(place, file, archive)
        with np.load(place) as members:
            where: dict[str, Any] = {name: float(members[name]) for name in PLACE}
            provenance = decode(str(members["provenance"]), Provenance, place.name, "json")
    except FileNotFoundError as fault:
        raise DatasetError(f"{place} does not exist: check the path.") from fault
    except KeyError as fault:
        raise DatasetError(
            f"{place} is not a height map, {fault.args[0]}: give a file that Wafer Viewer wrote."
        ) from fault
    except (zipfile.BadZipFile, ValueError, OSError, struct.error) as fault:
        mend = remedy(place) if place.parent.name == SURFACES else "give a file that Wafer Viewer wrote"
        raise DatasetError(f"{place} cannot be read as .npz: {mend}.") from fault
    try:
        return HeightMap(**layers, **where, provenance=provenance, refused=refused)
    except WaferViewerError as fault:
        raise DatasetError(f"{place}: {fault}") from fault


def _read_refused(path: Path, file: IO[bytes], archive: zipfile.ZipFile) -> RefusedHeights | None:
    """Read the refused heights; None in older files without them."""
    if f"{REFUSED['at']}.npy" not in archive.namelist():
        return None
    arrays = {name: map_member(path, file, archive.getinfo(f"{key}.npy")) for name, key in REFUSED.items()}
    return RefusedHeights(**arrays)


def map_member(path: Path, file: IO[bytes], member: zipfile.ZipInfo) -> NDArray[Any]:
    """Map one uncompressed array of the archive; a compressed one is read."""
    if member.compress_type != zipfile.ZIP_STORED:
        with np.load(path) as members:
            return members[member.filename.removesuffix(".npy")]
    file.seek(member.header_offset)
    name_bytes, extra_bytes = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
    file.seek(name_bytes + extra_bytes, 1)
    shape, fortran, dtype = _array_header(file)
    if shape == (0,):
        return np.empty(0, dtype)
    if 0 in shape or fortran:
        raise ValueError(f"{member.filename} has an unusual layout")
    return np.asarray(np.memmap(path, dtype, "c", file.tell(), shape))


def _array_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read shape, Fortran order and dtype from the header of an array."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    return read(file)
