"""Point files: counting, coordinates, block-wise reading, and gridding on their own or a given lattice.

Points come in blocks and can be read twice, so that a file may exceed the memory: once to detect the lattice, if the
file does not state it, and once to fill it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance
from wafer_viewer.store.formats.reader_support import (
    OURS,
    UNITS_UM,
    EmbeddedMetadata,
    ReadOptions,
    heights_only,
    parse_metadata,
    provenance_of,
)
from wafer_viewer.store.formats.surface_strips import Strips
from wafer_viewer.store.io.guarded_reading import limit

Block = dict[str, NDArray[Any]]
"""Points by column name: x, y, z, and further columns."""
Blocks = Callable[[], Iterator[Block]]
MOST_LINES = 2_000_000
"""Points with more distinct x or y values than this are not on a lattice."""
MOST_PIXELS = 400_000_000
FREE_PIXELS = 4_000_000
LEAST_FILLED = 1e-3
"""Least fraction of pixels with a point, above `FREE_PIXELS`: one stray point would take the memory of a wafer."""
_OFF = 0.1
"""Largest distance of a lattice point from its pixel centre, in pixels."""
_SPARSE = 0.02
"""Least fraction of occupied lattice positions."""
_UNEVEN = 1e-3
_TOO_FEW = 2
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PointLattice:
    """Pixel size and origin of a lattice in um, and its shape."""

    pixel_um: float
    x0_um: float
    y0_um: float
    rows: int
    cols: int


@dataclass(frozen=True, slots=True)
class PointCloud:
    """Points of a file: block iterator factory, units of x, y, z in um, embedded metadata, and provenance if known."""

    blocks: Blocks
    unit_um: tuple[float, float, float]
    about: EmbeddedMetadata | None = None
    provenance: Provenance | None = None
    most_points: int = MOST_PIXELS
    """Points that the file can hold at most, by its size."""


def surface_of_comments(blocks: Blocks, n_points: int, comments: dict[str, str], options: ReadOptions) -> HeightMap:
    """Return the gridded surface of a file whose comments by name tell its unit and what this program embedded."""
    about = parse_metadata(embedded := comments.get(OURS))
    texts = {name: text for name, text in comments.items() if name != OURS}
    came_from = provenance_of(about, embedded, *texts, *texts.values())
    units = units_of(comments.get("unit"), about, options)
    return surface_of_points(PointCloud(blocks, units, about, came_from, n_points), options)


def surface_of_points(points: PointCloud, options: ReadOptions) -> HeightMap:
    """Return the gridded surface. Raises DatasetError for scattered points without a given pixel size."""
    requested_um = options.overrides.pixel_um
    about = points.about
    if about is not None:
        lattice = PointLattice(about.pixel_um, about.x0_um, about.y0_um, about.rows, about.cols)
        _require_room(lattice, points, options)
        if (surface := assign_to_lattice(points, lattice, options)) is not None:
            return surface
    lattice = _detect_lattice(points, options)
    if lattice is not None and (requested_um is None or abs(requested_um / lattice.pixel_um - 1) < _UNEVEN):
        _require_room(lattice, points, options)
        if (surface := assign_to_lattice(points, lattice, options)) is not None:
            return surface
    if requested_um is None:
        raise options.refuse(
            "has scattered points, on no regular lattice: say on what to grid them, as in --pixel-um 0.5."
        )
    return _gridded(points, requested_um, options)


def assign_to_lattice(points: PointCloud, lattice: PointLattice, options: ReadOptions) -> HeightMap | None:
    """Assign each point to its lattice position; None if one is off the lattice, outside, or a duplicate."""
    layers = _Layers(lattice)
    for block in points.blocks():
        x_um, y_um, z_um = _um(block, points)
        col, row = (x_um - lattice.x0_um) / lattice.pixel_um, (lattice.y0_um - y_um) / lattice.pixel_um
        cols, rows = np.rint(col).astype(np.int64), np.rint(row).astype(np.int64)
        off = max(float(np.abs(col - cols).max(initial=0)), float(np.abs(row - rows).max(initial=0)))
        inside = (cols >= 0) & (cols < lattice.cols) & (rows >= 0) & (rows < lattice.rows)
        if off > _OFF or not inside.all() or not layers.put(rows * lattice.cols + cols, z_um, block):
            return None
    return layers.surface(points.provenance, options)


class _Layers:
    """Layers of a surface during gridding; columns that the file lacks take no memory."""

    def __init__(self, lattice: PointLattice) -> None:
        self._lattice, self._n = lattice, lattice.rows * lattice.cols
        self._z = np.full(self._n, np.nan, np.float32)
        self._origin: NDArray[np.uint8] | None = None
        self._confidence: NDArray[np.float32] | None = None
        self._u: NDArray[np.float32] | None = None
        self._grey: NDArray[np.uint8] | None = None

    def put(self, index: NDArray[np.int64], z_um: Floats, block: Block) -> bool:
        """Store points; False if two share a position."""
        if np.isfinite(self._z[index]).any():
            return False
        self._z[index] = z_um
        if len(index) != np.count_nonzero(np.diff(np.sort(index))) + 1 and len(index):
            return False
        if "origin" in block:
            self._origin = np.full(self._n, Origin.NO_REASON, np.uint8) if self._origin is None else self._origin
            self._origin[index] = block["origin"]
        if "confidence" in block:
            self._confidence = np.zeros(self._n, np.float32) if self._confidence is None else self._confidence
            self._confidence[index] = block["confidence"]
        if "u_um" in block:
            self._u = np.full(self._n, np.nan, np.float32) if self._u is None else self._u
            self._u[index] = block["u_um"]
        if "grey" in block:
            self._grey = np.zeros(self._n, np.uint8) if self._grey is None else self._grey
            self._grey[index] = block["grey"]
        return True

    def surface(self, provenance: Provenance | None, options: ReadOptions) -> HeightMap:
        """Return the gridded surface."""
        shape, here = (self._lattice.rows, self._lattice.cols), self._lattice
        place = here.pixel_um, here.x0_um, here.y0_um
        more = [name for name, layer in (("confidence", self._confidence), ("grey", self._grey)) if layer is not None]
        held = " and ".join(["heights", *more]) if more else "heights only"
        plain = heights_only(options, self._z.reshape(shape), *place, provenance, held)
        finite = np.isfinite(plain.z_um)
        layers: dict[str, Any] = {}
        if self._origin is not None and bool((self._origin[finite.ravel()] < Origin.NOT_COVERED).all()):
            layers["origin"] = self._origin.reshape(shape)
            filled = layers["origin"] == Origin.FILLED
            if filled.any():
                layers["z_raw_um"] = np.where(filled, np.float32(np.nan), plain.z_um)
        if self._confidence is not None:
            layers["confidence"] = self._confidence.reshape(shape)
        if self._u is not None:
            layers["u_um"] = self._u.reshape(shape)
        if self._grey is not None:
            layers["all_in_focus"] = self._grey.reshape(shape)
        return replace(plain, **layers)


def _gridded(points: PointCloud, pixel_um: float, options: ReadOptions) -> HeightMap:
    """Grid scattered points: each pixel is the mean of the points in it, NaN without any."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for block in points.blocks():
        x_um, y_um, _ = _um(block, points)
        low = np.minimum(low, [x_um.min(initial=np.inf), y_um.min(initial=np.inf)])
        high = np.maximum(high, [x_um.max(initial=-np.inf), y_um.max(initial=-np.inf)])
    if not np.isfinite(low).all():
        raise options.refuse("contains no heights: export it again from a measured surface.")
    cols, rows = (int(n) for n in np.floor((high - low) / pixel_um + 0.5) + 1)
    lattice = PointLattice(pixel_um, float(low[0]), float(high[1]), rows, cols)
    _require_room(lattice, points, options)
    sums, counts = np.zeros(rows * cols), np.zeros(rows * cols, np.uint32)
    for block in points.blocks():
        x_um, y_um, z_um = _um(block, points)
        col, row = (np.floor(d / pixel_um + 0.5).astype(np.int64) for d in (x_um - low[0], high[1] - y_um))
        pixels, which = np.unique(row * cols + col, return_inverse=True)  # time and memory go with the points
        sums[pixels] += np.bincount(which, z_um, len(pixels))
        counts[pixels] += np.bincount(which, minlength=len(pixels)).astype(np.uint32)
    z_um = np.full(rows * cols, np.nan, np.float32)
    np.divide(sums, counts, out=z_um, where=counts > 0, casting="unsafe")
    options.notes.append(f"Its points were gridded on {pixel_um:g} um: each pixel is the mean of those in it.")
    simulated = points.provenance is not None and points.provenance.simulated
    came_from = Provenance(simulated=True) if simulated else None
    return heights_only(options, z_um.reshape(rows, cols), pixel_um, lattice.x0_um, lattice.y0_um, came_from)


