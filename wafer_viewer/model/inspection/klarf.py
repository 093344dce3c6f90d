"""Contents of a KLARF file: wafer, lattice of dies, and defects in um from the corners of their dies."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import NonNegative, Positive, Spec, Within

CLASS_NUMBERS = {entry.name: entry.klarf_number for entry in DEFECT_CLASSES.values() if entry.klarf_number}
"""CLASSNUMBER of each class; 0 is Unclassified. Unmeasured areas are not defects and are not exported."""
BINS = {"open": 0, "real": 1, "nuisance": 2}
"""ROUGHBINNUMBER of each judgement."""


class KlarfDefect(Spec, frozen=True, kw_only=True):
    """One line of a KLARF: (u_um, v_um) is its centre from its die's lower left corner, along the lattice's axes."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    number: int
    col: int
    row: int
    u_um: float
    v_um: float
    width_um: NonNegative = 0.0
    height_um: NonNegative = 0.0
    size_um: NonNegative = 0.0
    area_um2: NonNegative = 0.0
    class_number: int = 0
    class_name: str = ""
    bin: int = 0
    test: int = 1


class Klarf(Spec, frozen=True, kw_only=True):
    """A KLARF file: (center_x_um, center_y_um) is the wafer's centre from the lower left corner of die 0,0.

    notch: where the orientation mark points, DOWN for a wafer with its notch towards the operator. dies: (col, row) of
    the dies that were inspected; notes: what was converted, or could not be checked; simulated: True where the file
    says so.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    version: str = "1.2"
    lot: str = ""
    wafer: str = ""
    slot: int = 0
    device: str = ""
    setup: str = ""
    step: str = ""
    notch: str = "DOWN"
    sample_mm: Annotated[float, Within(0)] = 0.0
    pitch_x_um: Positive
    pitch_y_um: Positive
    center_x_um: float = 0.0
    center_y_um: float = 0.0
    inspected_um2: NonNegative = 0.0
    classes: tuple[tuple[int, str], ...] = ()
    dies: tuple[tuple[int, int], ...] = ()
    defects: tuple[KlarfDefect, ...] = ()
    notes: tuple[str, ...] = ()
    simulated: bool = False

    @property
    def grid(self) -> DieGrid:
        """Lattice with the wafer centre at stage zero; dies are as large as their pitch."""
        places = [*self.dies, *((d.col, d.row) for d in self.defects)] or [(0, 0)]
        (first_col, last_col), (first_row, last_row) = ((min(part), max(part)) for part in zip(*places, strict=True))
        return DieGrid(
            pitch_x_um=self.pitch_x_um,
            pitch_y_um=self.pitch_y_um,
            width_um=self.pitch_x_um,
            height_um=self.pitch_y_um,
            x0_um=-self.center_x_um,
            y0_um=-self.center_y_um,
            first_col=first_col,
            first_row=first_row,
            cols=last_col - first_col + 1,
            rows=last_row - first_row + 1,
        )

    def outlines(self, grid: DieGrid | None = None) -> tuple[Region, ...]:
        """Return the outlines of its defects in stage um: circles of their sizes, in the order of the file.

        grid: lattice found on the surface, with the same die numbers; by default `self.grid`.
        """
        on = grid or self.grid
        places = [on.to_stage(d.col, d.row, d.u_um, d.v_um) for d in self.defects]
        sizes = [max(d.size_um, d.width_um, d.height_um, 1.0) for d in self.defects]
        return tuple(Region.circle(float(x), float(y), s / 2) for (x, y), s in zip(places, sizes, strict=True))

    def matched(self, defects: tuple[Defect, ...], within_um: float, grid: DieGrid | None = None) -> dict[int, int]:
        """Match its defects to the nearest of `defects` within a distance: number here -> number there.

        Each defect is matched once, the nearest pairs first.
        """
        x_um, y_um = (np.array([getattr(defect.center, axis) for defect in defects]) for axis in ("x_um", "y_um"))
        near: list[tuple[float, int, int]] = []
        for mine, outline in zip(self.defects, self.outlines(grid), strict=True):
            away_um = np.hypot(x_um - outline.points[0].x_um, y_um - outline.points[0].y_um)
            near += [(float(away_um[k]), mine.number, defects[k].number) for k in np.flatnonzero(away_um <= within_um)]
        pairs: dict[int, int] = {}
        taken: set[int] = set()
        for _, mine, other in sorted(near):
            if mine not in pairs and other not in taken:
                pairs[mine] = other
                taken.add(other)
        return pairs
