"""Meshes as surfaces: STL, OBJ, PLY, GLB and 3MF, read by trimesh, of the extra `wafer-viewer[surfaces]`.

Vertices on a lattice that the triangles connect to their neighbours are the heights themselves; of any other mesh each
pixel has the height of the highest triangle over its centre.
"""

from __future__ import annotations

import importlib.util
import json
import struct
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, detail, parser_errors_as
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.store.formats.point_gridding import (
    PointCloud,
    PointLattice,
    assign_to_lattice,
    pitch_of,
    units_of,
)
from wafer_viewer.store.formats.reader_support import (
    OURS,
    EmbeddedMetadata,
    ReadOptions,
    common_height_um,
    heights_only,
    parse_metadata,
    provenance_of,
    same,
)
from wafer_viewer.store.io.guarded_reading import MEND, limit, require_unpacked

INSTALL = "pip install 'wafer-viewer[surfaces]'"
_HEAD_BYTES = 1_000_000
_MOST_BYTES = 1_000_000_000
"""Largest file of a mesh, which trimesh holds in memory several times."""
_MOST_PIXELS = 100_000_000
_FEWEST_DEFAULT, _MOST_DEFAULT = 250_000, 4_000_000
"""Pixels of a surface whose pixel size is not given."""
_CANDIDATES = 2_000_000
"""Pixels in the boxes of triangles that are tested at a time."""
_LONGEST_EDGE = 1.5
"""Longest edge between neighbours of a lattice, in pixels."""
_OFF_PX = 1e-4
"""Distance from the border of a mesh at which a pixel is still on it: 32-bit coordinates are rounded."""
_GLB_JSON_AT = 20
_STL_TITLE = "Wafer Viewer, um"
_WALL_PX2 = 1e-9
"""Area of a triangle, seen from above, below which it is a wall."""
Floats = NDArray[np.float64]
Triangles = NDArray[np.int64]


def is_installed() -> bool:
    """Return whether meshes can be read."""
    return importlib.util.find_spec("trimesh") is not None


def read_mesh(path: Path, options: ReadOptions, unit: str | None = None) -> HeightMap:
    """Read a mesh as a surface; unit: that of its coordinates, where the format has none and the file states it.

    Raises DatasetError if trimesh is missing, or the mesh is damaged, empty, or has no unit and none is given.
    """
    about, came_from, own_unit = _own_words(path)
    vertices, triangles, stated = _mesh(path, options)
    if not len(triangles) or not np.isfinite(vertices).all():
        raise options.refuse("holds no triangles: give a mesh of a surface.")
    vertices = vertices * units_of(unit or own_unit or stated, None if stated else about, options)
    if about is None and own_unit is None:
        vertices[:, 2] -= common_height_um(options, [vertices[:, 2].min(), vertices[:, 2].max()])
    vertices, numbers = np.unique(vertices, axis=0, return_inverse=True)
    triangles = numbers.reshape(-1)[triangles]
    points = PointCloud(
        lambda: iter([dict(zip("xyz", vertices.T.copy(), strict=True))]), (1.0, 1.0, 1.0), about, came_from
    )
    lattice = _lattice(vertices, triangles, about, options.overrides.pixel_um)
    surface = None if lattice is None else assign_to_lattice(points, lattice, options)
    return surface if surface is not None else _seen_from_above(vertices, triangles, came_from, options)


