"""The command that finds the dies of a surface, or lays a given lattice over it; JSON, stage um.

A signature is the command's flags, its docstring the help.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Annotated, Literal

import msgspec
from tyro.conf import arg

from wafer_viewer.arguments import Place, Source
from wafer_viewer.command_output import print_json
from wafer_viewer.measure_answers import surface_over
from wafer_viewer.model.die_grid import DieGrid
from wafer_viewer.model.errors import MeasureError

Size = Annotated[tuple[float, float], arg(metavar="W H")]


def measure_dies(
    src: Source,
    pitch_um: Place | None = None,
    origin_um: Place | None = None,
    size_um: Size | None = None,
    angle_deg: float = 0.0,
    evidence: Literal["height", "picture", "both"] = "both",
    field: int = 0,
    result: str = "default",
) -> None:
    """The lattice of the dies and the state of each, whole, cut, partly or not scanned, missing; as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        pitch_um: From die to die along x and y; found on the surface where it is left out.
        origin_um: The lower left corner of any one die; with --pitch-um.
        size_um: Width and height of a die without its street; with --pitch-um.
        angle_deg: How the lattice is turned, anticlockwise; with --pitch-um.
        evidence: What dies are found by: heights, the all-in-focus picture, or both.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.die_grid import find_dies, on_surface, pitches
    from wafer_viewer.measure.die_status import statuses

    given = _given(pitch_um, origin_um, size_um, angle_deg)
    surface, calibrated = surface_over(src, (), field, result)
    grid = on_surface(given, surface) if given else find_dies(surface, evidence=evidence)
    along_x, along_y = pitches(surface, grid, calibration_valid=calibrated)
    dies = statuses(surface, grid)
    facts = {
        "grid": grid,
        "pitch_x": along_x,
        "pitch_y": along_y,
        "counts": Counter(die.state for die in dies),
        "dies": dies,
        "simulated": surface.provenance.simulated,
    }
    print_json(msgspec.to_builtins(facts))


def _given(
    pitch_um: tuple[float, float] | None,
    origin_um: tuple[float, float] | None,
    size_um: tuple[float, float] | None,
    angle_deg: float,
) -> DieGrid | None:
    """The lattice that the flags say; None where they say nothing. Raises MeasureError where a part is left out."""
    named = {"--pitch-um": pitch_um, "--origin-um": origin_um, "--size-um": size_um}
    if pitch_um is None or origin_um is None or size_um is None:
        if any(named.values()) or angle_deg:
            missing = ", ".join(name for name, value in named.items() if value is None)
            raise MeasureError(
                f"A lattice of dies that is given needs {missing} as well: give all, or none to find it."
            )
        return None
    return DieGrid(
        pitch_x_um=pitch_um[0],
        pitch_y_um=pitch_um[1],
        x0_um=origin_um[0],
        y0_um=origin_um[1],
        width_um=size_um[0],
        height_um=size_um[1],
        angle_rad=math.radians(angle_deg),
    )
