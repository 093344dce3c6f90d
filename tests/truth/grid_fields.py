"""One field of a simulated grid: what is to be seen at its true place, and what the instrument makes of it."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from tests.truth.endless_wafer import Floats, Lattice, knots, look, stain
from tests.truth.grid_truth import PIXEL_UM, Grid, Truth
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance

Z_STEP_UM, FALSE_UM, WRONG_PX = 4.0, 15.0, 15.0
FOREIGN_UM = 1234.5
"""So far from where they should be do foreign fields lie on their own wafer, so that not even its dies fit."""


def simulated(truth: Truth, field: Field, n: int) -> HeightMap:
    """The height map of one field as a reconstruction would leave it behind; the stage says where it lies."""
    grid, rng = truth.grid, np.random.default_rng((truth.grid.seed, n))
    z, grey, sure = _seen(truth, n)
    first = tuple(rng.uniform(0, 1000, 2))
    confidence = _confidence(sure, first)
    z = z + _lean(truth, n) + _height_noise(grid, confidence, rng)
    grey = grey * _light(grid, rng) + grid.grey_noise * rng.standard_normal(z.shape, np.float32)
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
    if n in truth.grid.foreign:
        x, y = x + FOREIGN_UM, y - FOREIGN_UM
    layers = look(wafer, _pixels(truth.grid, x, y, n))
    for edge in np.flatnonzero(truth.wrong & (truth.grid.edges[:, 1] == n)):
        angle = edge * 2.399963
        off_x, off_y = WRONG_PX * PIXEL_UM * np.cos(angle), WRONG_PX * PIXEL_UM * np.sin(angle)
        part = _part_shared(truth.grid, edge)
        for layer, other in zip(layers, look(wafer, _pixels(truth.grid, x + off_x, y + off_y, n)), strict=True):
            layer[part] = other[part]
    return layers


def _pixels(grid: Grid, x_um: float, y_um: float, n: int) -> Lattice:
    """A field's pixels about its centre, turned and scaled as the camera is; they shiver."""
    pixel = PIXEL_UM * (1 + grid.camera_scale)
    cos, sin = pixel * np.cos(grid.camera_turn), pixel * np.sin(grid.camera_turn)
    up, left = (grid.field_rows - 1) / 2, (grid.field_cols - 1) / 2
    first = x_um - left * cos - up * sin, y_um - left * sin + up * cos
    shiver = grid.shiver_px * PIXEL_UM, (17.3 * n, 29.7 * n)
    return Lattice((grid.field_rows, grid.field_cols), first, (cos, sin), (sin, -cos), *shiver)


def _part_shared(grid: Grid, edge: int) -> tuple[slice, slice]:
    """The pixels of the second field of an edge that the first may see as well."""
    room = int(3 * grid.stage_error_px)
    if edge < grid.rows * (grid.cols - 1):
        return slice(None), slice(0, int(grid.overlap_x * grid.field_cols) + room)
    return slice(0, int(grid.overlap_y * grid.field_rows) + room), slice(None)


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