def _own_words(path: Path) -> tuple[EmbeddedMetadata | None, Provenance | None, str | None]:
    """Return what this program wrote of a surface into its mesh: lattice, provenance, and the unit of an STL."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith(b"glTF"):
        (n_bytes,) = struct.unpack_from("<I", head, 12)
        with parser_errors_as(lambda _: DatasetError("no JSON")), suppress(DatasetError):
            embedded = json.dumps(json.loads(head[_GLB_JSON_AT : _GLB_JSON_AT + n_bytes])["asset"].get("extras", {}))
            about = parse_metadata(embedded)
            return about, provenance_of(about, embedded), None
        return None, None, None
    title = head[:80].decode("latin-1")
    if title.startswith(_STL_TITLE):
        return None, provenance_of(None, None, title), "um"
    texts = [line[1:].strip() for line in head.decode("latin-1").splitlines() if line.startswith("#")]
    embedded = "".join(text.partition(":")[2].strip() for text in texts if text.startswith(f"{OURS}:"))
    about = parse_metadata(embedded)
    return about, provenance_of(about, embedded, *(text for text in texts if not text.startswith(f"{OURS}:"))), None


def _mesh(path: Path, options: ReadOptions) -> tuple[Floats, Triangles, str | None]:
    """Return vertices [n, 3] with z up, triangles [m, 3] of indices into them, and the unit if the file states it."""
    try:
        import trimesh
    except ImportError as fault:
        raise options.refuse(f"is a mesh, read by an extra: {INSTALL}.") from fault
    if path.stat().st_size > limit(_MOST_BYTES):
        raise options.refuse(f"is too large for a mesh: {MEND}.")
    kind = path.suffix.lower().removeprefix(".")
    if kind == "3mf":
        _require_plain_xml(path, options)
    with (
        parser_errors_as(
            lambda fault: options.refuse(f"cannot be read as a mesh{_one_sentence(fault)}: copy it again.")
        ),
        warnings.catch_warnings(),
        path.open("rb") as file,
    ):
        warnings.simplefilter("ignore")
        scene = trimesh.load_scene(file, file_type=kind, process=False, skip_materials=True)
        mesh, unit = scene.to_mesh(), "m" if kind == "glb" else scene.units
        vertices = np.asarray(mesh.vertices, np.float64)
        triangles = np.asarray(mesh.faces, np.int64)
    if kind == "glb":  # glTF has y up
        vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    return vertices, triangles, unit


def _one_sentence(fault: Exception) -> str:
    return detail(fault).replace(". ", ", ")


def _require_plain_xml(path: Path, options: ReadOptions) -> None:
    """Raise DatasetError for a zip that unpacks to too much, or whose XML defines entities."""
    damaged = options.refuse("is cut off or damaged: its zip archive cannot be read, so copy it again.")
    with parser_errors_as(lambda _: damaged), zipfile.ZipFile(path) as archive:
        require_unpacked(path.name, path.stat().st_size, sum(member.file_size for member in archive.infolist()))
        for name in archive.namelist():
            if name.lower().endswith((".model", ".rels", ".xml")) and b"<!" in archive.read(name).replace(b"<!--", b""):
                raise options.refuse("has a document type in its XML, which 3MF does not allow: export it again.")


def _lattice(
    vertices: Floats, triangles: Triangles, about: EmbeddedMetadata | None, wanted_um: float | None
) -> PointLattice | None:
    """Return the lattice of vertices whose triangles join neighbours; None if there is none, or of another pixel."""
    if about is not None:
        lattice = PointLattice(about.pixel_um, about.x0_um, about.y0_um, about.rows, about.cols)
        return lattice if wanted_um is None or same(wanted_um, about.pixel_um) else None
    xs, ys = np.unique(vertices[:, 0]), np.unique(vertices[:, 1])
    if min(len(xs), len(ys)) < 2 or (along := pitch_of(xs)) is None or (across := pitch_of(ys)) is None:
        return None
    edges = vertices[triangles, :2] - vertices[np.roll(triangles, 1, axis=1), :2]
    pixel_um = (along[0] + across[0]) / 2
    if not same(along[0], across[0]) or np.hypot(edges[..., 0], edges[..., 1]).max() > _LONGEST_EDGE * pixel_um:
        return None
    if wanted_um is not None and not same(wanted_um, pixel_um):
        return None
    return PointLattice(pixel_um, float(xs[0]), float(ys[-1]), across[1], along[1])


def _seen_from_above(
    vertices: Floats, triangles: Triangles, came_from: Provenance | None, options: ReadOptions
) -> HeightMap:
    """Return the heights of the highest triangles over pixel centres, NaN where there is none."""
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    pixel_um = options.overrides.pixel_um or _default_pixel_um(vertices, triangles)
    cols, rows = (int(n) for n in np.floor((high - low) / pixel_um + _OFF_PX) + 1)
    if rows * cols > limit(_MOST_PIXELS):
        raise options.refuse(f"would have {rows} x {cols} pixels of {pixel_um:g} um: give a larger --pixel-um.")
    corners = np.stack(
        [(vertices[:, 0] - low[0]) / pixel_um, (high[1] - vertices[:, 1]) / pixel_um, vertices[:, 2]], axis=1
    )[triangles]
    z_um = np.full(rows * cols, -np.inf)
    boxes = list(_boxes(corners, rows, cols))
    for part in options.watch(boxes):
        _draw(z_um, corners, part, cols)
    z_um[np.isneginf(z_um)] = np.nan
    options.notes.append(
        f"It is a mesh, seen from above at pixels of {pixel_um:.4g} um; walls and undersides are lost."
    )
    heights = z_um.reshape(rows, cols).astype(np.float32)
    simulated = Provenance(simulated=True) if came_from is not None and came_from.simulated else None
    return heights_only(options, heights, pixel_um, float(low[0]), float(high[1]), simulated)


def _default_pixel_um(vertices: Floats, triangles: Triangles) -> float:
    """Return the mean distance of vertices, or a pixel that makes a surface of a usual size; three digits."""
    (ax, ay), (bx, by) = (
        np.moveaxis(vertices[triangles[:, n], :2] - vertices[triangles[:, 0], :2], 1, 0) for n in (1, 2)
    )
    area, box = float(np.abs(ax * by - ay * bx).sum()), float(np.prod(np.ptp(vertices[:, :2], axis=0)))
    finest, coarsest = ((max(box, 1e-12) / n) ** 0.5 for n in (_MOST_DEFAULT, _FEWEST_DEFAULT))
    return float(f"{min(max((area / len(triangles)) ** 0.5, finest), coarsest):.3g}")


def _boxes(corners: Floats, rows: int, cols: int) -> Iterator[Triangles]:
    """Yield boxes [n, 5] of triangles: number, first and last row, first and last column; some pixels at a time."""
    low, high = np.ceil(corners[..., :2].min(axis=1) - _OFF_PX), np.floor(corners[..., :2].max(axis=1) + _OFF_PX)
    low, high = np.maximum(low, 0).astype(np.int64), np.minimum(high, (cols - 1, rows - 1)).astype(np.int64)
    numbers = np.flatnonzero((low <= high).all(axis=1))
    todo = np.column_stack([numbers, low[numbers, 1], high[numbers, 1], low[numbers, 0], high[numbers, 0]])
    sizes = (todo[:, 2] - todo[:, 1] + 1) * (todo[:, 4] - todo[:, 3] + 1)
    small = todo[sizes <= _CANDIDATES]
    parts = np.cumsum(sizes[sizes <= _CANDIDATES]) // _CANDIDATES
    yield from np.split(small, np.flatnonzero(np.diff(parts)) + 1)
    for number, top, bottom, left, right in todo[sizes > _CANDIDATES].tolist():
        step = max(1, _CANDIDATES // (right - left + 1))
        for row in range(top, bottom + 1, step):
            yield np.array([[number, row, min(row + step - 1, bottom), left, right]])


def _draw(z_um: Floats, corners: Floats, boxes: Triangles, cols: int) -> None:
    """Raise pixels to the triangles over their centres."""
    widths, heights = boxes[:, 4] - boxes[:, 3] + 1, boxes[:, 2] - boxes[:, 1] + 1
    which = np.repeat(np.arange(len(boxes)), widths * heights)
    nth = np.arange(len(which)) - np.repeat(np.cumsum(widths * heights) - widths * heights, widths * heights)
    row, col = boxes[which, 1] + nth // widths[which], boxes[which, 3] + nth % widths[which]
    a, b, c = (corners[boxes[:, 0], n] for n in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((b[which, 0] - col) * (c[which, 1] - row) - (c[which, 0] - col) * (b[which, 1] - row)) / area[which]
        v = ((c[which, 0] - col) * (a[which, 1] - row) - (a[which, 0] - col) * (c[which, 1] - row)) / area[which]
    w = 1 - u - v
    sides = np.stack([c - b, a - c, b - a])[..., :2]
    off = _OFF_PX * np.hypot(sides[..., 0], sides[..., 1]) / np.maximum(np.abs(area), np.finfo(float).tiny)
    inside = (np.abs(area[which]) > _WALL_PX2) & (u >= -off[0, which]) & (v >= -off[1, which]) & (w >= -off[2, which])
    z = u * a[which, 2] + v * b[which, 2] + w * c[which, 2]
    tops = np.stack([a, b, c])[..., 2]
    z = np.clip(z, tops.min(axis=0)[which], tops.max(axis=0)[which])
    np.maximum.at(z_um, (row * cols + col)[inside], z[inside])
