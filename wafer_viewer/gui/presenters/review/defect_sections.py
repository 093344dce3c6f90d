"""Section lines through a defect and through a neighbouring good die, along the die rows. Pure functions."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.die_grid import DieStatus
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.region import Region

TIMES, LEAST_PX = 4.0, 160
"""Length of the line as a multiple of the defect's size, and its least length in surface pixels."""


@dataclass(frozen=True, slots=True)
class DefectCut:
    """Line through a defect, then the same line on the good die `beside`, if any; surface and levelling."""

    lines: tuple[Region, ...]
    beside: str = ""
    show: int = 0
    levelling: Levelling = Levelling()


def cut_through(defect: Defect, inspection: Inspection | None, pixel_um: float) -> DefectCut:
    """Return the section lines of a defect."""
    x0, _, x1, _ = defect.outline.bounds_um
    length_um = max(TIMES * (x1 - x0), TIMES * defect.minor.value_um, LEAST_PX * pixel_um)
    grid = inspection.grid if inspection is not None else None
    angle = grid.angle_rad if grid is not None else 0.0
    half_x, half_y = length_um / 2 * math.cos(angle), length_um / 2 * math.sin(angle)
    middle = defect.center.x_um, defect.center.y_um
    beside = neighbour_of(defect, inspection) if inspection is not None else None
    middles = [middle]
    if grid is not None and beside is not None and defect.in_die is not None:
        x_um, y_um = grid.to_stage(beside.col, beside.row, defect.in_die.x_um, defect.in_die.y_um)
        middles.append((float(x_um), float(y_um)))
    lines = tuple(Region.line(x - half_x, y - half_y, x + half_x, y + half_y) for x, y in middles)
    return DefectCut(lines, beside.name if len(lines) > 1 and beside is not None else "", defect.show, defect.levelling)


def neighbour_of(defect: Defect, inspection: Inspection) -> DieStatus | None:
    """Return the nearest fully inspected other die, preferably one without defects; None if there is none."""
    own = next((die for die in inspection.dies if die.name == defect.die), None)
    others = [die for die in inspection.dies if die.state == "whole" and die.name != defect.die]
    if own is None or not others:
        return None
    return min(others, key=lambda die: (bool(die.defects), abs(die.col - own.col) + abs(die.row - own.row), die.col))
