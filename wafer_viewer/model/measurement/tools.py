"""Measuring tools: one descriptor each, which page, commands, jobs, reports and the Python API read.

Other packages bring tools as entry points of the group ``wafer_viewer.measuring_tools``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.measurements import (
    AreaVolume,
    Chipping,
    CircleSize,
    Coplanarity,
    DieSize,
    Distance,
    FaceAngle,
    Flatness,
    KerfWidth,
    MeasurementResult,
    PointHeight,
    Profile,
    Radius,
    Roughness,
    SiteRanges,
    StepHeight,
    StepProfile,
    Texture,
)
from wafer_viewer.model.measurement.measuring_tool import (
    ChoiceControl,
    MeasuringTool,
    NumberControl,
    PlaceAsked,
    ToolName,
)
from wafer_viewer.model.measurement.tool_options import (
    ChippingOptions,
    CircleOptions,
    CoplanarityOptions,
    DieOptions,
    GrooveOptions,
    KerfOptions,
    OptionsSpec,
    RoughnessOptions,
    SiteRangeOptions,
    StepOptions,
    TextureOptions,
    VolumeOptions,
)
from wafer_viewer.model.plugins import plugins
from wafer_viewer.model.spec import Spec


def _rectangle(name: str, help: str = "Two opposite corners of a rectangle.", flag: str = "region") -> PlaceAsked:
    return PlaceAsked(name, "rectangle", flag, help)


def _line(help: str) -> PlaceAsked:
    return PlaceAsked("line", "line", "line", help)


_CONDITIONS = (
    NumberControl("Repeats s, µm", "conditions.repeatability_um", "Spread of repeated measurements; empty: not known"),
    NumberControl("Drift u, µm", "conditions.drift_um", "Standard uncertainty by drift; empty: not known"),
    NumberControl(
        "Sample, °C", "conditions.temperature_c", "Of the sample while it was scanned; empty: not known", None
    ),
)
_BRIGHTNESS = {"Either": "either", "Bright": "bright", "Dark": "dark"}
_NOISE = NumberControl(
    "Noise, µm",
    "noise_um",
    "Measurement noise of the heights, from repeats, for U; empty: by the heights' own uncertainty",
    help="Root mean square noise of the heights, as `calibrate noise` measures it; by their own uncertainty without.",
)
_BORDERS = ChoiceControl(
    "Borders",
    "borders",
    {"Keep": "keep", "Cut": "cut"},
    "Half the longest filter along the border, which evaluates less there",
    "Half of the longest filter along the border: evaluated over what there is, or left out.",
)
_FORMS = {"Mean": 0, "Plane": 1, "Order 2": 2, "Order 3": 3, "Order 4": 4, "Order 6": 6, "Order 8": 8}

_BUILT_IN = (
    MeasuringTool(
        name="profile",
        title="Profile",
        short="Profile",
        summary="sections along lines, rows and columns: numbers, table or picture",
        help="Section along a line, as JSON. Stage um.",
        how="Drag the two handles over the surface.",
        result=Profile,
        measure="wafer_viewer.measure.tools.profile:section",
        places=(_line("The two ends of the line."),),
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
            _rectangle("upper", "Two opposite corners of the upper rectangle.", "upper"),
            _rectangle("lower", "The same of the lower face.", "lower"),
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
        places=(_line("Both ends; it reaches beyond each edge as far as the groove is wide."),),
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
            _rectangle("first", "Two opposite corners of a rectangle on the one face.", "first"),
            _rectangle("second", "The same on the other.", "second"),
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
        places=(_rectangle("region"),),
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
        places=(_rectangle("bumps", "Two opposite corners of a rectangle over the bumps, stage um."),),
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
        name="die",
        title="Die size",
        short="Die size",
        summary="the size of a die, on the picture",
        help="The size of a die on the picture, its centre, how it is turned and how square it is; with uncertainties.",
        how="Drag the region round a die.",
        result=DieSize,
        measure="wafer_viewer.measure.tools.die_size:die_size",
        places=(_rectangle("die", "Two opposite corners of a rectangle round the die, stage um."),),
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
        places=(_rectangle("kerf", "Two opposite corners of a rectangle across the kerf, stage um."),),
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
        places=(_rectangle("edge", "Two opposite corners of a rectangle over one edge, stage um."),),
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
    MeasuringTool(
        name="flatness",
        title="Flatness",
        short="Flatness",
        summary="the flatness of a face",
        help="Flatness of a face, FLTt and FLTq of ISO 12781. Stage um.",
        how="Drag the region over the face.",
        result=Flatness,
        measure="wafer_viewer.measure.tools.flatness:flatness",
        places=(_rectangle("face"),),
        initial="face",
        group="Faces",
        symbol="F",
        main="FLTt",
        icon="layers-subtract",
        key="F",
        on_toolbar=True,
    ),
    MeasuringTool(
        name="texture",
        title="Texture",
        short="Texture",
        summary="the texture of a face",
        help="Texture of a face, the parameters of ISO 25178 of what form and filters leave. Stage um.",
        how="Drag the region over the face.",
        result=Texture,
        measure="wafer_viewer.measure.texture.areal_texture:texture",
        places=(_rectangle("face"),),
        initial="face",
        group="Faces",
        symbol="T",
        main="Sa",
        icon="grain",
        key="T",
        on_toolbar=True,
        options=TextureOptions,
        controls=(
            ChoiceControl(
                "Form removed",
                "form_order",
                _FORMS,
                "Polynomial of least squares",
                "Order of the polynomial that is removed as form; 0 the mean alone, 1 a plane.",
            ),
            NumberControl(
                "S-filter, µm",
                "s_filter_um",
                "Removes shorter wavelengths; empty: no filter",
                help="Nesting index of the Gaussian filter that removes shorter wavelengths; none by default.",
            ),
            NumberControl(
                "L-filter, µm",
                "l_filter_um",
                "Removes longer wavelengths; empty: no filter",
                help="Nesting index of the Gaussian filter that removes longer wavelengths; none by default.",
            ),
            ChoiceControl(
                "Slopes",
                "slopes",
                {"Neighbours": "neighbours", "Seven points": "seven_point"},
                "For Sdq and Sdr; seven points read short waves truer, and noise higher",
                "Slopes of Sdq and Sdr: of neighbouring pixels, or of seven, which reads short waves truer.",
            ),
            _NOISE,
            _BORDERS,
            NumberControl(
                "c of Smr(c), µm",
                "c_um",
                "Height over the mean; empty: no Smr(c)",
                over=None,
                help="Height over the mean for which the material ratio Smr(c) is given.",
            ),
            NumberControl(
                "Ratio of Smc, %",
                "mr_percent",
                "Material ratio, 0 to 100 %; empty: no Smc",
                help="Material ratio, 0 to 100 %, for which the height Smc is given.",
            ),
        ),
    ),
    MeasuringTool(
        name="roughness",
        title="Roughness",
        short="Roughness",
        summary="the roughness along a line",
        help="Roughness along a line, the parameters of ISO 21920 of what the filters leave. Stage um.",
        how="Drag the line over the face.",
        result=Roughness,
        measure="wafer_viewer.measure.texture.roughness:roughness",
        places=(_line("The two ends of the line."),),
        initial="line across a face",
        group="Faces",
        symbol="N",
        main="Ra",
        icon="wave-saw-tool",
        key="J",
        options=RoughnessOptions,
        controls=(
            NumberControl(
                "λc, µm",
                "lambda_c_um",
                "Removes longer wavelengths; the sampling length; empty: no filter",
                help="Cut-off of the Gaussian filter against longer wavelengths, the sampling length; none by default.",
            ),
            NumberControl(
                "λs, µm",
                "lambda_s_um",
                "Removes shorter wavelengths; empty: no filter",
                help="Cut-off of the Gaussian filter that removes shorter wavelengths; none by default.",
            ),
            _NOISE,
            _BORDERS,
        ),
    ),
    MeasuringTool(
        name="site_range",
        title="Site range",
        short="Sites",
        summary="front-surface site range, as mounted",
        help="Front-surface site range, as mounted: the range of heights in each site about its own plane, as JSON.",
        how="Drag the region over the sites: front surface, as mounted.",
        result=SiteRanges,
        measure="wafer_viewer.measure.tools.site_range:sites_of_region",
        places=(_rectangle("sites"),),
        initial="all in view",
        group="Faces",
        symbol="U",
        main="largest, front surface, as mounted",
        icon="grid-pattern",
        result_name="Site range",
        key="Z",
        options=SiteRangeOptions,
        controls=(
            NumberControl("Site width, µm", "width_um", "Empty: a quarter of the region"),
            NumberControl("Site height, µm", "height_um", "Empty: a quarter of the region"),
        ),
    ),
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
    )


def keywords(options: ToolOptions, tool: ToolName) -> dict[str, Any]:
    """Return the options of one tool as keywords of its measuring function; empty for a tool without options."""
    own = getattr(options, tool, None)
    return msgspec.structs.asdict(own) if own is not None else {}
