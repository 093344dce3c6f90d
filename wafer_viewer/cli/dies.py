"""Command that finds the dies of a surface, or aligns a given die grid with it; JSON, stage um.

The signature of a command defines its flags, its docstring is the help.
"""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Literal

import msgspec
from tyro.conf import arg

from wafer_viewer.cli.arguments import File, Place, Source
from wafer_viewer.cli.output import print_json
from wafer_viewer.session.inspection.die_lattice_source import GivenDies

Size = Annotated[tuple[float, float], arg(metavar="W H")]


def measure_dies(
    src: Source,
    pitch_um: Place | None = None,
    origin_um: Place | None = None,
    size_um: Size | None = None,
    angle_deg: float = 0.0,
    job: File = None,
    as_given: bool = False,
    evidence: Literal["height", "picture", "both"] = "both",
    field: int = 0,
    result: str = "default",
) -> None:
    """The lattice of the dies and the state of each, whole, cut, partly or not scanned, missing; as JSON. Stage um.

    Dies are those of the dataset's own job, or as the flags say, and lie where they are seen; `off` says how far that
    is from where they were given. Without either they are found.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        pitch_um: From die to die along x and y; found on the surface where it is left out.
        origin_um: The lower left corner of die 0,0; with --pitch-um.
        size_um: Width and height of a die without its street; with --pitch-um. As large as the pitch by default.
        angle_deg: How the lattice is turned, anticlockwise; with --pitch-um.
        job: The PLAN.toml whose dies these are, instead.
        as_given: Leave given dies where they were given.
        evidence: What dies are found by: heights, the all-in-focus picture, or both.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.dies.die_lattice import pitches
    from wafer_viewer.measure.dies.die_status import statuses
    from wafer_viewer.session.surface.headless import job_of, measured_surface

    given = GivenDies(pitch_um, origin_um, size_um, angle_deg, job, as_given)
    surface, calibrated = measured_surface(src, field, result)
    dies = given.on(surface, job_of(src), evidence)
    along_x, along_y = pitches(surface, dies.grid, calibration_valid=calibrated)
    states = statuses(surface, dies.grid)
    facts = {
        "grid": dies.grid,
        "off": dies.off,
        "pitch_x": along_x,
        "pitch_y": along_y,
        "counts": Counter(die.state for die in states),
        "dies": states,
        "simulated": surface.provenance.simulated,
    }
    print_json(msgspec.to_builtins(facts))
