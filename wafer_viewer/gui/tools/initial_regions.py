"""Initial regions of each tool, on features of the visible part, so that the first result is meaningful."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wafer_viewer.gui.scene.heightfield import HeightField, Place
from wafer_viewer.gui.tools.initial_edge_regions import bumps_box, die_box, edge_box, initial_circle, kerf_box
from wafer_viewer.gui.tools.initial_groove import groove_line
from wafer_viewer.gui.tools.surface_landmarks import (
    PATCH_SHARES,
    SAME_LEVEL,
    bump,
    face,
    first_line,
    patches,
    plateaus,
    span_um,
    two_faces,
)
from wafer_viewer.model.measurement.levelling import LevelBy, Levelling
from wafer_viewer.model.measurement.tools import ToolName
from wafer_viewer.model.region import Region

_BORDER = 0.06
"""Margin as a fraction of a side of the surface."""
_WELL_INSIDE = 0.8
"""Side of an initial region, as a fraction of the flat square found."""


def _square(land: HeightField, at: Place, side_um: float) -> Region:
    (x, y), half = at, side_um / 2
    return Region.rectangle(*land.clamped((x - half, y - half)), *land.clamped((x + half, y + half)))


def _inside(land: HeightField, at: Place, side_um: float) -> Region:
    return _square(land, at, _WELL_INSIDE * side_um)


def _point(land: HeightField, near: Place) -> tuple[Region, ...]:
    return (Region.point(*land.nearest_measured(land.inner(near))),)


def _distance(land: HeightField, near: Place) -> tuple[Region, ...]:
    x0, _, x1, _ = land.bounds_um
    x, y = land.inner(near)
    ends = ((x - 0.16 * (x1 - x0), y), (x + 0.16 * (x1 - x0), y))
    return tuple(Region.point(*land.nearest_measured(end)) for end in ends)


def _step(land: HeightField, near: Place) -> tuple[Region, ...]:
    upper, lower, side_um = plateaus(land, near)
    return _inside(land, upper, side_um), _inside(land, lower, side_um)


def _angle(land: HeightField, near: Place) -> tuple[Region, ...]:
    first, second, side_um = two_faces(land, near)
    return _inside(land, first, side_um), _inside(land, second, side_um)


def _radius(land: HeightField, near: Place) -> tuple[Region, ...]:
    middle, radius_um = bump(land, near)
    return (Region.circle(*land.clamped(middle), round(radius_um, 2)),)


def _volume(land: HeightField, near: Place) -> tuple[Region, ...]:
    middle, radius_um = bump(land, near)
    return (_square(land, middle, 3 * radius_um),)


def _face(land: HeightField, near: Place) -> tuple[Region, ...]:
    return (_inside(land, *face(land, near)),)


def _across_face(land: HeightField, near: Place) -> tuple[Region, ...]:
    x0, y0, x1, y1 = _inside(land, *face(land, near)).bounds_um
    return (Region.line(x0, (y0 + y1) / 2, x1, (y0 + y1) / 2),)


def _visible_without_border(land: HeightField, near: Place) -> tuple[Region, ...]:
    """Return the visible part without its border."""
    x0, y0, x1, y1 = land.bounds_um
    in_x, in_y = _BORDER * (x1 - x0), _BORDER * (y1 - y0)
    return (Region.rectangle(*(round(um, 2) for um in (x0 + in_x, y0 + in_y, x1 - in_x, y1 - in_y))),)


FIRST: dict[ToolName, Callable[[HeightField, Place], tuple[Region, ...]]] = {
    "profile": lambda land, near: (Region.line(*(v for end in first_line(land, near) for v in end)),),
    "point": _point,
    "distance": _distance,
    "step": _step,
    "groove": lambda land, near: (Region.line(*(v for end in groove_line(land, near) for v in end)),),
    "angle": _angle,
    "radius": _radius,
    "volume": _volume,
    "kerf": kerf_box,
    "die": die_box,
    "circle": initial_circle,
    "chipping": edge_box,
    "coplanarity": bumps_box,
    "site_range": _visible_without_border,
    "flatness": _face,
    "texture": _face,
    "roughness": _across_face,
}
"""Initial regions of each tool, in the order of its inputs."""


def _three_points(land: HeightField, near: Place) -> tuple[Region, ...]:
    """Return three distant points, if possible all on the level of most of the surface."""
    x0, y0, x1, y1 = land.bounds_um
    wanted = [(x0 + u * (x1 - x0), y0 + v * (y1 - y0)) for u, v in ((0.15, 0.15), (0.85, 0.15), (0.5, 0.85))]
    found = patches(land, PATCH_SHARES[-1])
    level = (
        found.only(np.abs(found.level - np.median(found.level)) <= SAME_LEVEL * span_um(land)) if len(found) else found
    )
    if len(level) < 3:
        return tuple(Region.point(*land.nearest_measured(place)) for place in wanted)
    return tuple(Region.point(*land.clamped(level.middle(level.nearest(place)))) for place in wanted)


_LEVEL_AT: dict[LevelBy, Callable[[HeightField, Place], tuple[Region, ...]]] = {
    "three points": _three_points,
    "region": _face,
}


def first_levelling(by: LevelBy, land: HeightField, near: Place) -> Levelling:
    """Return a levelling with initial regions."""
    return Levelling(by=by, places=_LEVEL_AT[by](land, near) if by in _LEVEL_AT else ())
