"""Surface files of instrument makers, read by SurfaceTopography: an extra, `wafer-viewer[surfaces]`.

Its heights are [x, y] from the top left corner. Units, gaps and orientation are taken over; what is doubted is said in
a note, or refused. Its scale of NMS is not taken over: it takes nanometres for millimetres.
"""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, detail, parser_errors_as
from wafer_viewer.model.maker_formats import MAKER_FILES, MakerFile
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.reader_support import (
    UNITS_UM,
    ReadOptions,
    heights_only,
    on_square_pixels,
    scaled,
)
from wafer_viewer.store.io.guarded_reading import require_unpacked

INSTALL = "pip install 'wafer-viewer[surfaces]'"
_HEAD_BYTES = 64
_SMALLEST_PIXEL_UM, _LARGEST_PIXEL_UM = 1e-6, 1e4
"""Pixels beyond have a wrong unit: a picometre, a centimetre."""
_STEEPEST = 10.0
"""Range of heights, in widths of the surface, beyond which a unit may be wrong."""
_TEXT_BYTES = frozenset(range(32, 127)) | frozenset(b"\t\r\n\f")


def read_maker_file(path: Path, options: ReadOptions) -> HeightMap:
    """Read a surface of an instrument maker. Raises DatasetError if SurfaceTopography is missing, or cannot read it."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    kind = _kind_of(path, head)
    if kind.magic and not head.startswith(kind.magic) and _TEXT_BYTES.issuperset(head):
        return _read_text(path, options)
    reader = _reader(kind, options)
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            require_unpacked(path.name, path.stat().st_size, sum(member.file_size for member in archive.infolist()))
    with warnings.catch_warnings(), parser_errors_as(lambda fault: _not_read(kind, fault, options)):
        warnings.simplefilter("ignore")
        with reader(_uncompressed(path, head, options)) as opened:
            return _surface(opened, kind, options)


def _kind_of(path: Path, head: bytes) -> MakerFile:
    """Return the kind of a file by its first bytes, or else by its suffix."""
    by_suffix = next((kind for kind in MAKER_FILES if path.suffix.lower() in kind.suffixes), None)
    if by_suffix is not None and head.startswith(by_suffix.magic):
        return by_suffix
    by_content = next((kind for kind in MAKER_FILES if kind.magic and head.startswith(kind.magic)), by_suffix)
    return by_content or MAKER_FILES[0]


def _read_text(path: Path, options: ReadOptions) -> HeightMap:
    """Read a text with a suffix such as .dat, which is that of a maker, too."""
    from wafer_viewer.store.formats.text_table import read_table

    return read_table(path, options)


def _reader(kind: MakerFile, options: ReadOptions) -> Any:
    """Return the class that reads a kind of file. Raises DatasetError when SurfaceTopography is missing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            from SurfaceTopography.IO import lookup_reader_by_format  # pyright: ignore[reportMissingImports]
        except ImportError as fault:
            article = "an" if kind.title[0] in "AIO" else "a"
            raise options.refuse(f"is {article} {kind.title} file, read by an extra: {INSTALL}.") from fault
    return lookup_reader_by_format[kind.reader]


def _not_read(kind: MakerFile, fault: Exception, options: ReadOptions) -> DatasetError:
    reason = detail(fault).replace(". ", ", ")
    return options.refuse(f"cannot be read as {kind.title}{reason}: copy it again, or export it as X3P or text.")


def _surface(opened: Any, kind: MakerFile, options: ReadOptions) -> HeightMap:
    channel = _channel(opened, kind, options)
    lateral, unit = _units(channel)
    sizes = channel.physical_sizes
    topography = channel.topography() if sizes is not None else channel.topography(physical_sizes=channel.nb_grid_pts)
    metadata: dict[str, Any] = dict(topography.info.get("raw_metadata") or {})
    heights = topography.heights() if kind.reader == "mat" else topography.heights().T
    raw = np.ma.filled(np.ma.asarray(heights, np.float64), np.nan)
    if min(raw.shape) < 2 or (kind.reader == "sur" and metadata.get("type") in _NO_SURFACES):
        raise options.refuse("holds profiles or an image and no surface: give a file with a surface.")
    pitches_um = options.pitches_um(*_pitches_um(sizes, raw.shape, lateral, metadata, kind, options))
    _require_stated_range(raw, metadata, kind, unit or "", options)
    if kind.reader == "sur":
        raw += _sur_offset(metadata, unit)
    z_um = scaled(options, raw, options.z_scale_um(unit))
    _note_doubts(z_um, pitches_um, options)
    z_um, pixel_um = on_square_pixels(options, z_um, *pitches_um)
    options.notes.append(f"SurfaceTopography read it as {kind.title}.")
    return heights_only(options, z_um, pixel_um, 0.0, 0.0, None)


def _sur_offset(metadata: dict[str, Any], unit: str | None) -> float:
    """Return the height of zero counts, which SurfaceTopography leaves out, in the unit of the heights."""
    offset, offset_unit = float(metadata["data_offset"]), _plain_unit(metadata["data_unit"])
    if not np.isfinite(offset) or offset_unit not in UNITS_UM or unit not in UNITS_UM:
        return 0.0
    return offset * UNITS_UM[offset_unit] / UNITS_UM[unit]


_NO_SURFACES = (3, 4, 9, 11)
"""Types of SUR: binary image, series of profiles, image of grey, image of colours. Gwyddion writes 1 for surfaces."""


