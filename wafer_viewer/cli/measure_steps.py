"""Commands that measure steps, between faces and along lines. The signature of a command defines its flags.

What is not known of the conditions is left out and then listed as not evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from wafer_viewer.cli.arguments import Level, Line, Source
from wafer_viewer.cli.measure_common import measure, print_finding, surface_over
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import GrooveOptions, StepDefinition, ToolOptions
from wafer_viewer.model.measurement.uncertainty_conditions import STEEL_PER_K, Conditions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic

Rectangles = Annotated[tuple[tuple[float, float, float, float], ...], arg(metavar="X0 Y0 X1 Y1 ...")]
Known = Annotated[float | None, arg(metavar="UM")]


@dataclass(frozen=True, slots=True)
class Given:
    """Known conditions of the measurement; standard uncertainties, k = 1.

    Args:
        repeatability_um: Standard deviation of the height over repeat scans.
        drift_um: Of z between the two faces while they were scanned.
        z_linearity_um: Of the z axis over the step, beside its scale.
        abbe_um: From the pitch of the stage times the offset from the line of its scale.
        temperature_c: Of the sample.
        u_temperature_c: Of its temperature.
        expansion_per_k: Of its material, relative; that of steel by default.
    """

    repeatability_um: Known = None
    drift_um: Known = None
    z_linearity_um: Known = None
    abbe_um: Known = None
    temperature_c: Annotated[float | None, arg(metavar="C")] = None
    u_temperature_c: float = 0.5
    expansion_per_k: float = STEEL_PER_K

    @property
    def conditions(self) -> Conditions:
        """Conditions of the measurement."""
        return Conditions(**{name: getattr(self, name) for name in Conditions.__struct_fields__})


def measure_step(
    src: Source,
    upper: Rectangles = (),
    lower: Rectangles = (),
    faces: Literal["auto"] | None = None,
    definition: StepDefinition = "common_plane",
    given: OmitArgPrefixes[Given] = Given(),
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """The height of one face over another, with its uncertainty and what is not in it, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        upper: Two opposite corners of the upper rectangle, or of several on one face.
        lower: The same of the lower face.
        faces: auto looks for the two faces of a pair of gauge blocks, as it does without rectangles.
        definition: Where h is taken: in the middles of the regions over a plane that both faces have in common, or
            over that of the upper or the lower one; or at the joint, both faces extended.
        given: What is known of how it was measured.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.tools.step_height import step_height

    _require_one_way(bool(upper), bool(lower), faces)
    surface, calibrated = surface_over(src, level, field, result)
    high, low, notes = _faces(surface, upper, lower)
    found = step_height(
        surface, high, low, definition=definition, conditions=given.conditions, calibration_valid=calibrated
    )
    print_finding(replace(found, notes=(*notes, *found.notes)), field)


def measure_groove(
    src: Source,
    line: Line,
    width_um: float = 0.0,
    shape: Literal["groove", "step"] = "groove",
    given: OmitArgPrefixes[Given] = Given(),
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """The depth of a groove, the height of a ridge or of a single step that a line crosses (ISO 5436-1), as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        line: Both ends; it reaches beyond each edge as far as the groove is wide.
        width_um: How wide a strip across the line is averaged over; 0: a pixel.
        shape: What it crosses: two edges or one.
        given: What is known of how it was measured.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(groove=GrooveOptions(shape=shape, conditions=given.conditions))
    measure("groove", (Region.line(*line, width_um),), src, level, field, result, options)


def _require_one_way(upper: bool, lower: bool, faces: str | None) -> None:
    if upper != lower:
        given, missing = ("--upper", "--lower") if upper else ("--lower", "--upper")
        raise MeasureError(f"{given} is given and {missing} is not: give both, or neither to have the faces found.")
    if upper and faces == "auto":
        raise MeasureError("--faces auto looks for the faces that --upper and --lower give: leave one of them out.")


def _faces(
    surface: Mosaic, upper: tuple[tuple[float, ...], ...], lower: tuple[tuple[float, ...], ...]
) -> tuple[tuple[Region, ...], tuple[Region, ...], tuple[str, ...]]:
    """Return the regions of the upper and lower face, and notes on how they were found."""
    if upper:
        high, low = (tuple(Region.rectangle(*corners) for corners in each) for each in (upper, lower))
        return high, low, ()
    from wafer_viewer.measure.gauge.find_faces import find_faces

    found = find_faces(surface)
    return (found.upper,), (found.lower,), ("The faces were found automatically.", *found.notes)
