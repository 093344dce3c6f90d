"""X3P, ISO 25178-72 (revision ISO5436_2000): a zip of main.xml, the heights, and their MD5 checksums.

Lengths are in m. In this revision the first row is the top edge and y points downward, as Gwyddion, MountainsMap,
surfalize and SurfaceTopography take it, so the Offset of CY is minus the stage y of the first row. Implemented here and
not with x3pio, which holds several copies of the heights in memory and supports neither stopping nor progress; the
tests compare the two.
"""

from __future__ import annotations

import datetime
import hashlib
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import parser_errors_as
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.reader_support import (
    ReadOptions,
    about,
    caveats,
    common_height_um,
    heights_only,
    on_square_pixels,
    parse_metadata,
    provenance_of,
    scaled,
)
from wafer_viewer.store.formats.surface_strips import STRIP_ROWS, Strips
from wafer_viewer.store.io.guarded_reading import require_unpacked

MAIN, DATA, CHECKSUM = "main.xml", "bindata/data.bin", "md5checksum.hex"
REVISION = "ISO5436 - 2000"
NAMESPACE = "http://www.opengps.eu/2008/ISO5436_2"
CREATOR = "Wafer Viewer, top row first"
_UNREAD_CREATOR = "Wafer Viewer"
_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
_M = 1e-6
_LARGEST_XML = 16_000_000


def write_x3p(strips: Strips, path: Path) -> None:
    """Write heights in m as 64-bit floats, NaN where unmeasured."""
    digest = hashlib.md5(usedforsecurity=False)
    with zipfile.ZipFile(path, "w", allowZip64=True) as archive:
        with archive.open(DATA, "w", force_zip64=True) as file:
            for z_um in strips.layer("z_um"):
                data = (z_um.astype("<f8") * _M).tobytes()
                digest.update(data)
                file.write(data)
        main = _main(strips, digest.hexdigest())
        archive.writestr(MAIN, main)
        archive.writestr(CHECKSUM, f"{hashlib.md5(main, usedforsecurity=False).hexdigest()} *{MAIN}\n")


def read_x3p(path: Path, options: ReadOptions) -> HeightMap:
    """Read the heights of an X3P file. Raises DatasetError when damaged, or not one surface on a grid."""
    damaged = options.refuse("is cut off or damaged: its zip archive cannot be read, so copy it again.")
    with parser_errors_as(lambda _: damaged), zipfile.ZipFile(path) as archive:
        require_unpacked(path.name, path.stat().st_size, sum(member.file_size for member in archive.infolist()))
        return _read(archive, _main_of(archive, options), options)


def _read(archive: zipfile.ZipFile, main: ElementTree.Element, options: ReadOptions) -> HeightMap:
    dx, dy, dz = (_axis(main, name, options) for name in ("CX", "CY", "CZ"))
    if dz[0] < 0 and not options.overrides.invert_z:
        raise options.refuse("has z upside down, its increment is negative: give --invert-z to invert it.")
    dx_um, dy_um = options.pitches_um(dx[0] / _M, dy[0] / _M)
    creator = _text(main, "Record2/Creator")
    if creator == _UNREAD_CREATOR:
        raise options.refuse("begins with the bottom row, as no released version wrote it: export its surface again.")
    m_um = options.z_scale_um("m")
    z_um = _heights(archive, main, dz[0] * m_um, dz[1] * m_um, options, is_ours=creator == CREATOR)
    if (revision := _text(main, "Record1/Revision")) not in (REVISION, None):
        options.notes.append(f"Its first row was taken as the top edge: check that, its revision is {revision}.")
    z_um, pixel_um = on_square_pixels(options, z_um, dx_um, dy_um)
    for_people, _, embedded = (_text(main, "Record2/Comment") or "").partition("\n")
    model = _text(main, "Record2/Instrument/Model")
    came_from = provenance_of(parse_metadata(embedded), embedded, for_people, model)
    return heights_only(options, z_um, pixel_um, dx[1] / _M, -dy[1] / _M, came_from)