def _detect_lattice(points: PointCloud, options: ReadOptions) -> PointLattice | None:
    """Detect the lattice of the points; None if there is none."""
    xs, ys, n_points = np.empty(0), np.empty(0), 0
    for block in points.blocks():
        x_um, y_um, _ = _um(block, points)
        xs, ys, n_points = np.union1d(xs, x_um), np.union1d(ys, y_um), n_points + len(x_um)
        if max(len(xs), len(ys)) > MOST_LINES:
            return None
    if not n_points:
        raise options.refuse("contains no heights: export it again from a measured surface.")
    if min(len(xs), len(ys)) < _TOO_FEW:
        raise options.refuse("has its points on one line: give a file with a surface.")
    along, across = pitch_of(xs), pitch_of(ys)
    if along is None or across is None:
        return None
    cols, rows = along[1], across[1]
    if n_points < _SPARSE * rows * cols:
        return None
    if abs(along[0] / across[0] - 1) > _UNEVEN:
        options.pixel_um(along[0], across[0])
    pixel_um = (xs[-1] - xs[0] + ys[-1] - ys[0]) / (cols + rows - 2)
    return PointLattice(float(pixel_um), float(xs[0]), float(ys[-1]), rows, cols)


def pitch_of(values: Floats) -> tuple[float, int] | None:
    """Return the pitch of sorted values and the number of positions; None if they are irregular."""
    steps = np.diff(values)
    smallest = float(steps.min())
    pitch = float(np.median(steps[steps < 1.5 * smallest]))  # rounded texts scatter a little about it
    places = np.rint(steps / pitch)
    if places.min() < 1 or np.abs(steps / pitch - places).max() > 2 * _OFF * max(1.0, float(places.max())):
        return None
    index = np.concatenate([[0.0], np.cumsum(places)])
    pitch = float((values[-1] - values[0]) / index[-1])
    off = np.abs(values - values[0] - index * pitch).max()
    return (pitch, int(index[-1]) + 1) if off <= _OFF * pitch else None


