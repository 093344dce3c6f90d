"""A simulated grid of height maps, as a scan leaves them behind, and the truth about each: what stitching is judged by.

    made = make(Grid())                 # the grid that figures are given for: 16 x 13 fields of 1080 x 1440, 4.5 GB
    made = make(SMALL)                  # 4 x 3 fields of 270 x 360, in a second: for tests
    made.heights, made.fields           # what the stitcher gets; layers are mapped from the disk
    made.known.x_um, .y_um, .z_um, .tilt_x, .tilt_y     # what it is to find
    made.truth(x0_um, y0_um, (rows, cols))                          # the surface anywhere

Fields are kept in the temp folder by their parameters (`made.remove()` throws them away) and are the same each time.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import shutil
import tempfile
import uuid
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.truth.endless_wafer import Floats, Lattice, Wafer, knots, look, stain
from wafer_viewer.model.plan import Field, FieldGrid
from wafer_viewer.model.surface import HeightMap, Origin, Provenance
from wafer_viewer.store.npz import read_npz, write_npz

PIXEL_UM, Z_STEP_UM, GREY_NOISE, FALSE_UM, WRONG_PX = 0.46729, 4.0, 2.0, 15.0, 15.0
VERSION = 1
"""Counted up when the same parameters make other fields than before."""
HOME = Path(tempfile.gettempdir()) / "wafer-viewer-grids"
Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grid:
    """What is simulated. Errors are standard deviations; fields and edges are told by their place in the list, from 0.

    noise_um: of heights where confidence is 1, growing as 1 / confidence; gap_fraction: pixels without a height, in
    patches; brightness: relative change of the light from field to field; textured_fraction: of the cells of a die;
    blank_fraction, wrong_fraction: of the overlaps, blank ones without anything to see, wrong ones with the second
    field seeing the sample 15 px off; turned (by half a turn), mirrored, foreign (another wafer), empty (all NaN);
    field_sag_um: a form that all fields share, at their corners; camera_turn (rad) and camera_scale (fraction): of the
    pixels against the stage; bow_um: of the wafer, from the centre to the corner of the grid.
    """

    rows: int = 16
    cols: int = 13
    field_rows: int = 1080
    field_cols: int = 1440
    overlap: float = 0.12
    stage_error_px: float = 6.0
    z_error_um: float = 1.0
    tilt_error: float = 1e-4
    noise_um: float = 0.25
    gap_fraction: float = 0.03
    false_fraction: float = 0.0005
    brightness: float = 0.0
    textured_fraction: float = 1.0
    blank_fraction: float = 0.0
    wrong_fraction: float = 0.0
    turned: tuple[int, ...] = ()
    mirrored: tuple[int, ...] = ()
    foreign: tuple[int, ...] = ()
    empty: tuple[int, ...] = ()
    field_sag_um: float = 0.0
    camera_turn: float = 0.0
    camera_scale: float = 0.0
    bow_um: float = 0.0
    seed: int = 1

    @property
    def plan(self) -> FieldGrid:
        """Where the stage is sent."""
        grid = FieldGrid(
            rows=self.rows,
            cols=self.cols,
            field_width_um=self.field_cols * PIXEL_UM,
            field_height_um=self.field_rows * PIXEL_UM,
            overlap_x_fraction=self.overlap,
            overlap_y_fraction=self.overlap,
        )
        return grid.centred_on(0, 0)

    @property
    def edges(self) -> NDArray[np.int32]:
        """The neighbours, [n, 2]: those in a row, then those in a column."""
        number = np.arange(self.rows * self.cols, dtype=np.int32).reshape(self.rows, self.cols)
        beside = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1)
        below = np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1)
        return np.concatenate([beside, below])

    @property
    def name(self) -> str:
        """A name for all its parameters."""
        told = f"{VERSION} {dataclasses.astuple(self)}"
        return f"{self.rows}x{self.cols}-{hashlib.sha256(told.encode()).hexdigest()[:12]}"


SMALL = Grid(rows=4, cols=3, field_rows=270, field_cols=360)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Where the fields of a grid really lie (centres) and how they lean: heights are too high by z_um + tilt_x (x -
    x_um) + tilt_y (y - y_um). blank, wrong: bool, of `grid.edges`."""

    grid: Grid
    x_um: Numbers
    y_um: Numbers
    z_um: Numbers
    tilt_x: Numbers
    tilt_y: Numbers
    blank: NDArray[np.bool_]
    wrong: NDArray[np.bool_]
    wafer: Wafer


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A simulated grid: fields, their height maps on the disk, and the truth about them."""

    known: Truth
    fields: tuple[Field, ...]
    files: tuple[Path, ...]
    heights: tuple[HeightMap, ...]

    @property
    def stage_x_um(self) -> Numbers:
        """Where the stage says the centres are."""
        return np.array([f.x_um for f in self.fields])

    @property
    def stage_y_um(self) -> Numbers:
        """Where the stage says the centres are."""
        return np.array([f.y_um for f in self.fields])

    def truth(self, x0_um: float, y0_um: float, shape: tuple[int, int], pixel_um: float = PIXEL_UM) -> Floats:
        """The true surface, z_um [row, col] from (x0_um, y0_um) on."""
        return look(self.known.wafer, Lattice(shape, (x0_um, y0_um), (pixel_um, 0.0), (0.0, -pixel_um)))[0]

    def remove(self) -> None:
        """Throw the files away."""
        shutil.rmtree(self.files[0].parent)


def make(grid: Grid, threads: int = 2) -> Made:
    """The grid from the disk, or simulated now."""
    truth, fields = truth_of(grid), grid.plan.fields()
    folder = HOME / grid.name
    if not folder.exists():
        _write(truth, fields, folder, threads)
    files = tuple(folder / f"{field.name}.npz" for field in fields)
    return Made(truth, fields, files, tuple(map(read_npz, files)))


def truth_of(grid: Grid) -> Truth:
    """The dice that are thrown for a grid."""
    rng = np.random.default_rng(grid.seed)
    fields = grid.plan.fields()
    x, y = np.array([(f.x_um, f.y_um) for f in fields]).T
    off_x, off_y = rng.normal(0, grid.stage_error_px * PIXEL_UM, (2, len(fields)))
    z, (tilt_x, tilt_y) = rng.normal(0, grid.z_error_um, len(fields)), rng.normal(0, grid.tilt_error, (2, len(fields)))
    order = rng.permutation(len(grid.edges)) / max(1, len(grid.edges))
    blank = order < grid.blank_fraction
    wrong = (order >= grid.blank_fraction) & (order < grid.blank_fraction + grid.wrong_fraction)
    wafer = Wafer(
        textured_fraction=grid.textured_fraction,
        bow_um=grid.bow_um,
        bow_radius_um=float(np.hypot(grid.plan.width_um, grid.plan.height_um) / 2),
        seed=grid.seed,
        blank_um=tuple(_shared_um(grid, fields[a], fields[b]) for a, b in grid.edges[blank]),
    )
    return Truth(grid, x + off_x, y + off_y, z, tilt_x, tilt_y, blank, wrong, wafer)


def _shared_um(grid: Grid, first: Field, second: Field) -> tuple[float, float, float, float]:
    """The rectangle that two neighbours share, with room for the stage's errors."""
    room = (4 * grid.stage_error_px + 10) * PIXEL_UM
    half_x, half_y = grid.plan.field_width_um / 2, grid.plan.field_height_um / 2
    xs, ys = (first.x_um, second.x_um), (first.y_um, second.y_um)
    return max(xs) - half_x - room, max(ys) - half_y - room, min(xs) + half_x + room, min(ys) + half_y + room


