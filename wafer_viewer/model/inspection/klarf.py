"""Contents of a KLARF file: wafer, lattice of dies, and defects in um from the corners of their dies."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np

from wafer_viewer.model.acquisition.sample import Alignment, Notch, Sample
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Count, NonNegative, Positive, Setting, Spec, Within, replace

BINS = {"open": 0, "real": 1, "nuisance": 2}
"""ROUGHBINNUMBER of each judgement."""


class KlarfImage(Spec, frozen=True, kw_only=True):
    """Image of a defect: a page, counted from 1, of a file next to the KLARF."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    file: str
    page: Count = 1


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
    images: tuple[KlarfImage, ...] = ()


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


NOTCHES: dict[Notch, str] = {"none": "Not given", "down": "Down", "left": "Left", "up": "Up", "right": "Right"}


class KlarfExport(Spec, frozen=True, kw_only=True):
    """Data that a KLARF states and an inspection does not hold; none of it is assumed.

    center_x_um, center_y_um: stage position of the wafer centre, None if the wafer was not aligned; notch: "none" if
    not known; diameter_mm: of the wafer; step: process step, StepID. images: write an image of each defect.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    center_x_um: Annotated[float | None, Setting("Wafer centre x, µm", "On the stage; an alignment gives it")] = None
    center_y_um: Annotated[float | None, Setting("Wafer centre y, µm", "On the stage; an alignment gives it")] = None
    notch: Annotated[Notch, Setting("Notch", "Side of the wafer at which its notch lies", titles=NOTCHES)] = "none"
    diameter_mm: Annotated[float | None, Within(0, open_low=True), Setting("Diameter, mm", "Of the wafer")] = None
    step: Annotated[str, Setting("Process step", "StepID of the file, by which yield systems sort")] = ""
    images: Annotated[bool, Setting("Images", "Write the picture of each defect to a TIFF next to the file")] = False

    @classmethod
    def of(cls, sample: Sample, alignment: Alignment | None = None) -> KlarfExport:
        """Return what a sample and its alignment state."""
        x_um, y_um = alignment.to_stage(0.0, 0.0) if alignment is not None else (None, None)
        across_um = max(sample.width_um or 0.0, sample.height_um or 0.0)
        diameter_mm = across_um / UM_PER_MM if across_um else None
        return cls(center_x_um=x_um, center_y_um=y_um, notch=sample.notch, diameter_mm=diameter_mm)

    def over(self, other: KlarfExport) -> KlarfExport:
        """Return this data, completed by `other`."""
        own = {name: value for name in self.__struct_fields__ if (value := getattr(self, name)) != _OPEN[name]}
        return replace(other, **own)

    def require_complete(self) -> None:
        """Raise DatasetError that names everything that is not known."""
        lacking = [words for name, words in _STATED.items() if getattr(self, name) == _OPEN[name]]
        if lacking:
            raise DatasetError(f"A KLARF states {', '.join(lacking)}: give what is missing, nothing is assumed.")


UM_PER_MM = 1000.0
_OPEN = {name: getattr(KlarfExport(), name) for name in KlarfExport.__struct_fields__}
_STATED = {
    "center_x_um": "the wafer's centre on the stage (align the wafer, or --center-um)",
    "notch": "the side of the notch (--notch)",
    "diameter_mm": "the wafer's diameter (--diameter-mm)",
    "step": "the process step (--step)",
}
"""Required data, and how it is given."""