def _require_room(lattice: PointLattice, points: PointCloud, options: ReadOptions) -> None:
    n_pixels = lattice.rows * lattice.cols
    if n_pixels > min(limit(MOST_PIXELS), limit(max(FREE_PIXELS, round(points.most_points / LEAST_FILLED)))):
        raise options.refuse(
            f"would have {lattice.rows} x {lattice.cols} pixels of {lattice.pixel_um:g} um, too many for its points: "
            "give a larger --pixel-um, or take out points far from the others."
        )


def _um(block: Block, points: PointCloud) -> tuple[Floats, Floats, Floats]:
    """Return x, y and z in um of the points with a height; removes the other points from the block."""
    finite = np.isfinite(block["x"]) & np.isfinite(block["y"]) & np.isfinite(block["z"])
    if not finite.all():
        for name in block:
            block[name] = block[name][finite]
    x, y, z = (block[name].astype(np.float64) * unit for name, unit in zip("xyz", points.unit_um, strict=True))
    return x, y, z


AT_A_TIME = 1_000_000
"""Number of points in memory at a time."""
_CUT_OFF = "is truncated, it has fewer points than its header states: copy it again."


def count(strips: Strips, part: int, of: int) -> int:
    """Return the number of pixels with a height."""
    return sum(int(np.isfinite(z_um).sum()) for z_um in strips.layer("z_um", part, of))


def points_of(part: HeightMap, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return stage x, y and z of pixels, [point, 3]."""
    return np.stack([part.x_um[cols], part.y_um[rows], part.z_um[rows, cols].astype(np.float64)], axis=1)


def eight_bits(grey: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Convert 16-bit grey to 8 bits by its upper byte, with the same scale in all strips."""
    return grey.astype(np.uint8) if grey.dtype.itemsize == 1 else (grey >> 8).astype(np.uint8)


def units_of(
    named_unit: str | None, about: EmbeddedMetadata | None, options: ReadOptions
) -> tuple[float, float, float]:
    """Return the units of x, y and z in um; a point cloud has one unit, given by the file or the user."""
    unit = "um" if about is not None else named_unit
    z_um = options.z_scale_um(unit)
    lateral_um = UNITS_UM[(unit or options.overrides.z_unit or "").strip().lower()]
    return lateral_um, lateral_um, z_um


def require_points(path: Path, n_points: int, options: ReadOptions) -> None:
    """Raise DatasetError when a header states more points than the file has bytes."""
    if n_points > path.stat().st_size:
        raise options.refuse(_CUT_OFF)


def records(
    path: Path, begin: int, n_points: int, fields: list[tuple[str, str]], options: ReadOptions
) -> Iterator[Any]:
    """Yield binary points in blocks, as views of the file. Raises DatasetError when the file ends too early."""
    point = np.dtype(fields)
    if path.stat().st_size < begin + n_points * point.itemsize:
        raise options.refuse(_CUT_OFF)
    table = np.memmap(path, point, "r", begin, (n_points,)) if n_points else np.empty(0, point)
    for start in range(0, n_points, AT_A_TIME):
        yield table[start : start + AT_A_TIME]


def text_records(
    path: Path, begin: int, n_points: int, fields: list[tuple[str, str]], options: ReadOptions
) -> Iterator[Any]:
    """Yield points from lines of text in blocks. Raises DatasetError for a truncated or non-numeric file."""
    with path.open("rb") as file:
        file.seek(begin)
        for start in range(0, n_points, AT_A_TIME):
            wanted = min(AT_A_TIME, n_points - start)
            lines = list(islice(file, wanted))
            if len(lines) != wanted:
                raise options.refuse(_CUT_OFF)
            try:
                yield np.loadtxt(lines, np.dtype(fields), ndmin=1)
            except ValueError as fault:
                raise options.refuse("has points that are not numbers: write it again.") from fault
