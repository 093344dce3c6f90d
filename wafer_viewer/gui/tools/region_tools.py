"""Regions of the active tool, of the levelling and of gauge block faces: placement, drawing and dragging."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.billboards import Billboard, corner_on_screen
from wafer_viewer.gui.scene.drag_handles import CasedLine, Dragged, DragHandle
from wafer_viewer.gui.scene.heightfield import HeightField, Place
from wafer_viewer.gui.scene.scene_contents import colours
from wafer_viewer.gui.scene.viewport import ViewAxes
from wafer_viewer.gui.state.view_state import Tool, View
from wafer_viewer.gui.tools.initial_regions import initial_regions
from wafer_viewer.gui.widgets.callbacks import EchoFilter
from wafer_viewer.model.measurement.measuring_tool import MeasuringTool
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.measurement.tools import TOOLS, ToolOptions
from wafer_viewer.model.region import Region, RegionKind
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import SurfaceInfo

# -------------------------------------------------------------------------------------------------------- region shapes


Corners = NDArray[np.float64]
"""[n, 2] in stage um, in order around the region."""
LEAST_PX = 4
"""Smallest size of a region in pixels of the surface."""
CENTRE = "whole"
"""Name of the handle that moves a region without changing its shape."""
_ROUND = np.linspace(0, 2 * np.pi, 72, endpoint=False)


@dataclass(frozen=True, slots=True)
class Shape:
    """Geometry functions of one kind of region.

    outline: corners; empty for a point.
    holds: positions of the handles by name.
    pulled: the region after a handle was moved.
    """

    outline: Callable[[Region], Corners]
    holds: Callable[[Region], dict[str, Place]]
    pulled: Callable[[Region, str, Place, HeightField], Region]


def _point_holds(region: Region) -> dict[str, Place]:
    return {CENTRE: (region.points[0].x_um, region.points[0].y_um)}


def _point_pulled(region: Region, hold: str, to: Place, height_field: HeightField) -> Region:
    return Region.point(*height_field.clamped(to))


def _corners(region: Region) -> Corners:
    x0, y0, x1, y1 = region.bounds_um
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)


def _rectangle_holds(region: Region) -> dict[str, Place]:
    x0, y0, x1, y1 = region.bounds_um
    corners = {str(k): (float(x), float(y)) for k, (x, y) in enumerate(_corners(region))}
    return {**corners, CENTRE: ((x0 + x1) / 2, (y0 + y1) / 2)}


def _rectangle_pulled(region: Region, hold: str, to: Place, height_field: HeightField) -> Region:
    x0, y0, x1, y1 = region.bounds_um
    if hold == CENTRE:
        half = (x1 - x0) / 2, (y1 - y0) / 2
        x, y = _clamped_inside(to, half, height_field)
        return _rectangle(x - half[0], y - half[1], x + half[0], y + half[1])
    least, k = LEAST_PX * height_field.on_show.facts.pixel_um, int(hold)
    x0, x1 = (min(to[0], x1 - least), x1) if k in (0, 3) else (x0, max(to[0], x0 + least))
    y0, y1 = (min(to[1], y1 - least), y1) if k in (0, 1) else (y0, max(to[1], y0 + least))
    return _rectangle(x0, y0, x1, y1)


def _round_outline(region: Region) -> Corners:
    center, r = region.points[0], region.radius_um
    return np.stack([center.x_um + r * np.cos(_ROUND), center.y_um + r * np.sin(_ROUND)], axis=1)


def _circle_holds(region: Region) -> dict[str, Place]:
    center = region.points[0]
    return {"rim": (center.x_um + region.radius_um, center.y_um), CENTRE: (center.x_um, center.y_um)}


def _circle_pulled(region: Region, hold: str, to: Place, height_field: HeightField) -> Region:
    """Move the circle by its centre, or set its radius by its rim, limited to the surface."""
    x0, y0, x1, y1 = height_field.bounds_um
    center = region.points[0]
    if hold == CENTRE:
        x, y = _clamped_inside(to, (region.radius_um, region.radius_um), height_field)
        return Region.circle(_hundredth(x), _hundredth(y), region.radius_um)
    x, y = center.x_um, center.y_um
    most = min(x - x0, x1 - x, y - y0, y1 - y)
    wanted = max(math.hypot(to[0] - x, to[1] - y), LEAST_PX * height_field.on_show.facts.pixel_um)
    return Region.circle(x, y, _hundredth(min(wanted, max(most, region.radius_um))))


def _ends(region: Region) -> Corners:
    return np.array([(p.x_um, p.y_um) for p in region.points], float)


def _line_holds(region: Region) -> dict[str, Place]:
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in region.points)
    return {"0": (xa, ya), "1": (xb, yb), CENTRE: ((xa + xb) / 2, (ya + yb) / 2)}


def _line_pulled(region: Region, hold: str, to: Place, height_field: HeightField) -> Region:
    """Move the line by its centre, or one end by its handle."""
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in region.points)
    if hold == CENTRE:
        x, y = _clamped_inside(to, (abs(xb - xa) / 2, abs(yb - ya) / 2), height_field)
        dx, dy = x - (xa + xb) / 2, y - (ya + yb) / 2
        ends = (xa + dx, ya + dy, xb + dx, yb + dy)
    else:
        x, y = height_field.clamped(to)
        ends = (x, y, xb, yb) if hold == "0" else (xa, ya, x, y)
    line = Region.line(*(_hundredth(v) for v in ends), width_um=region.width_um)
    return line if math.dist(ends[:2], ends[2:]) >= LEAST_PX * height_field.on_show.facts.pixel_um else region


def _clamped_inside(to: Place, half: Place, height_field: HeightField) -> Place:
    """Return the centre nearest to `to` for which the given half extents stay on the surface."""
    x0, y0, x1, y1 = height_field.bounds_um
    return min(max(to[0], x0 + half[0]), x1 - half[0]), min(max(to[1], y0 + half[1]), y1 - half[1])


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> Region:
    return Region.rectangle(*(_hundredth(v) for v in (x0, y0, x1, y1)))


def _hundredth(um: float) -> float:
    return round(um, 2)


def _no_outline(region: Region) -> Corners:
    return np.empty((0, 2))


SHAPES: dict[RegionKind, Shape] = {
    "point": Shape(_no_outline, _point_holds, _point_pulled),
    "rectangle": Shape(_corners, _rectangle_holds, _rectangle_pulled),
    "circle": Shape(_round_outline, _circle_holds, _circle_pulled),
    "line": Shape(_ends, _line_holds, _line_pulled),
}
"""Shapes of the kinds of region that can be dragged."""


def outline_of(region: Region) -> Corners:
    """Return the outline of a region of any kind; the line itself for a line, empty for a point."""
    if region.kind in SHAPES:
        return SHAPES[region.kind].outline(region)
    return np.array([(p.x_um, p.y_um) for p in region.points], float)


# --------------------------------------------------------------------------------------------------------- region tools


_CENTRE_PX, _EDGE_PX, _POINT_PX = 7.5, 5.5, 8.5
_SIGN_PX, _OFFSET_PX = 26, 12
_ROOMY_PX, _LEAST_KNOB = 60, 0.4
"""Size of a region in pixels from which handles have full size, and the smallest fraction of that size."""
_PATH_ENDS = ("point", "point")
"""Region kinds that are joined by a line: exactly two points."""


class PlaceHandle:
    """One region. Its handles are named NAME/HOLD."""

    def __init__(
        self, scene: viser.SceneApi, name: str, title: str, region: Region, colour: Rgb, dragged: Dragged
    ) -> None:
        self.region = region
        self._shape = SHAPES[region.kind]
        outlined = len(self._shape.outline(region)) > 0
        self._outline = CasedLine(scene, name, colour, 2.6) if outlined else None
        centre_px = _CENTRE_PX if outlined else _POINT_PX
        self._knobs = {
            hold: DragHandle(scene, f"{name}/{hold}", colour, centre_px if hold == CENTRE else _EDGE_PX, dragged)
            for hold in self._shape.holds(region)
        }
        self._sign = Billboard(scene, f"{name}/sign", title, colour, _SIGN_PX)

    def pull(self, hold: str, to: Place, height_field: HeightField) -> None:
        """Apply the new position of a handle."""
        self.region = self._shape.pulled(self.region, hold, to, height_field)

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the region on the displayed surface."""
        mm_per_pixel = view_axes.mm_per_pixel
        if self._outline is not None:
            pieces = height_field.drape_outline(self._shape.outline(self.region), 2 * mm_per_pixel)
            self._outline.lay(pieces, None, 1.6 * mm_per_pixel)
        for hold, (x, y) in self._shape.holds(self.region).items():
            position = height_field.visible_points(np.array([x]), np.array([y]), 3 * mm_per_pixel)[0]
            self._knobs[hold].place(position, mm_per_pixel * self._knob_share(mm_per_pixel), view_axes.towards)
        self._place_sign(height_field, view_axes)

    def remove(self) -> None:
        """Remove the region from the scene."""
        for part in (self._outline, *self._knobs.values(), self._sign):
            if part is not None:
                part.remove()

    def _knob_share(self, mm_per_pixel: float) -> float:
        """Return the scale of the handles, reduced for small regions so that they do not hide them."""
        x0, y0, x1, y1 = self.region.bounds_um
        side_um = max(x1 - x0, y1 - y0) if self.region.kind == "line" else min(x1 - x0, y1 - y0)
        side_px = side_um * 1e-3 / max(mm_per_pixel, 1e-12)
        return 1.0 if self._outline is None else min(1.0, max(_LEAST_KNOB, side_px / _ROOMY_PX))

    def _place_sign(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Place the label to the left of the region on the screen."""
        left = corner_on_screen(self.region, height_field, view_axes, -1, 0)
        self._sign.place(left, height_field, view_axes, -_OFFSET_PX)


class Places:
    """A list of regions with a common name; their handles are named NAME/NUMBER/HOLD."""

    def __init__(self, scene: viser.SceneApi, name: str, dragged: Dragged) -> None:
        self._scene, self._name, self._dragged = scene, name, dragged
        self._titles: tuple[str, ...] = ()
        self._kinds: tuple[str, ...] = ()
        self._colour: Rgb | None = None
        self._handles: list[PlaceHandle] = []
        self._path: CasedLine | None = None

    @property
    def regions(self) -> tuple[Region, ...]:
        """Current regions."""
        return tuple(handle.region for handle in self._handles)

    def become(self, titles: Sequence[str], regions: Sequence[Region], colour: Rgb) -> None:
        """Set titles, regions and colour; handles of the same kinds are moved, others are created again."""
        kinds = tuple(region.kind for region in regions)
        if (tuple(titles), kinds, colour) == (self._titles, self._kinds, self._colour):
            self.move(regions)
            return
        self.remove()
        self._titles, self._kinds, self._colour = tuple(titles), kinds, colour
        self._handles = [
            PlaceHandle(self._scene, f"{self._name}/{k}", title, region, colour, self._dragged)
            for k, (title, region) in enumerate(zip(titles, regions, strict=True))
        ]
        if kinds == _PATH_ENDS:
            self._path = CasedLine(self._scene, f"{self._name}/way", colour, 2.0)

    def move(self, regions: Sequence[Region]) -> None:
        """Move to these regions of the same kinds."""
        for handle, region in zip(self._handles, regions, strict=True):
            handle.region = region

    def pull(self, name: str, to: Place, height_field: HeightField) -> None:
        """Apply the new position of a handle, NAME/NUMBER/HOLD."""
        _, number, hold = name.split("/")
        if int(number) < len(self._handles):
            self._handles[int(number)].pull(hold, to, height_field)

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the regions on the displayed surface."""
        for handle in self._handles:
            handle.draw(height_field, view_axes)
        if self._path is not None:
            start, end = ((r.points[0].x_um, r.points[0].y_um) for r in self.regions)
            points, measured = height_field.drape_line(start, end, 1.5 * view_axes.mm_per_pixel)
            self._path.lay(np.stack([points[:-1], points[1:]], axis=1), measured, 1.6 * view_axes.mm_per_pixel)

    def remove(self) -> None:
        """Remove the regions from the scene."""
        for handle in self._handles:
            handle.remove()
        if self._path is not None:
            self._path.remove()
            self._path = None
        self._handles, self._titles, self._kinds, self._colour = [], (), (), None


RegionsChanged = Callable[[tuple[Region, ...]], None]
InSight = Callable[[HeightField], HeightField]
LEVEL_SIGNS = {"three points": ("1", "2", "3"), "region": ("Zero",)}


class PlaceTools:
    """Regions of every tool except the profile. A view without regions gets initial ones in the visible part."""

    def __init__(self, scene: viser.SceneApi, dragged: Dragged, changed: RegionsChanged, in_sight: InSight) -> None:
        self._places = Places(scene, "place", dragged)
        self._tell, self._in_sight = changed, in_sight
        self._tool: Tool = "none"
        self._named = False
        self._echoes: EchoFilter[tuple[Region, ...]] = EchoFilter()

    def show(self, view: View, height_field: HeightField, near: Place) -> None:
        """Show the regions of a view's tool; echoes of a drag are ignored."""
        if view.tool in ("none", "profile"):
            self.remove()
            return
        tool, new = TOOLS[view.tool], view.tool != self._tool
        named = has_required_kinds(tool, view.places)
        if named and (not self._echoes.is_echo(view.places) or new):
            self._become(tool, view.places, view.dark)
        elif not named and (new or self._named):
            self._become(tool, initial_regions(view.tool, self._in_sight(height_field), near), view.dark)
            self._report()
        self._tool, self._named = view.tool, named

    def drag(self, name: str, to: Place, height_field: HeightField, last: bool) -> None:
        """Apply the new position of a handle."""
        self._places.pull(name, to, height_field)
        self._report()

    def put(self, to: Place) -> None:
        """Measure at a clicked position with the point tool; other tools ignore clicks."""
        if self._tool == "point":
            self._places.move((Region.point(*to),))
            self._report()

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the regions on the displayed surface."""
        self._places.draw(height_field, view_axes)

    def remove(self) -> None:
        """Remove the regions from the scene."""
        self._places.remove()
        self._tool, self._named = "none", False
        self._echoes.forget()

    def _become(self, tool: MeasuringTool, regions: tuple[Region, ...], dark: bool) -> None:
        self._places.become([expected.name.capitalize() for expected in tool.places], regions, colours(dark).region)

    def _report(self) -> None:
        self._tell(self._echoes.tell(self._places.regions))


class LevelTools:
    """Points or region that define zero height. The surface is updated when a handle is released."""

    def __init__(self, scene: viser.SceneApi, dragged: Dragged, changed: Callable[[Levelling], None]) -> None:
        self._places = Places(scene, "level", dragged)
        self._tell = changed
        self._levelling = Levelling()
        self._echoes: EchoFilter[Levelling] = EchoFilter()

    def show(self, view: View, height_field: HeightField, near: Place) -> None:
        """Show the regions of a view's levelling."""
        if self._echoes.is_echo(view.levelling):
            return
        self._levelling = view.levelling
        signs = LEVEL_SIGNS.get(view.levelling.by, ())
        self._places.become(signs, view.levelling.places, colours(view.dark).mark)

    def drag(self, name: str, to: Place, height_field: HeightField, last: bool) -> None:
        """Apply the new position of a handle; report the levelling when it is released."""
        self._places.pull(name, to, height_field)
        if last:
            self._tell(self._echoes.tell(replace(self._levelling, places=self._places.regions)))

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the regions on the displayed surface."""
        self._places.draw(height_field, view_axes)

    def remove(self) -> None:
        """Remove the regions from the scene."""
        self._places.remove()
        self._echoes.forget()


def has_required_kinds(tool: MeasuringTool, places: tuple[Region, ...]) -> bool:
    """Return whether the regions have the kinds that a tool requires."""
    return tuple(place.kind for place in places) == tuple(expected.kind for expected in tool.places)


_SHARE = 0.28
"""Side of a default face, as a fraction of the surface's side."""


def in_scene(view: View, surface: SurfaceInfo | None = None) -> View:
    """Return the view for the scene; it differs from the page's view only in Gauge check.

    surface: the displayed surface. Its colour range is widened, so that no face is drawn black or white.
    """
    if view.step != "gauge":
        return view
    dragged = bool(view.faces) and view.check is None and not view.instrument
    return replace(
        view,
        show=max(0, view.show),
        tool="step" if dragged else "none",
        places=view.faces,
        options=ToolOptions(),
        levelling=Levelling(),
        exaggeration=1.0,
        colour_by="height",
        range_um=_colours_of(surface) if surface is not None else None,
        frame_k=None,
        slice_z_um=None,
        selected=None,
    )


def _colours_of(surface: SurfaceInfo) -> tuple[float, float]:
    low, high = surface.low_um, surface.high_um
    span = max(high - low, 1e-6)
    return low - 0.55 * span, high + 0.25 * span


def take_places(page: Page) -> Callable[[tuple[Region, ...]], None]:
    """Return a callback that stores dragged regions: as gauge faces in Gauge check, else as regions of the tool."""

    def take(places: tuple[Region, ...]) -> None:
        if page.view.step == "gauge":
            page.change(faces=places)
        else:
            page.change(places=places, selected=None)

    return take


def default_faces(surface: SurfaceInfo) -> tuple[Region, Region]:
    """Return two default faces side by side, to be dragged into position."""
    width, height = surface.cols * surface.pixel_um, surface.rows * surface.pixel_um
    y = surface.y0_um - height / 2

    def face(share: float) -> Region:
        x = surface.x0_um + share * width
        half_x, half_y = _SHARE * width / 2, _SHARE * height / 2
        return Region.rectangle(*(round(um, 2) for um in (x - half_x, y - half_y, x + half_x, y + half_y)))

    return face(0.72), face(0.28)
