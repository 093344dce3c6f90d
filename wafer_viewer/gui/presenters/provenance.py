"""HTML of a result's provenance: regions, secondary quantities, surface and height reference."""

from __future__ import annotations

import math
from collections.abc import Callable

from markupsafe import Markup

from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.presenters import measurement
from wafer_viewer.gui.presenters.gauge import stored_check as gauge_text
from wafer_viewer.gui.presenters.measurement import averaging, format_quantity, roughness, sites, texture
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.measurement.levelling import LevelBy
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
    PointHeight,
    Profile,
    Radius,
    Roughness,
    SiteRanges,
    StepHeight,
    StepProfile,
    Texture,
)
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import LAYER_TITLES
from wafer_viewer.session.measurement.measurement_numbers import numbers_of

ZERO: dict[LevelBy, str] = {
    "stage": "the stage's zero",
    "three points": "the plane through three points",
    "plane": "the plane of the whole surface",
    "region": "the plane of a region",
    "form": "the form of the whole surface",
}
"""Names of the height reference by levelling method."""
Pairs = list[tuple[str, str]]


def source(finding: AnyResult) -> Markup:
    """Return the provenance of a result: regions, points, surface."""
    tell = _TEXTS.get(type(finding))
    body = tell(finding) if tell is not None else html.pairs(numbers_of(finding))
    return html.head("Where it comes from", "µm") + body + _measured_on(finding)


def surface_name(finding: AnyResult) -> str:
    """Return the name of the surface a result was measured on."""
    return f"field {finding.show}" if finding.show > 0 else "comparison" if finding.show < 0 else "stitched surface"


def _profile(finding: Profile) -> Markup:
    return html.pairs(
        [
            ("Length", with_unit(finding.length_um, 1)),
            ("Averaged over", averaging(finding)),
            ("Rise, first to last point", format_quantity(finding.rise.quantity, signed=True)),
            ("Angle", with_unit(_angle(finding), 2, "°", signed=True)),
            ("Measured", share(finding.measured_fraction)),
        ]
    )


def _point(finding: PointHeight) -> Markup:
    return html.pairs([_place("Place", finding.place), ("Pixels, their median", number(finding.points, 0))])


def _distance(finding: Distance) -> Markup:
    return html.pairs(
        [
            ("On the map", format_quantity(finding.lateral.quantity)),
            ("Rise", format_quantity(finding.dz.quantity, signed=True)),
            ("Slope", format_quantity(finding.slope)),
            _place("From", finding.start),
            _place("To", finding.end),
        ]
    )


def _face_angle(finding: FaceAngle) -> Markup:
    faces = (
        ("First face", finding.first_tilt_deg, finding.first_sq_um, finding.first_points),
        ("Second face", finding.second_tilt_deg, finding.second_sq_um, finding.second_points),
    )
    rows = [html.row([name, number(tilt, 2), number(sq, 2), number(n, 0)], " nnn") for name, tilt, sq, n in faces]
    return html.table(["Face", "Tilt, °", "Sq", "Points"], rows, " nnn")


def _radius(finding: Radius) -> Markup:
    over = "Top over its surroundings" if finding.kind == "bump" else "Bottom under its surroundings"
    return html.pairs(
        [
            (over, format_quantity(finding.top.quantity)),
            ("Centre x, y", f"{number(finding.center.x_um, 1)}, {number(finding.center.y_um, 1)}"),
            ("Sq from the sphere", number(finding.sq_um, 2)),
            ("Points", number(finding.points, 0)),
        ]
    )


def _volume(finding: AreaVolume) -> Markup:
    plane = "the plane through the region's border" if finding.reference == "border" else "the zero of heights"
    pairs = [
        ("Volume above", format_quantity(finding.volume_above)),
        ("Volume below", format_quantity(finding.volume_below)),
        ("Area above", format_quantity(finding.area_above)),
        ("Area below", format_quantity(finding.area_below)),
        ("Area of the region", format_quantity(finding.area)),
        ("Highest", format_quantity(finding.highest.quantity, signed=True)),
        ("Lowest", format_quantity(finding.lowest.quantity, signed=True)),
        ("Measured", share(finding.measured_fraction)),
    ]
    noise = f"Within {with_unit(finding.noise_um, 2)} of it a height counts neither as above nor as below."
    return html.pairs(pairs) + _small([f"Above and below {plane}.", noise])


def _flatness(finding: Flatness) -> Markup:
    plane = {"least_squares": "least-squares plane", "minimum_zone": "minimum zone"}[finding.reference]
    zone = finding.flt_t_minimum_zone
    return html.pairs(
        [
            *([("FLTt, minimum zone", format_quantity(zone.quantity))] if zone is not None else []),
            ("FLTq", format_quantity(finding.flt_q.quantity)),
            ("Band with 99.73 %", number(finding.band_9973_um, 2)),
            ("Reference", plane),
            ("Points", number(finding.points, 0)),
            ("Measured", share(finding.measured_fraction)),
        ]
    )


_TEXTS: dict[type, Callable[..., str]] = {
    Profile: _profile,
    PointHeight: _point,
    Distance: _distance,
    StepHeight: measurement.step,
    StepProfile: measurement.groove,
    FaceAngle: _face_angle,
    Radius: _radius,
    AreaVolume: _volume,
    Flatness: _flatness,
    Texture: texture,
    Roughness: roughness,
    KerfWidth: measurement.kerf,
    DieSize: measurement.die,
    CircleSize: measurement.circle,
    Chipping: measurement.chipping,
    Coplanarity: measurement.coplanarity,
    SiteRanges: sites,
    GaugeCheck: gauge_text,
}


def _place(name: str, place: Region) -> tuple[str, str]:
    point = place.points[0]
    return f"{name} x, y", f"{number(point.x_um, 1)}, {number(point.y_um, 1)}"


def _angle(profile: Profile) -> float:
    return math.degrees(math.atan2(profile.rise.value_um, profile.length_um)) if profile.length_um else math.nan


def _measured_on(finding: AnyResult) -> Markup:
    lines = [
        f"On the {surface_name(finding)}: {LAYER_TITLES[finding.surface]}, filter: {finding.filter}.",
        f"Heights are read from {ZERO[finding.levelling.by]}.",
    ]
    tool = TOOL_OF_RESULT.get(type(finding))
    if tool is not None and tool.on_picture:
        lines = [f"On the {surface_name(finding)}."]
    if finding.simulated:
        lines.append("SIMULATED: not a measurement of a real sample.")
    lines.extend(finding.notes)
    return _small(lines)


def _small(lines: list[str]) -> Markup:
    return Markup("").join(
        Markup('<div class="wv-lab" style="margin-top:4px">{}</div>').format(html.with_micro_sign(line))
        for line in lines
    )