def _write(truth: Truth, fields: tuple[Field, ...], folder: Path, threads: int) -> None:
    """Simulate all fields; the folder is there when all of them are."""
    unfinished = HOME / f"unfinished-{uuid.uuid4().hex}"
    unfinished.mkdir(parents=True)
    try:
        with ThreadPoolExecutor(threads) as pool:
            files = [unfinished / f"{field.name}.npz" for field in fields]
            list(pool.map(lambda n: write_npz(simulated(truth, fields[n], n), files[n]), range(len(fields))))
        if not folder.exists():
            unfinished.rename(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def simulated(truth: Truth, field: Field, n: int) -> HeightMap:
    """The height map of one field as a reconstruction would leave it behind; the stage says where it lies."""
    grid, rng = truth.grid, np.random.default_rng((truth.grid.seed, n))
    z, grey, sure = _seen(truth, n)
    first = tuple(rng.uniform(0, 1000, 2))
    confidence = _confidence(sure, first)
    z = z + _lean(truth, n) + _height_noise(grid, confidence, rng)
    grey = grey * _light(grid, rng) + GREY_NOISE * rng.standard_normal(z.shape, np.float32)
    origin = _origin(grid, sure, first)
    if n in grid.empty:
        origin[:] = Origin.NO_TEXTURE
    raw = np.where(origin == Origin.MEASURED, z, np.float32(np.nan)).astype(np.float32)
    filled = np.where(origin == Origin.FILLED, z, raw).astype(np.float32)
    confidence[origin >= Origin.NOT_COVERED] *= 0.3
    layers = filled, raw, confidence, np.clip(np.rint(grey), 0, 255).astype(np.uint8), origin
    return HeightMap(
        *(np.ascontiguousarray(_held(grid, n, layer)) for layer in layers),
        pixel_um=PIXEL_UM,
        x0_um=field.x_um - (grid.field_cols - 1) / 2 * PIXEL_UM,
        y0_um=field.y_um + (grid.field_rows - 1) / 2 * PIXEL_UM,
        provenance=Provenance(simulated=True, z_step_um=Z_STEP_UM, software_version="simulated grid"),
    )


def _seen(truth: Truth, n: int) -> tuple[Floats, Floats, Floats]:
    """Height, grey and sureness at a field's pixels, before the instrument adds its errors."""
    wafer = dataclasses.replace(truth.wafer, seed=truth.grid.seed + 100) if n in truth.grid.foreign else truth.wafer
    x, y = float(truth.x_um[n]), float(truth.y_um[n])
    layers = look(wafer, _pixels(truth.grid, x, y))
    for edge in np.flatnonzero(truth.wrong & (truth.grid.edges[:, 1] == n)):
        angle = edge * 2.399963
        off_x, off_y = WRONG_PX * PIXEL_UM * np.cos(angle), WRONG_PX * PIXEL_UM * np.sin(angle)
        part = _part_shared(truth.grid, edge)
        for layer, other in zip(layers, look(wafer, _pixels(truth.grid, x + off_x, y + off_y)), strict=True):
            layer[part] = other[part]
    return layers


def _pixels(grid: Grid, x_um: float, y_um: float) -> Lattice:
    """A field's pixels about its centre, turned and scaled as the camera is."""
    pixel = PIXEL_UM * (1 + grid.camera_scale)
    cos, sin = pixel * np.cos(grid.camera_turn), pixel * np.sin(grid.camera_turn)
    up, left = (grid.field_rows - 1) / 2, (grid.field_cols - 1) / 2
    first = x_um - left * cos - up * sin, y_um - left * sin + up * cos
    return Lattice((grid.field_rows, grid.field_cols), first, (cos, sin), (sin, -cos))


def _part_shared(grid: Grid, edge: int) -> tuple[slice, slice]:
    """The pixels of the second field of an edge that the first may see as well."""
    room = int(3 * grid.stage_error_px)
    if edge < grid.rows * (grid.cols - 1):
        return slice(None), slice(0, int(grid.overlap * grid.field_cols) + room)
    return slice(0, int(grid.overlap * grid.field_rows) + room), slice(None)


@functools.lru_cache(maxsize=2)
def _middle(shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """From the middle of a field up, [row, 1], and to the right, [1, col]: -1 ... 1 from border to border."""
    down, along = (np.linspace(-1, 1, n, dtype=np.float32) for n in shape)
    return -down[:, None], along[None, :]


def _confidence(sure: Floats, first: tuple[float, float]) -> Floats:
    """Lower towards the borders of a field, and in patches."""
    up, right = _middle(sure.shape)
    patches = np.empty_like(sure)
    stain(knots(3), sure.shape, 45.0, first, patches)
    rows, cols = sure.shape
    to_border = np.minimum((1 - np.abs(up)) * rows, (1 - np.abs(right)) * cols) / 2
    border = np.minimum(1.0, 0.3 + to_border / (0.05 * rows)) * (1 - 0.15 * (up**2 + right**2))
    return np.clip(sure * border * (0.85 + 0.15 * patches), 0.03, 1).astype(np.float32)


def _lean(truth: Truth, n: int) -> Floats:
    """What the z of a field's heights is off by: offset and tilt of the field, the form that all fields share."""
    grid = truth.grid
    up, right = _middle((grid.field_rows, grid.field_cols))
    dx, dy = right * (grid.field_cols - 1) / 2 * PIXEL_UM, up * (grid.field_rows - 1) / 2 * PIXEL_UM
    x, y = dx - grid.camera_turn * dy, dy + grid.camera_turn * dx
    sag = grid.field_sag_um * (up**2 + right**2) / 2
    return (truth.z_um[n] + truth.tilt_x[n] * x + truth.tilt_y[n] * y + sag).astype(np.float32)


def _height_noise(grid: Grid, confidence: Floats, rng: np.random.Generator) -> Floats:
    noise = rng.standard_normal(confidence.shape, np.float32) * (grid.noise_um / confidence)
    false = rng.integers(0, confidence.size, int(grid.false_fraction * confidence.size))
    noise.reshape(-1)[false] += rng.uniform(-FALSE_UM, FALSE_UM, len(false)).astype(np.float32)
    return noise


def _light(grid: Grid, rng: np.random.Generator) -> Floats:
    """Light falls off a little to the corners, and changes from field to field."""
    up, right = _middle((grid.field_rows, grid.field_cols))
    return (1 + grid.brightness * rng.standard_normal()) * (1 - 0.03 * (up**2 + right**2))


def _origin(grid: Grid, sure: Floats, first: tuple[float, float]) -> NDArray[np.uint8]:
    """Patches without a height, with a rim that was filled; more of them where little is to be seen."""
    patches = np.empty_like(sure)
    stain(knots(4), sure.shape, 9.0, first, patches)
    doubt = patches + 0.6 * (0.5 - sure)
    gap = np.quantile(doubt[::7, ::7], 1 - grid.gap_fraction) if grid.gap_fraction else np.inf
    origin = np.where(doubt > gap - 0.1, Origin.FILLED, Origin.MEASURED)
    return np.where(doubt > gap, Origin.NO_TEXTURE, origin).astype(np.uint8)


def _held(grid: Grid, n: int, layer: NDArray) -> NDArray:
    """As the camera was held."""
    if n in grid.turned:
        return layer[::-1, ::-1]
    return layer[:, ::-1] if n in grid.mirrored else layer
