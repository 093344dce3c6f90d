"""Commands that measure shapes: edges on the all-in-focus picture, bumps on the heights; JSON, stage um.

The signature of a command defines its flags, its docstring is the help.
"""

from __future__ import annotations

from typing import Literal

from wafer_viewer.cli.arguments import Circle, Level, Rectangle, Source
from wafer_viewer.cli.measure_common import measure
from wafer_viewer.model.measurement.tool_options import (
    ChippingOptions,
    CircleOptions,
    CoplanarityOptions,
    DieOptions,
    KerfOptions,
    ToolOptions,
)
from wafer_viewer.model.region import Region

Brightness = Literal["either", "bright", "dark"]


def measure_kerf(
    src: Source, region: Rectangle, kerf: Brightness = "either", field: int = 0, result: str = "default"
) -> None:
    """The width of a kerf on the picture: mean, narrowest, widest, angle of its edges; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle across the kerf, stage um.
        kerf: Whether it is brighter or darker than the ground beside it.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(kerf=KerfOptions(kerf=kerf))
    measure("kerf", (Region.rectangle(*region),), src, (), field, result, options)


def measure_die(
    src: Source, region: Rectangle, die: Brightness = "either", field: int = 0, result: str = "default"
) -> None:
    """The size of a die on the picture, its centre, how it is turned and how square it is; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle round the die, stage um.
        die: Whether its rim is brighter or darker than its surroundings.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(die=DieOptions(die=die))
    measure("die", (Region.rectangle(*region),), src, (), field, result, options)


def measure_circle(
    src: Source, circle: Circle, inside: Brightness = "either", field: int = 0, result: str = "default"
) -> None:
    """The diameter of something round on the picture, its centre and roundness; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        circle: Centre and radius of a circle drawn round it, stage um.
        inside: Whether the picture is brighter or darker inside of the edge.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(circle=CircleOptions(inside=inside))
    measure("circle", (Region.circle(*circle),), src, (), field, result, options)


def measure_chipping(
    src: Source,
    region: Rectangle,
    limit_um: float | None = None,
    die: Literal["auto", "bright", "dark"] = "auto",
    field: int = 0,
    result: str = "default",
) -> None:
    """Depth, length and area of the chips along an edge of a die on the picture; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle over one edge, stage um.
        limit_um: What is deeper is a chip; by default four robust deviations of the edge, two pixels at least.
        die: The side of the edge that the die lies on; auto takes the higher one.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(chipping=ChippingOptions(limit_um=limit_um, die=die))
    measure("chipping", (Region.rectangle(*region),), src, (), field, result, options)


def measure_coplanarity(
    src: Source,
    region: Rectangle,
    reference: Literal["least_squares", "seating"] = "least_squares",
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Coplanarity of the bumps in a region (JESD22-B108), place and height of each; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle over the bumps, stage um.
        reference: The plane of least squares through all tops, or the seating plane.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(coplanarity=CoplanarityOptions(reference=reference))
    measure("coplanarity", (Region.rectangle(*region),), src, level, field, result, options)