def _main(strips: Strips, digest: str) -> bytes:
    """Return main.xml. The calibration date is omitted without a calibration, as the standard states."""
    provenance, (rows, cols), pixel_m = strips.surface.provenance, strips.shape, strips.pixel_um * _M
    calibration = provenance.calibration
    tree: dict[str, Any] = {
        "Record1": {
            "Revision": REVISION,
            "FeatureType": "SUR",
            "Axes": {
                "CX": _axis_element("I", pixel_m, strips.surface.x0_um * _M),
                "CY": _axis_element("I", pixel_m, -strips.surface.y0_um * _M),
                "CZ": _axis_element("A", 1.0, 0.0),
            },
        },
        "Record2": {
            "Date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "Creator": CREATOR,
            "Instrument": {
                "Manufacturer": "Wafer Viewer",
                "Model": "virtual rig, SIMULATED" if provenance.simulated else "shape from focus",
                "Serial": "not available",
                "Version": provenance.software_version or "unknown",
            },
            **({"CalibrationDate": f"{calibration.made}T00:00:00Z"} if calibration is not None else {}),
            "ProbingSystem": {
                "Type": "Software" if provenance.simulated else "NonContacting",
                "Identification": "shape from focus",
            },
            "Comment": f"{'; '.join(caveats(provenance)) or 'calibrated'}\n{about(strips)}",
        },
        "Record3": {
            "MatrixDimension": {"SizeX": cols, "SizeY": rows, "SizeZ": 1},
            "DataLink": {"PointDataLink": DATA, "MD5ChecksumPointData": digest},
        },
        "Record4": {"ChecksumFile": CHECKSUM},
    }
    ElementTree.register_namespace("p", NAMESPACE)
    root = ElementTree.Element(f"{{{NAMESPACE}}}ISO5436_2")
    _append_elements(root, tree)
    return ElementTree.tostring(root, "UTF-8", xml_declaration=True)


def _axis_element(kind: str, increment: float, offset: float) -> dict[str, Any]:
    return {"AxisType": kind, "DataType": "D", "Increment": repr(increment), "Offset": repr(offset)}


def _append_elements(parent: ElementTree.Element, tree: dict[str, Any]) -> None:
    for name, below in tree.items():
        child = ElementTree.SubElement(parent, name)
        if isinstance(below, dict):
            _append_elements(child, below)
        else:
            child.text = str(below)


def _main_name(archive: zipfile.ZipFile) -> str:
    """Return the member main.xml that lies highest, in whatever folder; empty if there is none."""
    found = [n for n in archive.namelist() if n.replace("\\", "/").split("/")[-1].lower() == MAIN]
    return min(found, key=len, default="")


def _main_of(archive: zipfile.ZipFile, options: ReadOptions) -> ElementTree.Element:
    """Return the root of main.xml after a check of its checksum and its feature type."""
    if not (name := _main_name(archive)):
        raise options.refuse(f"is not an X3P file, it has no {MAIN}: give one that has.")
    with archive.open(name) as file:
        text = file.read(_LARGEST_XML)
    sums = next((n for n in archive.namelist() if n.lower().endswith(CHECKSUM)), None)
    if sums is not None:
        checksum_line = archive.read(sums).split()[:1]
        _require_sum(
            checksum_line[0].decode("ascii", "replace") if checksum_line else "",
            hashlib.md5(text, usedforsecurity=False),
            MAIN,
            options,
        )
    if b"<!DOCTYPE" in text or b"<\0!\0D\0" in text or b"\0<\0!\0D" in text:  # also in UTF-16
        raise options.refuse(f"has a document type in its {MAIN}, which X3P does not allow: export it again.")
    damaged = options.refuse(f"is damaged: its {MAIN} cannot be read, so copy it again.")
    with parser_errors_as(lambda _: damaged):
        root = ElementTree.fromstring(text)
    if (kind := _text(root, "Record1/FeatureType")) != "SUR":
        raise options.refuse(f"holds '{kind}' and no surface (SUR): give a file with a surface.")
    return root


def _heights(
    archive: zipfile.ZipFile,
    main: ElementTree.Element,
    factor: float,
    offset_um: float,
    options: ReadOptions,
    *,
    is_ours: bool,
) -> NDArray[np.float32]:
    """Return the heights in the order of the file; NaN where invalid."""
    rows, cols, layers = (_size(main, name, options) for name in ("SizeY", "SizeX", "SizeZ"))
    if layers != 1:
        raise options.refuse(f"has {layers} layers and one is read: write the one that is wanted into its own file.")
    link, kind = _text(main, "Record3/DataLink/PointDataLink"), _text(main, "Record1/Axes/CZ/DataType") or "D"
    if link is None:
        return scaled(options, _text_heights(main, rows, cols, options), factor, offset_um, is_ours=is_ours)
    if kind not in _TYPES:
        raise options.refuse(f"keeps its heights in an unknown type, {kind[:20]}: write it with I, L, F or D.")
    name, dtype = _member_name(archive, link, options), np.dtype(_TYPES[kind])
    if archive.getinfo(name).file_size < rows * cols * dtype.itemsize:
        raise options.refuse("is truncated, it has fewer heights than its header states: copy it again.")
    valid, digest = _valid(archive, main, rows * cols, options), hashlib.md5(usedforsecurity=False)
    z_um, common_um = np.empty((rows, cols), np.float32), 0.0 if is_ours else None
    with archive.open(name) as file:
        for first in options.watch(list(range(0, rows, STRIP_ROWS))):
            end = min(first + STRIP_ROWS, rows)
            data = file.read((end - first) * cols * dtype.itemsize)
            digest.update(data)
            strip = np.frombuffer(data, dtype).astype(np.float64) * factor + offset_um
            if valid is not None:
                strip[~valid[first * cols : end * cols]] = np.nan
            known = strip[np.isfinite(strip)]
            if common_um is None and known.size:
                common_um = common_height_um(options, [float(known.min()), float(known.max())])
            z_um[first:end] = (strip - (common_um or 0.0)).reshape(-1, cols)
    _require_sum(_text(main, "Record3/DataLink/MD5ChecksumPointData") or "", digest, "heights", options)
    return z_um