def _channel(opened: Any, kind: MakerFile, options: ReadOptions) -> Any:
    """Return the first channel of heights; a note names the others."""
    heights = [
        channel
        for channel in opened.channels
        if channel.dim == 2
        and channel.data_kind.value == "height"
        and (kind.reader == "mat" or _units(channel)[1] in UNITS_UM)
    ]
    if not heights:
        names = ", ".join(str(channel.name)[:40] for channel in opened.channels) or "nothing"
        raise options.refuse(f"has no channel of heights, but {names}: give a file with a surface.")
    if names := ", ".join(f"'{channel.name}'" for channel in heights[1:4]):
        options.notes.append(f"Of its channels, '{heights[0].name}' was read, not {names}.")
    if kind.reader == "mat":
        options.notes.append(f"The first row of its matrix '{heights[0].name}' was taken as the top edge.")
    return heights[0]


def _units(channel: Any) -> tuple[str | None, str | None]:
    """Return the units of x, y and of the heights; what is UTF-8 was read as Latin-1."""
    units = channel.unit if isinstance(channel.unit, tuple) else (channel.unit, channel.unit)
    lateral, vertical = (unit if unit is None else _plain_unit(unit) for unit in units)
    return lateral, vertical


def _plain_unit(unit: str) -> str:
    return unit.replace("\xc2", "").replace("Î¼", "µ")


def _pitches_um(
    sizes: Any,
    shape: tuple[int, ...],
    unit: str | None,
    metadata: dict[str, Any],
    kind: MakerFile,
    options: ReadOptions,
) -> tuple[float | None, float | None]:
    """Return the distances of columns and rows in um. Raises DatasetError if no microscope has such."""
    unit_um = options.lateral_um(unit)
    if sizes is None or unit_um is None:
        return None, None
    pitches = [float(size) * unit_um / n for size, n in zip(sizes, shape[::-1], strict=True)]
    if kind.reader == "nms" and "dx_mm" in metadata:  # named so in the reader; files have nm
        pitches = [metadata[name] * (1e-3 if metadata[name] >= 1 else 1e3) for name in ("dx_mm", "dy_mm")]
    if not _SMALLEST_PIXEL_UM <= min(pitches) <= max(pitches) <= _LARGEST_PIXEL_UM:
        raise options.refuse(
            f"gives pixels of {pitches[0]:.6g} x {pitches[1]:.6g} um, as no microscope has: export it as X3P."
        )
    return pitches[0], pitches[1]


def _require_stated_range(
    raw: NDArray[np.float64], metadata: dict[str, Any], kind: MakerFile, unit: str, options: ReadOptions
) -> None:
    """Raise DatasetError where heights go beyond the range that the header states of them."""
    known = raw[np.isfinite(raw)]
    if not known.size or kind.reader not in _COUNTS:
        return
    count = _COUNTS[kind.reader](metadata)
    low, high = (metadata[name] * (count if kind.reader == "sur" else 1) for name in ("zmin", "zmax"))
    if kind.reader == "sur" and metadata["inversion"]:
        low, high = 0.0 - high, 0.0 - low
    slack = _RANGE_COUNTS * count + 1e-6 * max(abs(low), abs(high))
    if known.min() < low - slack or known.max() > high + slack:
        raise options.refuse(
            f"states heights from {low:.6g} to {high:.6g} {unit} in its header, and has {known.min() + 0.0:.6g} to "
            f"{known.max() + 0.0:.6g} {unit}: save it anew in the program that made it, or export it as X3P."
        )


_COUNTS: dict[str, Callable[[dict[str, Any]], float]] = {
    "sur": lambda metadata: abs(metadata["height_scale_factor"]),
    "nms": lambda metadata: abs(metadata["zmax"] - metadata["zmin"]) / (2**16 - 2),
}
"""Step of the stored numbers, of the kinds whose header states the range of heights."""
_RANGE_COUNTS = 2
"""Steps by which heights may go beyond it, as writers round both."""


def _note_doubts(z_um: NDArray[np.float32], pitches_um: tuple[float, float], options: ReadOptions) -> None:
    """Add a note where the scale of heights is doubtful."""
    if not np.isfinite(z_um).any():
        return
    range_um, width_um = float(np.nanmax(z_um) - np.nanmin(z_um)), max(np.array(pitches_um) * z_um.shape[::-1])
    if range_um > _STEEPEST * width_um:
        options.notes.append(f"Its heights span {range_um:.4g} um over {width_um:.4g} um: check its units and gaps.")


def _uncompressed(path: Path, head: bytes, options: ReadOptions) -> Any:
    """Return what SurfaceTopography opens: the path, or a compressed SUR file as the uncompressed one."""
    if not head.startswith(_COMPRESSED):
        return str(path)
    content = path.read_bytes()
    comment, private = struct.unpack_from("<2H", content, _SUR_SIZES_AT)
    begin = _SUR_HEADER + comment + private
    (n_parts,) = struct.unpack_from("<I", content, begin)
    at, parts = begin + 4 + 8 * n_parts, list[bytes]()
    for n_raw, n_packed in struct.iter_unpack("<2I", content[begin + 4 : at]):
        require_unpacked(path.name, len(content), n_raw)
        parts.append(zlib.decompressobj().decompress(content[at : at + n_packed], n_raw))
        at += n_packed
    return io.BytesIO(_PLAIN + content[len(_PLAIN) : begin] + b"".join(parts))


_PLAIN, _COMPRESSED = b"DIGITAL SURF", b"DSCOMPRESSED"
_SUR_HEADER, _SUR_SIZES_AT = 512, 334
