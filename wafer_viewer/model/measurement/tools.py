"""Measuring tools: one descriptor each, which page, commands, jobs, reports and the Python API read.

Other packages bring tools as entry points of the group ``wafer_viewer.measuring_tools``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.face_tools import FACE_TOOLS
from wafer_viewer.model.measurement.measurements import (
    AreaVolume,
    Chipping,
    CircleSize,
    Coplanarity,
    DieSize,
    Distance,
    FaceAngle,
    KerfWidth,
    MeasurementResult,
    PointHeight,
    Profile,
    Radius,
    StepHeight,
    StepProfile,
)
from wafer_viewer.model.measurement.measuring_tool import (
    ChoiceControl,
    MeasuringTool,
    NumberControl,
    PlaceAsked,
    ToolName,
    line_place,
    rectangle_place,
)
from wafer_viewer.model.measurement.particles import ParticleOptions, Particles
from wafer_viewer.model.measurement.tool_options import (
    ChippingOptions,
    CircleOptions,
    CoplanarityOptions,
    DieOptions,
    GrooveOptions,
    KerfOptions,
    OptionsSpec,
    StepOptions,
    VolumeOptions,
)
from wafer_viewer.model.plugins import plugins
from wafer_viewer.model.spec import Spec

_CONDITIONS = (
    NumberControl("Repeats s, µm", "conditions.repeatability_um", "Spread of repeated measurements; empty: not known"),
    NumberControl("Drift u, µm", "conditions.drift_um", "Standard uncertainty by drift; empty: not known"),
    NumberControl(
        "Sample, °C", "conditions.temperature_c", "Of the sample while it was scanned; empty: not known", None
    ),
)
_BRIGHTNESS = {"Either": "either", "Bright": "bright", "Dark": "dark"}

_BUILT_IN = (
    MeasuringTool(
        name="profile",
        title="Profile",
        short="Profile",
        summary="sections along lines, paths, rows and columns: numbers, table or picture",
        help="Section along a line, as JSON. Stage um.",
        how="Drag the handles over the surface.",
        result=Profile,
        measure="wafer_viewer.measure.tools.profile:section",
        places=(line_place("The two ends of the line."),),
        initial="informative line",
        group="Sections and steps",
        symbol="P",
        main="total height Pt",
        icon="line",
        key="L",
        shift=False,
        on_toolbar=True,
    ),
    MeasuringTool(
        name="step",
        title="Step height",
        short="Step",
        summary="the height of one region over another",
        help="The height of one face over another. Stage um.",
        how="Drag the upper and the lower region over the surface.",
        result=StepHeight,
        measure="wafer_viewer.measure.tools.step_height:step_height",
        places=(
            rectangle_place("upper", "Two opposite corners of the upper rectangle.", "upper"),
            rectangle_place("lower", "The same of the lower face.", "lower"),
        ),
        initial="two levels",
        group="Sections and steps",
        symbol="S",
        icon="stairs-up",
        key="K",
        shift=False,
        on_toolbar=True,
        options=StepOptions,
        controls=(
            ChoiceControl(
                "Height taken",
                "definition",
                {
                    "Over a common plane": "common_plane",
                    "Over the lower face": "lower_face",
                    "Over the upper face": "upper_face",
                    "At the joint": "joint",
                },
                "The distance between tilted faces depends on the place",
            ),
            *_CONDITIONS,
        ),
    ),
    MeasuringTool(
        name="groove",
        title="Groove",
        short="Groove",
        summary="the depth of a groove, or the height of a step, along a line",
        help="The depth of a groove, the height of a ridge or of a single step that a line crosses. Stage um.",
        how="Drag the line across a groove or step.",
        result=StepProfile,
        measure="wafer_viewer.measure.tools.step_profile:step_profile",
        places=(line_place("Both ends; it reaches beyond each edge as far as the groove is wide."),),
        initial="line across a groove",
        group="Sections and steps",
        symbol="K",
        icon="wave-square",
        key="K",
        options=GrooveOptions,
        controls=(
            ChoiceControl(
                "It crosses", "shape", {"A groove or ridge": "groove", "A single step": "step"}, "Two edges or one"
            ),
            *_CONDITIONS,
        ),
    ),
    MeasuringTool(
        name="angle",
        title="Angle",
        short="Angle",
        summary="the angle between two faces",
        help="The angle between two faces, with its uncertainty. Stage um.",
        how="Drag a region onto each of the two faces.",
        result=FaceAngle,
        measure="wafer_viewer.measure.tools.angle:face_angle",
        places=(
            rectangle_place("first", "Two opposite corners of a rectangle on the one face.", "first"),
            rectangle_place("second", "The same on the other.", "second"),
        ),
        initial="two faces",
        group="Sections and steps",
        symbol="A",
        main="between the faces",
        icon="angle",
        key="B",
        shift=False,
        on_toolbar=True,
    ),
    MeasuringTool(
        name="point",
        title="Point",
        short="Point",
        summary="the height at a point",
        help="The height at a point, with its uncertainty. Stage um.",
        how="Drag the point, or click where to measure.",
        result=PointHeight,
        measure="wafer_viewer.measure.tools.point:point_height",
        places=(PlaceAsked("point", "point", "at", "Where the point is."),),
        initial="point",
        group="Places",
        symbol="H",
        main="height",
        signed=True,
        icon="point",
        key="X",
        shift=False,
        on_toolbar=True,
    ),
    MeasuringTool(
        name="distance",
        title="Distance",
        short="Distance",
        summary="the distance between two points",
        help="The distance between two points: in space, lateral, along z, its slope; with uncertainties. Stage um.",
        how="Drag both points over the surface.",
        result=Distance,
        measure="wafer_viewer.measure.tools.point:distance",
        places=(
            PlaceAsked("from", "point", "start", "Where it begins."),
            PlaceAsked("to", "point", "end", "Where it ends."),
        ),
        initial="two points",
        group="Places",
        symbol="L",
        main="in space",
        icon="ruler-measure",
        key="M",
        shift=False,
        on_toolbar=True,
    ),
    MeasuringTool(
        name="radius",
        title="Radius",
        short="Radius",
        summary="the radius and the height of a bump or pit",
        help="The radius of a bump or pit and the height of its top, with uncertainties. Stage um.",
        how="Drag the circle round the bump or the pit.",
        result=Radius,
        measure="wafer_viewer.measure.tools.radius:bump_radius",
        places=(PlaceAsked("bump", "circle", "circle", "Centre and radius of a circle round it."),),
        initial="bump",
        group="What stands out",
        symbol="R",
        main="of the sphere",
        icon="circle",
        key="R",
        shift=False,
        on_toolbar=True,
    ),
    MeasuringTool(
        name="volume",
        title="Area and volume",
        short="Volume",
        summary="area and volume over and under a plane",
        help="Area and volume over and under a plane, with uncertainties. Stage um.",
        how="Drag the region over what stands out of its surroundings.",
        result=AreaVolume,
        measure="wafer_viewer.measure.tools.volume:area_volume",
        places=(rectangle_place("region"),),
        initial="around a bump",
        group="What stands out",
        symbol="V",
        icon="droplet",
        key="V",
        shift=False,
        on_toolbar=True,
        options=VolumeOptions,
        controls=(
            ChoiceControl(
                "Reference",
                "reference",
                {"As heights are read": None, "Plane of the border": "border", "Zero of heights": "zero"},
                "Reference that the volume lies above and below",
                "The plane through the rectangle's border, or the zero of --level; that of --level where it is given.",
            ),
        ),
    ),
    MeasuringTool(
        name="coplanarity",
        title="Coplanarity",
        short="Coplanar",
        summary="how far bumps lie from one plane, and how high each is",
        help="Coplanarity of the bumps in a region (JESD22-B108), place and height of each; with uncertainties, as "
        "JSON.",
        how="Drag the region over the bumps of a die.",
        result=Coplanarity,
        measure="wafer_viewer.measure.tools.coplanarity:coplanarity",
        places=(rectangle_place("bumps", "Two opposite corners of a rectangle over the bumps, stage um."),),
        initial="bumps",
        group="What stands out",
        symbol="B",
        main="from lowest to highest top",
        icon="layout-align-bottom",
        result_name="Coplanarity",
        key="Q",
        options=CoplanarityOptions,
        controls=(
            ChoiceControl(
                "Plane",
                "reference",
                {"Least squares": "least_squares", "Seating plane": "seating"},
                help="The plane of least squares through all tops, or the seating plane.",
            ),
        ),
    ),
    MeasuringTool(
        name="particles",
        title="Particles",
        short="Particles",
        summary="particles or grains: place, size, height and volume of each",
        help="Particles or grains that stand out of a face: place, size, height and volume of each. Stage um.",
        how="Drag the region over the face and what lies on it.",
        result=Particles,
        measure="wafer_viewer.measure.tools.particles:particles",
        places=(rectangle_place("face"),),
        initial="all in view",
        group="What stands out",
        symbol="G",
        main="mean diameter",
        icon="circles",
        key="P",
        alt=True,
        options=ParticleOptions,
        controls=(
            ChoiceControl(
                "They stand", "stand", {"Above": "above", "Below": "below"}, help="Above or below the plane."
            ),
            NumberControl(
                "Over the plane, µm",
                "over_um",
                "Empty: six deviations of the face",
                help="Height over the plane that belongs to a particle; six robust deviations of the face by default.",
            ),
            ChoiceControl(
                "Touching ones",
                "split",
                {"One": "none", "By their tops": "tops"},
                help="Touching ones are one particle, or grains by the watershed of their tops.",
            ),
            NumberControl(
                "Least diameter, µm",
                "least_um",
                "Empty: the focus window",
                help="Smaller ones are left out; smaller than the focus window by default.",
            ),
        ),
    ),
    MeasuringTool(
        name="die",
        title="Die size",
        short="Die size",
        summary="the size of a die, on the picture",
        help="The size of a die on the picture, its centre, how it is turned and how square it is; with uncertainties.",
        how="Drag the region round a die.",
        result=DieSize,
        measure="wafer_viewer.measure.tools.die_size:die_size",
        places=(rectangle_place("die", "Two opposite corners of a rectangle round the die, stage um."),),
        initial="die",
        group="On the picture",
        symbol="Z",
        main="width",
        icon="dimensions",
        key="W",
        on_picture=True,
        options=DieOptions,
        controls=(
            ChoiceControl(
                "Rim of the die",
                "die",
                _BRIGHTNESS,
                "Relative to its surroundings in the picture",
                "Whether its rim is brighter or darker than its surroundings.",
            ),
        ),
    ),
    MeasuringTool(
        name="kerf",
        title="Kerf width",
        short="Kerf",
        summary="the width of a kerf, on the picture",
        help="The width of a kerf on the picture: mean, narrowest, widest, angle of its edges; with uncertainties, as "
        "JSON.",
        how="Drag the region across a kerf.",
        result=KerfWidth,
        measure="wafer_viewer.measure.tools.kerf:kerf_width",
        places=(rectangle_place("kerf", "Two opposite corners of a rectangle across the kerf, stage um."),),
        initial="kerf",
        group="On the picture",
        symbol="W",
        main="mean width",
        icon="arrow-autofit-width",
        key="U",
        on_picture=True,
        options=KerfOptions,
        controls=(
            ChoiceControl(
                "Kerf",
                "kerf",
                _BRIGHTNESS,
                "Relative to the ground beside it in the picture",
                "Whether it is brighter or darker than the ground beside it.",
            ),
        ),
    ),
    MeasuringTool(
        name="chipping",
        title="Chipping",
        short="Chipping",
        summary="the chips along an edge of a die, on the picture",
        help="Depth, length and area of the chips along an edge of a die on the picture; with uncertainties.",
        how="Drag the region along the edge of a die.",
        result=Chipping,
        measure="wafer_viewer.measure.tools.chipping:chipping",
        places=(rectangle_place("edge", "Two opposite corners of a rectangle over one edge, stage um."),),
        initial="die edge",
        group="On the picture",
        symbol="C",
        main="deepest",
        icon="puzzle",
        key="X",
        on_picture=True,
        options=ChippingOptions,
        controls=(
            NumberControl(
                "Chip over, µm",
                "limit_um",
                "Empty: four standard deviations of the edge",
                help="What is deeper is a chip; by default four robust deviations of the edge, two pixels at least.",
            ),
            ChoiceControl(
                "Die on the",
                "die",
                {"Higher side": "auto", "Bright side": "bright", "Dark side": "dark"},
                help="The side of the edge that the die lies on; auto takes the higher one.",
            ),
        ),
    ),
    MeasuringTool(
        name="circle",
        title="Circle",
        short="Circle",
        summary="the diameter of something round, on the picture",
        help="The diameter of something round on the picture, its centre and roundness; with uncertainties.",
        how="Drag the circle round something round.",
        result=CircleSize,
        measure="wafer_viewer.measure.tools.circle:circle_size",
        places=(PlaceAsked("circle", "circle", "circle", "Centre and radius of a circle drawn round it, stage um."),),
        initial="round shape",
        group="On the picture",
        symbol="O",
        main="diameter",
        icon="circle-dashed",
        key="Y",
        on_picture=True,
        options=CircleOptions,
        controls=(
            ChoiceControl(
                "Inside",
                "inside",
                _BRIGHTNESS,
                "Relative to the outside in the picture",
                "Whether the picture is brighter or darker inside of the edge.",
            ),
        ),
    ),
    *FACE_TOOLS,
)

TOOLS: dict[ToolName, MeasuringTool] = {
    tool.name: tool for tool in (*_BUILT_IN, *plugins("measuring_tools", MeasuringTool))
}
TOOL_OF_RESULT: dict[type[MeasurementResult], MeasuringTool] = {tool.result: tool for tool in TOOLS.values()}

if TYPE_CHECKING:

    class ToolOptions(Spec, frozen=True, kw_only=True):
        """Options of all tools that have any, by tool name."""

        def __init__(self, **by_tool: OptionsSpec) -> None: ...

        def __getattr__(self, tool: str) -> Any: ...

else:
    ToolOptions = msgspec.defstruct(
        "ToolOptions",
        [(tool.name, tool.options, tool.options()) for tool in TOOLS.values() if tool.options is not None],
        bases=(Spec,),
        module=__name__,
        namespace={
            "__doc__": "Options of all tools that have any, by tool name.",
            "__annotations__": {"error": ClassVar[type[WaferViewerError]]},
            "error": MeasureError,
        },
        frozen=True,
        kw_only=True,
        omit_defaults=True,
    )


def keywords(options: ToolOptions, tool: ToolName) -> dict[str, Any]:
    """Return the options of one tool as keywords of its measuring function; empty for a tool without options."""
    own = getattr(options, tool, None)
    return msgspec.structs.asdict(own) if own is not None else {}
