"""Regions of the active tool and of the levelling: initial placement and dragging."""

from __future__ import annotations

from collections.abc import Callable

import viser

from wafer_viewer.gui.scene.drag_handles import Dragged
from wafer_viewer.gui.scene.heightfield import HeightField, Place
from wafer_viewer.gui.scene.scene_theme import colours
from wafer_viewer.gui.scene.view_axes import ViewAxes
from wafer_viewer.gui.state.view_state import Tool, View
from wafer_viewer.gui.tools.initial_regions import FIRST
from wafer_viewer.gui.tools.region_handles import Places
from wafer_viewer.gui.widgets.echo_filter import EchoFilter
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.measurement.tools import TOOLS, MeasuringTool
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

Told = Callable[[tuple[Region, ...]], None]
InSight = Callable[[HeightField], HeightField]
LEVEL_SIGNS = {"three points": ("1", "2", "3"), "region": ("Zero",)}


class PlaceTools:
    """Regions of every tool except the profile. A view without regions gets initial ones in the visible part."""

    def __init__(self, scene: viser.SceneApi, dragged: Dragged, told: Told, in_sight: InSight) -> None:
        self._places = Places(scene, "place", dragged)
        self._tell, self._in_sight = told, in_sight
        self._tool: Tool = "none"
        self._named = False
        self._echoes: EchoFilter[tuple[Region, ...]] = EchoFilter()

    def show(self, view: View, land: HeightField, near: Place) -> None:
        """Show the regions of a view's tool; echoes of a drag are ignored."""
        if view.tool in ("none", "profile"):
            self.remove()
            return
        tool, new = TOOLS[view.tool], view.tool != self._tool
        named = has_required_kinds(tool, view.places)
        if named and (not self._echoes.is_echo(view.places) or new):
            self._become(tool, view.places, view.dark)
        elif not named and (new or self._named):
            self._become(tool, FIRST[view.tool](self._in_sight(land), near), view.dark)
            self._told()
        self._tool, self._named = view.tool, named

    def drag(self, name: str, to: Place, land: HeightField, last: bool) -> None:
        """Apply the new position of a handle."""
        self._places.pull(name, to, land)
        self._told()

    def put(self, to: Place) -> None:
        """Measure at a clicked position with the point tool; other tools ignore clicks."""
        if self._tool == "point":
            self._places.move((Region.point(*to),))
            self._told()

    def draw(self, land: HeightField, gaze: ViewAxes) -> None:
        """Draw the regions on the displayed surface."""
        self._places.draw(land, gaze)

    def remove(self) -> None:
        """Remove the regions from the scene."""
        self._places.remove()
        self._tool, self._named = "none", False
        self._echoes.forget()

    def _become(self, tool: MeasuringTool, regions: tuple[Region, ...], dark: bool) -> None:
        self._places.become([asked.name.capitalize() for asked in tool.places], regions, colours(dark).region)

    def _told(self) -> None:
        self._tell(self._echoes.tell(self._places.regions))


class LevelTools:
    """Points or region that define zero height. The surface is updated when a handle is released."""

    def __init__(self, scene: viser.SceneApi, dragged: Dragged, told: Callable[[Levelling], None]) -> None:
        self._places = Places(scene, "level", dragged)
        self._tell = told
        self._levelling = Levelling()
        self._echoes: EchoFilter[Levelling] = EchoFilter()

    def show(self, view: View, land: HeightField, near: Place) -> None:
        """Show the regions of a view's levelling."""
        if self._echoes.is_echo(view.levelling):
            return
        self._levelling = view.levelling
        signs = LEVEL_SIGNS.get(view.levelling.by, ())
        self._places.become(signs, view.levelling.places, colours(view.dark).mark)

    def drag(self, name: str, to: Place, land: HeightField, last: bool) -> None:
        """Apply the new position of a handle; report the levelling when it is released."""
        self._places.pull(name, to, land)
        if last:
            self._tell(self._echoes.tell(replace(self._levelling, places=self._places.regions)))

    def draw(self, land: HeightField, gaze: ViewAxes) -> None:
        """Draw the regions on the displayed surface."""
        self._places.draw(land, gaze)

    def remove(self) -> None:
        """Remove the regions from the scene."""
        self._places.remove()
        self._echoes.forget()


def has_required_kinds(tool: MeasuringTool, places: tuple[Region, ...]) -> bool:
    """Return whether the regions have the kinds that a tool requires."""
    return tuple(place.kind for place in places) == tuple(asked.kind for asked in tool.places)
