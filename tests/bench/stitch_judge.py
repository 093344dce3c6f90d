"""How right a stitched grid is: positions, heights and seams against the truth of a simulated grid.

Nothing but the stage says where the grid as a whole lies, so the mean of the errors of all positions (and of all z) is
taken off before anything is judged, for every method alike; how it is turned or stretched counts as error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tests.truth.field_grid import PIXEL_UM, Made
from wafer_viewer.model.spec import replace as replaced
from wafer_viewer.model.surface.field_poses import Form, Poses
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.reconstruct.blending.mosaic_layout import layout
from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic, blend_window, mosaic_provenance

WINDOW_PX, N_WINDOWS = 512, 64
Blend = Literal["confidence", "ramp"]
Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Positions:
    """Errors of field positions in px, in the plane: of all fields but those left out."""

    rms_px: float
    max_px: float
    without_turn_px: float


def position_error(x_um: Numbers, y_um: Numbers, made: Made, counted: NDArray[np.bool_] | None = None) -> Positions:
    """Errors of centres; `without_turn_px`: rms when a turn and a stretch of the whole grid are taken off as well."""
    known, counted = made.known, np.ones(len(x_um), bool) if counted is None else counted
    off = np.stack([x_um - known.x_um, y_um - known.y_um], axis=1)[counted] / PIXEL_UM
    off -= off.mean(axis=0)
    at = np.stack([known.x_um, known.y_um], axis=1)[counted] / PIXEL_UM
    at -= at.mean(axis=0)
    along = np.sum(off * at) / max(1e-12, np.sum(at**2))
    across = np.sum(off[:, 1] * at[:, 0] - off[:, 0] * at[:, 1]) / max(1e-12, np.sum(at**2))
    rest = off - along * at - across * np.stack([-at[:, 1], at[:, 0]], axis=1)
    far = np.hypot(*off.T)
    return Positions(rms(far), float(far.max()), rms(np.hypot(*rest.T)))


def at_stage(poses: Poses) -> Poses:
    """The same fields where the stage says they are, level."""
    return without_z(replace(poses, x_um=poses.stage_x_um, y_um=poses.stage_y_um))


def at_truth(poses: Poses, made: Made) -> Poses:
    """The same fields where they really are, leaning as they really do."""
    known = made.known
    there = replace(poses, x_um=known.x_um, y_um=known.y_um, left_out=np.zeros(len(known.x_um), bool))
    return replace(there, z_um=known.z_um, tilt_x=known.tilt_x, tilt_y=known.tilt_y, form=Form())


def without_z(poses: Poses) -> Poses:
    """The same places, every field as high and level as the stage has it."""
    none = np.zeros(len(poses.x_um))
    return replace(poses, z_um=none, tilt_x=none, tilt_y=none, form=Form())


def mosaic_of(heights: Sequence[HeightMap], poses: Poses | None, blend: Blend) -> StitchedMosaic:
    """The mosaic of fields at some poses, those of the stage without any."""
    recipe = replaced(Recipe(), stitching=Stitching(blend=blend))
    return StitchedMosaic(heights, layout(heights, poses), mosaic_provenance([h.provenance for h in heights], recipe))


def rmse_um(made: Made, poses: Poses, blend: Blend, windows: int = N_WINDOWS) -> float:
    """Root mean square error of a mosaic's heights over windows strewn over it, the same for all mosaics of a grid."""
    mosaic, known = mosaic_of(made.heights, poses, blend), made.known
    off_x, off_y = float(np.mean(poses.x_um - known.x_um)), float(np.mean(poses.y_um - known.y_um))
    off_z = float(np.mean(known.z_um - poses.z_um))
    total, count = 0.0, 0
    for rows, cols in strewn(mosaic.shape, windows):
        seen = blend_window(made.heights, rows, cols, mosaic.layout, mosaic.provenance)
        error = seen.z_um - made.truth(seen.x0_um - off_x, seen.y0_um - off_y, seen.shape) - off_z
        total, count = total + float(np.nansum(np.square(error, dtype=np.float64))), count + np.isfinite(error).sum()
    return (total / count) ** 0.5


def strewn(shape: tuple[int, int], n: int) -> list[tuple[slice, slice]]:
    """Windows at the same shares of height and width whatever the shape is."""
    shares = np.random.default_rng(7).uniform(0, 1, (n, 2))
    size = [min(WINDOW_PX, length) for length in shape]
    starts = (shares * (np.array(shape) - size)).astype(int)
    return [(slice(r, r + size[0]), slice(c, c + size[1])) for r, c in starts.tolist()]


def seam_steps_um(made: Made, poses: Poses) -> Numbers:
    """What is left between neighbours, as anybody would look: the median over each overlap of the heights of one minus
    those of the other, both where the poses have them, um (absolute); without fields that were left out
    and overlaps without a height."""
    edges = [(a, b) for a, b in made.known.grid.edges.tolist() if not (poses.left_out[a] or poses.left_out[b])]
    steps = np.array([abs(_step_um(made.heights, poses, a, b)) for a, b in edges])
    return steps[np.isfinite(steps)]


def _step_um(heights: Sequence[HeightMap], poses: Poses, a: int, b: int) -> float:
    first, second = _levelled(heights[a], poses, a), _levelled(heights[b], poses, b)
    right, down = (poses.x_um[b] - poses.x_um[a]) / PIXEL_UM, (poses.y_um[a] - poses.y_um[b]) / PIXEL_UM
    rows, cols = _shared(first.shape[0], down), _shared(first.shape[1], right)
    other = _between(second, rows[1], cols[1], down % 1, right % 1)
    step = other - first[rows[0], cols[0]]
    return float(np.median(step[np.isfinite(step)])) if np.isfinite(step).any() else float("nan")


def _levelled(height: HeightMap, poses: Poses, n: int) -> Numbers:
    """A field's heights with what its pose says they are too high by taken off."""
    rows, cols = height.shape
    dx = (np.arange(cols) - (cols - 1) / 2) * PIXEL_UM
    dy = ((rows - 1) / 2 - np.arange(rows))[:, None] * PIXEL_UM
    plane = poses.z_um[n] + poses.tilt_x[n] * dx + poses.tilt_y[n] * dy
    return height.z_raw_um - plane - poses.form.sag_um(dx, dy)


def _shared(length: int, apart: float) -> tuple[slice, slice]:
    """Pixels of the first, and the pixels before them of the second, which lies `apart` further on, one side of it."""
    whole = int(np.floor(apart))
    low, high = max(0, whole + 1), min(length, whole + length)
    return slice(low, high), slice(low - whole - 1, high - whole - 1)


def _between(z: Numbers, rows: slice, cols: slice, down: float, right: float) -> Numbers:
    """Heights between pixels: the second's lattice lies `down` and `right` of the first's, so that a pixel of the first
    is that much before one of the second."""
    after = slice(rows.start + 1, rows.stop + 1), slice(cols.start + 1, cols.stop + 1)
    top = down * z[rows, cols] + (1 - down) * z[after[0], cols]
    bottom = down * z[rows, after[1]] + (1 - down) * z[after[0], after[1]]
    return right * top + (1 - right) * bottom


def rms(values: NDArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
