"""What a simulated grid of fields is made of, and the dice that are thrown for it: where its fields really lie."""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.truth.endless_wafer import Wafer
from wafer_viewer.model.acquisition.plan import Field, FieldGrid

PIXEL_UM = 0.46729
VERSION = 5
"""Counted up when the same parameters make other fields than before."""
Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grid:
    """What is simulated. Errors are standard deviations; fields and edges are told by their place in the list, from 0.

    noise_um: of heights where confidence is 1, growing as 1 / confidence; grey_noise: of pictures, counts;
    shiver_px: of the places of parts of a field about where they should be, along x and along y; gap_fraction: pixels
    without a height, in patches; brightness: relative change of the light from field to field; textured_fraction: of
    the cells of a die;
    blank_fraction, wrong_fraction: of the overlaps, blank ones without anything to see, wrong ones with the second
    field seeing the sample 15 px off; turned (by half a turn), mirrored, foreign (another wafer), empty (all NaN);
    field_sag_um: a form that all fields share, at their corners; camera_turn (rad) and camera_scale (fraction): of the
    pixels against the stage; bow_um: of the wafer, from the centre to the corner of the grid.
    """

    rows: int = 16
    cols: int = 13
    field_rows: int = 1080
    field_cols: int = 1440
    overlap_x: float = 0.12
    overlap_y: float = 0.12
    stage_error_px: float = 6.0
    z_error_um: float = 1.0
    tilt_error: float = 1e-4
    noise_um: float = 0.85
    grey_noise: float = 2.0
    shiver_px: float = 0.1
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
            overlap_x_fraction=self.overlap_x,
            overlap_y_fraction=self.overlap_y,
        )
        return grid.centred_on(0, 0)

    @property
    def edges(self) -> NDArray[np.int32]:
        """The neighbours, [n, 2]: those in a row, then those in a column."""
        number = np.arange(self.rows * self.cols, dtype=np.int32).reshape(self.rows, self.cols)
        neighbour = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1)
        below = np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1)
        return np.concatenate([neighbour, below])

    @property
    def name(self) -> str:
        """A name for all its parameters that are not as a rule."""
        reported = [
            (f.name, getattr(self, f.name)) for f in dataclasses.fields(self) if getattr(self, f.name) != f.default
        ]
        return f"{self.rows}x{self.cols}-{hashlib.sha256(f'{VERSION} {reported}'.encode()).hexdigest()[:12]}"


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
