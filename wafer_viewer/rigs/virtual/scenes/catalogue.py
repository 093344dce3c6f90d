"""Catalogue of the virtual samples, as functions of stage micrometres.

A scene is two sheets, A over B, both defined everywhere, and the share of A at each point: a die over the trench floor,
the upper gauge block over the lower. Two sheets are enough for walls, and light can then bleed from one to the other as
it does in a microscope (see optics).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.virtual.scenes import die, metal_parts, tour_wafer, wafer
from wafer_viewer.rigs.virtual.scenes.drawing import Points, SceneSheets, empty_sheets

Outline = tuple[tuple[float, float], ...]
SHARP_UM = 1e-3  # a footprint so small that every edge is hard


@dataclass(frozen=True, slots=True)
class SceneWindow:
    """Lattice on the stage: the centre of sample (0, 0), the distance between samples, their number."""

    x0_um: float
    y0_um: float
    step_um: float
    rows: int
    cols: int

    def grown(self, margin: int) -> SceneWindow:
        """Return the window with a margin of samples on all sides."""
        out = margin * self.step_um
        return SceneWindow(
            self.x0_um - out, self.y0_um + out, self.step_um, self.rows + 2 * margin, self.cols + 2 * margin
        )

    def points(self) -> tuple[Points, Points]:
        """Return x and y in um of every sample, [row, col]."""
        x = self.x0_um + self.step_um * np.arange(self.cols, dtype=np.float64)
        y = self.y0_um - self.step_um * np.arange(self.rows, dtype=np.float64)
        return np.tile(x, (self.rows, 1)), np.repeat(y, self.cols).reshape(self.rows, self.cols)


@dataclass(frozen=True, slots=True)
class DieLayout:
    """Positions of the dies of a scene: cells of a grid, some of them with a centred die."""

    pitch_x_um: float
    pitch_y_um: float
    width_um: float
    height_um: float
    x0_um: float
    y0_um: float
    cells: tuple[tuple[int, int], ...]
    """(column, row) of every die, from 0; the cell (0, 0) has its lower left corner at (x0_um, y0_um)."""

    def rectangle_um(self, column: int, row: int) -> tuple[float, float, float, float]:
        """Return (left, lower, right, upper) of a die in stage um."""
        left = self.x0_um + column * self.pitch_x_um + (self.pitch_x_um - self.width_um) / 2
        lower = self.y0_um + row * self.pitch_y_um + (self.pitch_y_um - self.height_um) / 2
        return left, lower, left + self.width_um, lower + self.height_um


@dataclass(frozen=True, slots=True)
class Scene:
    """One sample: its appearance and size, and the parameters of its tour.

    Lengths are stage um; the sample is centred on (0, 0). `gain` is the exposure factor for good brightness.
    `tour_area_um`: width and height covered by the fields of the tour, 3 x 3 fields if None. `tour_scene`: the sample
    that is loaded for the tour, by default this one.
    """

    name: str
    title: str
    fill: Callable[[Points, Points, float, SceneSheets], None]
    gain: float
    width_um: float
    height_um: float
    z_min_um: float
    z_max_um: float
    outline_um: Outline
    tour_center_um: tuple[float, float]
    tour_z_start_um: float
    tour_z_step_um: float
    tour_frames: int
    dies: DieLayout | None = None
    tour_area_um: tuple[float, float] | None = None
    tour_scene: str = ""

    def raster(self, window: SceneWindow) -> SceneSheets:
        """Return the scene on a lattice, each sample averaged over one step."""
        return self._at(*window.points(), window.step_um)

    def truth(self, x_um: ArrayLike, y_um: ArrayLike) -> NDArray[np.float32]:
        """Return true heights in um at points of any shape, as seen from straight above. For validation only."""
        x, y = np.broadcast_arrays(np.asarray(x_um, float), np.asarray(y_um, float))
        flat = self._at(x.reshape(1, -1).copy(), y.reshape(1, -1).copy(), SHARP_UM)
        return flat.surface_um().reshape(x.shape)

    def _at(self, x: Points, y: Points, footprint_um: float) -> SceneSheets:
        sheets = empty_sheets(x.shape)
        self.fill(x, y, float(footprint_um), sheets)
        return sheets


def rectangle(width_um: float, height_um: float) -> Outline:
    """Return a rectangle about (0, 0), anticlockwise."""
    x, y = width_um / 2, height_um / 2
    return (-x, -y), (x, -y), (x, y), (-x, y)


def flatted_disc(radius_um: float, flat_um: float, corners: int = 96) -> Outline:
    """Return a disc about (0, 0) cut off below y = flat_um, anticlockwise, with the flat as its closing edge."""
    start = math.asin(flat_um / radius_um)
    angles = np.linspace(start, math.pi - start, corners)
    return tuple((float(radius_um * math.cos(a)), float(radius_um * math.sin(a))) for a in angles)


def wafer_dies() -> DieLayout:
    """Return the complete dies of the wafer scene, numbered as in the lettering on it."""
    grid = [(column, row) for row in range(16) for column in range(12)]
    whole = (cell for cell in grid if wafer.is_whole_die(cell[0] + wafer.FIRST_COLUMN, cell[1] + wafer.FIRST_ROW))
    return DieLayout(
        pitch_x_um=wafer.PITCH_X_UM,
        pitch_y_um=wafer.PITCH_Y_UM,
        width_um=die.WIDTH_UM,
        height_um=die.HEIGHT_UM,
        x0_um=wafer.FIRST_COLUMN * wafer.PITCH_X_UM,
        y0_um=wafer.FIRST_ROW * wafer.PITCH_Y_UM,
        cells=tuple(whole),
    )


def tour_wafer_dies() -> DieLayout:
    """Return the complete dies of the tour wafer."""
    n_cols, n_rows = (
        2 * math.ceil(tour_wafer.RADIUS_UM / um) + 1 for um in (tour_wafer.PITCH_X_UM, tour_wafer.PITCH_Y_UM)
    )
    first_col, first_row = -(n_cols // 2), -(n_rows // 2)
    grid = [(column, row) for row in range(n_rows) for column in range(n_cols)]
    return DieLayout(
        pitch_x_um=tour_wafer.PITCH_X_UM,
        pitch_y_um=tour_wafer.PITCH_Y_UM,
        width_um=tour_wafer.WIDTH_UM,
        height_um=tour_wafer.HEIGHT_UM,
        x0_um=(first_col - 0.5) * tour_wafer.PITCH_X_UM,
        y0_um=(first_row - 0.5) * tour_wafer.PITCH_Y_UM,
        cells=tuple(at for at in grid if tour_wafer.is_whole_die(at[0] + first_col, at[1] + first_row)),
    )


SCENES: dict[str, Scene] = {
    "wafer": Scene(
        name="wafer",
        title="A diced wafer with a gel drop, a scratch and particles",
        fill=wafer.fill,
        gain=1.12,
        width_um=2 * wafer.RADIUS_UM,
        height_um=2 * wafer.RADIUS_UM,
        z_min_um=-9.0,
        z_max_um=47.0,
        outline_um=flatted_disc(wafer.RADIUS_UM, wafer.FLAT_UM),
        tour_center_um=(800.0, 560.0),
        tour_z_start_um=-6.0,
        tour_z_step_um=1.0,
        tour_frames=60,
        dies=wafer_dies(),
        tour_scene="tour_wafer",
    ),
    "gauge_blocks": Scene(
        name="gauge_blocks",
        title="Two gauge blocks, 399.88 um apart in height",
        fill=partial(metal_parts.fill, metal_parts.BLOCKS),
        gain=1.6,
        width_um=6000.0,
        height_um=4000.0,
        z_min_um=-1.0,
        z_max_um=401.0,
        outline_um=rectangle(6000.0, 4000.0),
        tour_center_um=(0.0, 0.0),
        tour_z_start_um=-18.0,
        tour_z_step_um=3.5,
        tour_frames=126,
    ),
    "stair": Scene(
        name="stair",
        title="A stair of 20 um steps",
        fill=partial(metal_parts.fill, metal_parts.STAIRCASE),
        gain=1.6,
        width_um=1800.0,
        height_um=1200.0,
        z_min_um=-100.0,
        z_max_um=100.0,
        outline_um=rectangle(1800.0, 1200.0),
        tour_center_um=(0.0, 0.0),
        tour_z_start_um=-80.0,
        tour_z_step_um=2.5,
        tour_frames=60,
    ),
    "cone": Scene(
        name="cone",
        title="A turned cone, 120 um high",
        fill=partial(metal_parts.fill, metal_parts.CONE),
        gain=1.6,
        width_um=1200.0,
        height_um=1200.0,
        z_min_um=0.0,
        z_max_um=120.0,
        outline_um=rectangle(1200.0, 1200.0),
        tour_center_um=(0.0, 0.0),
        tour_z_start_um=-12.0,
        tour_z_step_um=2.5,
        tour_frames=60,
    ),
    "plane": Scene(
        name="plane",
        title="A ground plate, tilted by 4 mrad",
        fill=partial(metal_parts.fill, metal_parts.PLATE),
        gain=1.6,
        width_um=4000.0,
        height_um=4000.0,
        z_min_um=-11.0,
        z_max_um=11.0,
        outline_um=rectangle(4000.0, 4000.0),
        tour_center_um=(0.0, 0.0),
        tour_z_start_um=-15.0,
        tour_z_step_um=0.5,
        tour_frames=60,
    ),
    "tour_wafer": Scene(
        name="tour_wafer",
        title="A small diced wafer with a gel drop, a scratch and particles",
        fill=tour_wafer.fill,
        gain=1.12,
        width_um=2 * tour_wafer.RADIUS_UM,
        height_um=2 * tour_wafer.RADIUS_UM,
        z_min_um=-5.0,
        z_max_um=28.0,
        outline_um=flatted_disc(tour_wafer.RADIUS_UM, tour_wafer.FLAT_UM),
        tour_center_um=(0.0, 0.0),
        tour_z_start_um=-6.0,
        tour_z_step_um=1.0,
        tour_frames=37,
        dies=tour_wafer_dies(),
        tour_area_um=(930.0, 700.0),
    ),
}


def scene(name: str) -> Scene:
    """Return the scene of a name. Raises RigError with the choices for an unknown name."""
    if name not in SCENES:
        raise RigError(f"There is no scene '{name}'; choose one of {', '.join(SCENES)}.")
    return SCENES[name]
