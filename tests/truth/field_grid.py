"""A simulated grid of height maps, as a scan leaves them behind, and the truth about each: what stitching is judged by.

    made = make(Grid())                 # the grid that figures are given for: 16 x 13 fields of 1080 x 1440, 4.5 GB
    made = make(SMALL)                  # 4 x 3 fields of 270 x 360, in a second: for tests
    made.heights, made.fields           # what the stitcher gets; layers are mapped from the disk
    made.known.x_um, .y_um, .z_um, .tilt_x, .tilt_y     # what it is to find
    made.truth(x0_um, y0_um, (rows, cols))                          # the surface anywhere

Fields are kept in the temp folder by their parameters (`made.remove()` throws them away) and are the same each time.
"""

from __future__ import annotations

import shutil
import tempfile
import uuid
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.truth.endless_wafer import Floats, Lattice, look
from tests.truth.grid_fields import simulated
from tests.truth.grid_truth import PIXEL_UM, SMALL, Grid, Numbers, Truth, truth_of
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.npz_file import read_npz, write_npz

__all__ = ["PIXEL_UM", "SMALL", "Grid", "Made", "Truth", "make", "simulated", "truth_of"]
HOME = Path(tempfile.gettempdir()) / "wafer-viewer-grids"


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
