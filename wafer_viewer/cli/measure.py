"""Commands that measure on a surface and print the results as JSON; stage um.

The signature of a command defines its flags, its docstring is the help.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from tyro.conf import arg

from wafer_viewer.cli.arguments import Circle, Level, Line, Place, Rectangle, Source, Um
from wafer_viewer.cli.measure_common import measure as _measure
from wafer_viewer.cli.measure_common import print_finding as _print
from wafer_viewer.cli.measure_common import surface_over as _surface
from wafer_viewer.cli.output import print_json
from wafer_viewer.model.measurement.tool_options import RoughnessOptions, TextureOptions, ToolOptions
from wafer_viewer.model.region import Region


def measure_point(src: Source, at: Place, level: Level = (), field: int = 0, result: str = "default") -> None:
    """The height at a point, with its uncertainty, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        at: Where the point is.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("point", (Region.point(*at),), src, level, field, result)


def measure_distance(
    src: Source, start: Place, end: Place, level: Level = (), field: int = 0, result: str = "default"
) -> None:
    """The distance between two points: in space, lateral, along z, its slope; with uncertainties, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        start: Where it begins.
        end: Where it ends.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("distance", (Region.point(*start), Region.point(*end)), src, level, field, result)


def measure_angle(
    src: Source, first: Rectangle, second: Rectangle, level: Level = (), field: int = 0, result: str = "default"
) -> None:
    """The angle between two faces, with its uncertainty, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        first: Two opposite corners of a rectangle on the one face.
        second: The same on the other.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("angle", (Region.rectangle(*first), Region.rectangle(*second)), src, level, field, result)


def measure_radius(src: Source, circle: Circle, level: Level = (), field: int = 0, result: str = "default") -> None:
    """The radius of a bump or pit and the height of its top, with uncertainties, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        circle: Centre and radius of a circle round it.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("radius", (Region.circle(*circle),), src, level, field, result)


def measure_volume(
    src: Source,
    region: Rectangle,
    reference: Literal["border", "zero"] | None = None,
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Area and volume over and under a plane, with uncertainties, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle.
        reference: The plane through the rectangle's border, or the zero of --level; that of --level where it is given.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.tools.volume import area_volume

    surface, calibrated = _surface(src, level, field, result)
    place = Region.rectangle(*region)
    _print(area_volume(surface, place, reference=reference, calibration_valid=calibrated), field)


def measure_flatness(
    src: Source, region: Rectangle, level: Level = (), field: int = 0, result: str = "default"
) -> None:
    """Flatness of a face, FLTt and FLTq of ISO 12781, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("flatness", (Region.rectangle(*region),), src, level, field, result)


def measure_texture(
    src: Source,
    region: Rectangle,
    form_order: int = 1,
    s_filter_um: Um = None,
    l_filter_um: Um = None,
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Texture of a face, the parameters of ISO 25178 of what form and filters leave, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle.
        form_order: Order of the polynomial that is removed as form; 0 the mean alone, 1 a plane.
        s_filter_um: Nesting index of the Gaussian filter that removes shorter wavelengths; none by default.
        l_filter_um: Nesting index of the Gaussian filter that removes longer wavelengths; none by default.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    own = TextureOptions(form_order=form_order, s_filter_um=s_filter_um, l_filter_um=l_filter_um)
    _measure("texture", (Region.rectangle(*region),), src, level, field, result, ToolOptions(texture=own))


def measure_roughness(
    src: Source,
    line: Line,
    width_um: float = 0.0,
    lambda_c_um: Um = None,
    lambda_s_um: Um = None,
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Roughness along a line, the parameters of ISO 21920 of what the filters leave, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        line: The two ends of the line.
        width_um: Width across the line that is averaged over.
        lambda_c_um: Cut-off of the Gaussian filter against longer wavelengths, the sampling length; none by default.
        lambda_s_um: Cut-off of the Gaussian filter that removes shorter wavelengths; none by default.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    own = RoughnessOptions(lambda_c_um=lambda_c_um, lambda_s_um=lambda_s_um)
    place = Region.line(*line, width_um=width_um)
    _measure("roughness", (place,), src, level, field, result, ToolOptions(roughness=own))


def measure_site_range(
    src: Source,
    site: Annotated[tuple[float, float], arg(metavar="WIDTH HEIGHT")],
    region: Annotated[tuple[float, float, float, float] | None, arg(metavar="X0 Y0 X1 Y1")] = None,
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Front-surface site range, as mounted: the range of heights in each site about its own plane, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        site: Width and height of a site.
        region: Two opposite corners of what the sites are laid into; the whole surface by default.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.tools.site_range import site_ranges

    surface, calibrated = _surface(src, level, field, result)
    within = Region.rectangle(*region) if region is not None else None
    print_json(msgspec.to_builtins(site_ranges(surface, site, within, calibration_valid=calibrated)))
