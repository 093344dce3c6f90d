"""HTML of shape results: the quantities in addition to the main one."""

from __future__ import annotations

from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.presenters.measurement import format_quantity
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.measurement.edge_and_bump_shapes import Chipping, CircleSize, Coplanarity, DieSize, KerfWidth
from wafer_viewer.model.region import Point

LISTED = 8
"""Number of chips or bumps listed, the worst first."""


def kerf(finding: KerfWidth) -> str:
    """Return extreme widths, angle between the edges, and edge points of a kerf."""
    return html.pairs(
        [
            ("Narrowest", format_quantity(finding.narrowest.quantity)),
            ("Widest", format_quantity(finding.widest.quantity)),
            ("Angle between the edges", format_quantity(finding.angle)),
            ("Kerf on the picture", finding.kerf),
            ("Edge points", number(finding.points, 0)),
        ]
    )


def die(finding: DieSize) -> str:
    """Return size, rotation, squareness and centre of a die."""
    return html.pairs(
        [
            ("Width", format_quantity(finding.width.quantity)),
            ("Height", format_quantity(finding.height.quantity)),
            ("Rotation", format_quantity(finding.rotation, signed=True)),
            ("Squareness, angle over 90°", format_quantity(finding.squareness, signed=True)),
            ("Centre x, y", _place(finding.center)),
            ("Rim on the picture", finding.die),
            ("Edge points", number(finding.points, 0)),
        ]
    )


def circle(finding: CircleSize) -> str:
    """Return radius, roundness and centre of a circle."""
    return html.pairs(
        [
            ("Radius", format_quantity(finding.radius.quantity)),
            ("Roundness RONt", format_quantity(finding.roundness.quantity)),
            ("Centre x, y", _place(finding.center)),
            ("Inside on the picture", finding.inside),
            ("Edge points", number(finding.points, 0)),
        ]
    )


def chipping(finding: Chipping) -> str:
    """Return chip threshold, totals over all chips, and a table of the worst."""
    told = html.pairs(
        [
            ("Deeper than", with_unit(finding.limit_um)),
            ("Chips", number(finding.n_chips, 0)),
            ("Their area", format_quantity(finding.area)),
            ("Longest", format_quantity(finding.longest.quantity)),
            ("Share of the edge chipped", share(finding.chipped_fraction)),
            ("Length of the edge", with_unit(finding.edge_length_um, 1)),
            ("Die on the", f"{finding.die} side"),
        ]
    )
    if not finding.chips:
        return told
    rows = [
        html.row(
            [_place(chip.place), number(chip.depth_um), number(chip.length_um, 1), number(chip.area_um2, 1)], " nnn"
        )
        for chip in finding.chips[:LISTED]
    ]
    return told + html.table(["Chip at x, y", "Depth", "Length", "Area"], rows, " nnn") + _more(finding.n_chips)


def coplanarity(finding: Coplanarity) -> str:
    """Return statistics of all bumps, and a table of those furthest from the plane."""
    reference = {"least_squares": "least squares", "seating": "seating plane"}[finding.options.reference]
    told = html.pairs(
        [
            ("Plane", reference),
            ("Bumps", number(finding.n_bumps, 0)),
            *([("Left out, cut or not measured", number(finding.left_out, 0))] if finding.left_out else []),
            ("Mean height", format_quantity(finding.mean_height.quantity)),
            ("Range of heights", format_quantity(finding.height_range.quantity)),
            ("Tilt of the plane", with_unit(finding.tilt_mrad, 2, "mrad")),
        ]
    )
    rows = [
        html.row(
            [
                _place(bump.place),
                number(bump.deviation.value_um, 2, signed=True),
                number(bump.height.value_um),
                number(bump.diameter_um, 1),
            ],
            " nnn",
        )
        for bump in finding.bumps[:LISTED]
    ]
    return told + html.table(["Bump at x, y", "Off plane", "Height", "Diameter"], rows, " nnn") + _more(finding.n_bumps)


def _place(place: Point) -> str:
    return f"{number(place.x_um, 1)}, {number(place.y_um, 1)}"


def _more(count: int) -> str:
    if count <= LISTED:
        return ""
    told = f"The worst {LISTED} of {count}; all are in the exported table."
    return f'<div class="wv-lab" style="margin-top:4px">{told}</div>'