def _text_heights(main: ElementTree.Element, rows: int, cols: int, options: ReadOptions) -> NDArray[np.float64]:
    """Return heights that main.xml itself lists: the last coordinate of each Datum, none where unmeasured."""
    texts = [
        (datum.text or "").rpartition(";")[2].strip() for datum in main.iterfind("{*}Record3/{*}DataList/{*}Datum")
    ]
    if len(texts) != rows * cols:
        raise options.refuse(f"lists {len(texts)} heights, but its header states {rows} x {cols}: copy it again.")
    try:
        return np.array([float(text or "nan") for text in texts]).reshape(rows, cols)
    except ValueError as fault:
        raise options.refuse("lists heights that are not numbers: write it again with binary data.") from fault


def _valid(
    archive: zipfile.ZipFile, main: ElementTree.Element, n: int, options: ReadOptions
) -> NDArray[np.bool_] | None:
    """Return the validity mask, as integers have no NaN; None if all points are valid.

    It is stored as bits, the lowest first.
    """
    link = _text(main, "Record3/DataLink/ValidPointsLink")
    if link is None:
        return None
    with archive.open(_member_name(archive, link, options)) as file:
        bits = np.frombuffer(file.read(-(-n // 8)), np.uint8)
    return np.unpackbits(bits, count=n, bitorder="little").astype(bool)


def _member_name(archive: zipfile.ZipFile, link: str, options: ReadOptions) -> str:
    """Return the member that main.xml links to, in the folder where main.xml lies."""
    wanted = link.replace("\\", "/").removeprefix("./").removeprefix("/")
    folder = _main_name(archive)[: -len(MAIN)].replace("\\", "/")
    name = next((n for n in archive.namelist() if n.replace("\\", "/") in (folder + wanted, wanted)), None)
    if name is None:
        raise options.refuse(f"has no {wanted}, which holds its heights: copy it again.")
    return name


def _require_sum(expected: str, digest: Any, part: str, options: ReadOptions) -> None:
    """Raise DatasetError when a checksum differs; a missing one is not checked, as in other readers."""
    if expected.strip() and expected.strip().lower() != digest.hexdigest():
        raise options.refuse(f"was changed after it was written, the checksum of its {part} is wrong: copy it again.")


def _axis(main: ElementTree.Element, name: str, options: ReadOptions) -> tuple[float, float]:
    """Return increment and offset of an axis, in m."""
    kind = _text(main, f"Record1/Axes/{name}/AxisType")
    if kind != ("A" if name == "CZ" else "I"):
        raise options.refuse(f"has an axis {name} of type '{kind}': write it on a regular grid.")
    try:
        texts = [_text(main, f"Record1/Axes/{name}/{attribute}") for attribute in ("Increment", "Offset")]
        increment, offset = float(texts[0] or 1.0), float(texts[1] or 0.0)
    except ValueError as fault:
        raise options.refuse(
            f"has an axis {name} whose increment or offset is not a number: write it again."
        ) from fault
    if texts[0] is None and name != "CZ":
        raise options.refuse(f"states no increment of its axis {name}: export it again with its pixel size.")
    return increment, offset


def _size(main: ElementTree.Element, name: str, options: ReadOptions) -> int:
    text = (_text(main, f"Record3/MatrixDimension/{name}") or "").strip()
    if not text.isdigit() or int(text) < 1:
        raise options.refuse(f"states no {name}: export it again as a surface on a grid.")
    return int(text)


def _text(root: ElementTree.Element, path: str) -> str | None:
    """Return the text of an element, with or without a namespace."""
    element = root.find("/".join(f"{{*}}{name}" for name in path.split("/")))
    return None if element is None or element.text is None else element.text.strip()
