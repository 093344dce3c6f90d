"""Overlay of the defects in a KLARF file of another tool on a surface, with the mapping of its dies."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.klarf import Klarf
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.inspection_state import SAME_PLACE_UM, OtherTool

KlarfUnit = Literal["um", "nm", "mm"]
SAME_PITCH = 5e-3
"""Relative pitch difference above which dies are of different products."""


def overlay_klarf(
    path: Path,
    alignment: Alignment | None,
    inspection: Inspection | None,
    unit: KlarfUnit | None = None,
    within_um: float = SAME_PLACE_UM,
) -> OtherTool:
    """Return the defects of a file in the coordinates of a surface.

    Raises DatasetError for what `read_klarf` refuses, dies of another pitch, and a distance that is not positive.
    """
    from wafer_viewer.store.tables.klarf import read_klarf

    if within_um <= 0:
        raise DatasetError(f"The same place is within {within_um:g} um: give more than 0.")
    klarf = read_klarf(path, unit)
    grid, by = lattice_for(klarf, alignment, inspection, path.name, within_um)
    return OtherTool(path.name, klarf, grid, by, within_um)


def compared(other: OtherTool, inspection: Inspection) -> dict[str, Any]:
    """Return the matched and unmatched defects of both inspections by number, as values to be printed."""
    found = inspection.found
    matched = other.matched(found)
    return {
        "file": other.name,
        "places": len(other.klarf.defects),
        "same_within_um": other.within_um,
        "dies": other.by,
        "matched": {str(their_number): our_number for their_number, our_number in sorted(matched.items())},
        "not_found_here": [defect.number for defect, _ in other.unmatched(found)],
        "not_in_file": sorted({defect.number for defect in found} - set(matched.values())),
        "notes": list(other.klarf.notes),
        "simulated": other.klarf.simulated,
    }


def lattice_for(
    klarf: Klarf,
    alignment: Alignment | None,
    inspection: Inspection | None,
    name: str,
    within_um: float = SAME_PLACE_UM,
) -> tuple[DieGrid, str]:
    """Return the lattice that the positions of a KLARF file refer to, stage um, and a description of its source.

    With an inspection, its dies are used. They are numbered from the wafer's centre if both file and alignment give it;
    without an alignment by their numbers, or with the centre at the stage's zero if that matches more defects. Without
    dies, the file's own lattice about the wafer's centre is used. Raises DatasetError if the pitches differ.
    """
    if inspection is None or (grid := inspection.grid) is None:
        return _about_center(klarf, alignment), "its own dies about the wafer's centre"
    _require_pitch(klarf, grid, name)
    by_numbers = grid, "dies by their numbers"
    if not (klarf.center_x_um or klarf.center_y_um):
        return by_numbers
    if alignment is not None:
        return _by_center(klarf, alignment, grid), "dies by the wafer's centre"
    at_zero = _by_center(klarf, Alignment(), grid), "dies by the wafer's centre, taken to be at the stage's zero"
    return max(by_numbers, at_zero, key=lambda candidate: len(klarf.matched(inspection.found, within_um, candidate[0])))


def _by_center(klarf: Klarf, alignment: Alignment, grid: DieGrid) -> DieGrid:
    """Return the lattice with the die numbers of the file."""
    x_um, y_um = grid.corner(*_steps(klarf, alignment, grid))
    return replace(grid, x0_um=x_um, y0_um=y_um)


def _about_center(klarf: Klarf, alignment: Alignment | None) -> DieGrid:
    """Return the file's lattice, rotated and shifted by the wafer's alignment on the stage."""
    if alignment is None:
        return klarf.grid
    lattice = klarf.grid
    x_um, y_um = alignment.to_stage(lattice.x0_um, lattice.y0_um)
    return replace(lattice, x0_um=x_um, y0_um=y_um, angle_rad=-alignment.rotation_rad)


def _steps(klarf: Klarf, alignment: Alignment, grid: DieGrid) -> tuple[int, int]:
    """Return the columns and rows between die 0,0 of the file and die 0,0 of the lattice."""
    cols, rows, u_um, v_um = grid.to_die(*(np.asarray(um) for um in alignment.to_stage(0.0, 0.0)))
    x_um, y_um = float(cols) * grid.pitch_x_um + float(u_um), float(rows) * grid.pitch_y_um + float(v_um)
    return round((x_um - klarf.center_x_um) / grid.pitch_x_um), round((y_um - klarf.center_y_um) / grid.pitch_y_um)


def _require_pitch(klarf: Klarf, grid: DieGrid, name: str) -> None:
    pairs = ((klarf.pitch_x_um, grid.pitch_x_um), (klarf.pitch_y_um, grid.pitch_y_um))
    if any(abs(theirs / ours - 1) > SAME_PITCH for theirs, ours in pairs):
        raise DatasetError(
            f"{name} has dies {klarf.pitch_x_um:.6g} x {klarf.pitch_y_um:.6g} um apart and this surface "
            f"{grid.pitch_x_um:.6g} x {grid.pitch_y_um:.6g} um: it is of another product, or in another unit."
        )
