"""Draggable regions in the scene: an outline, handles and a label."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.gui.scene.billboards import Billboard, corner_on_screen
from wafer_viewer.gui.scene.drag_handles import CasedLine, Dragged, DragHandle
from wafer_viewer.gui.scene.heightfield import HeightField, Place
from wafer_viewer.gui.scene.view_axes import ViewAxes
from wafer_viewer.gui.tools.region_shapes import SHAPES, WHOLE
from wafer_viewer.model.region import Region

_WHOLE_PX, _EDGE_PX, _POINT_PX = 7.5, 5.5, 8.5
_SIGN_PX, _BESIDE_PX = 26, 12
_ROOMY_PX, _LEAST_KNOB = 60, 0.4
"""Size of a region in pixels from which handles have full size, and the smallest fraction of that size."""
_ENDS_OF_A_WAY = ("point", "point")
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
        whole_px = _WHOLE_PX if outlined else _POINT_PX
        self._knobs = {
            hold: DragHandle(scene, f"{name}/{hold}", colour, whole_px if hold == WHOLE else _EDGE_PX, dragged)
            for hold in self._shape.holds(region)
        }
        self._sign = Billboard(scene, f"{name}/sign", title, colour, _SIGN_PX)

    def pull(self, hold: str, to: Place, land: HeightField) -> None:
        """Apply the new position of a handle."""
        self.region = self._shape.pulled(self.region, hold, to, land)

    def draw(self, land: HeightField, gaze: ViewAxes) -> None:
        """Draw the region on the displayed surface."""
        mm_per_pixel = gaze.mm_per_pixel
        if self._outline is not None:
            pieces = land.drape_outline(self._shape.outline(self.region), 2 * mm_per_pixel)
            self._outline.lay(pieces, None, 1.6 * mm_per_pixel)
        for hold, (x, y) in self._shape.holds(self.region).items():
            at = land.visible_points(np.array([x]), np.array([y]), 3 * mm_per_pixel)[0]
            self._knobs[hold].place(at, mm_per_pixel * self._knob_share(mm_per_pixel), gaze.towards)
        self._place_sign(land, gaze)

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

    def _place_sign(self, land: HeightField, gaze: ViewAxes) -> None:
        """Place the label to the left of the region on the screen."""
        left = corner_on_screen(self.region, land, gaze, -1, 0)
        self._sign.place(left, land, gaze, -_BESIDE_PX)


class Places:
    """A list of regions with a common name; their handles are named NAME/NUMBER/HOLD."""

    def __init__(self, scene: viser.SceneApi, name: str, dragged: Dragged) -> None:
        self._scene, self._name, self._dragged = scene, name, dragged
        self._titles: tuple[str, ...] = ()
        self._kinds: tuple[str, ...] = ()
        self._colour: Rgb | None = None
        self._handles: list[PlaceHandle] = []
        self._way: CasedLine | None = None

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
        if kinds == _ENDS_OF_A_WAY:
            self._way = CasedLine(self._scene, f"{self._name}/way", colour, 2.0)

    def move(self, regions: Sequence[Region]) -> None:
        """Move to these regions of the same kinds."""
        for handle, region in zip(self._handles, regions, strict=True):
            handle.region = region

    def pull(self, name: str, to: Place, land: HeightField) -> None:
        """Apply the new position of a handle, NAME/NUMBER/HOLD."""
        _, number, hold = name.split("/")
        if int(number) < len(self._handles):
            self._handles[int(number)].pull(hold, to, land)

    def draw(self, land: HeightField, gaze: ViewAxes) -> None:
        """Draw the regions on the displayed surface."""
        for handle in self._handles:
            handle.draw(land, gaze)
        if self._way is not None:
            start, end = ((r.points[0].x_um, r.points[0].y_um) for r in self.regions)
            points, measured = land.drape_line(start, end, 1.5 * gaze.mm_per_pixel)
            self._way.lay(np.stack([points[:-1], points[1:]], axis=1), measured, 1.6 * gaze.mm_per_pixel)

    def remove(self) -> None:
        """Remove the regions from the scene."""
        for handle in self._handles:
            handle.remove()
        if self._way is not None:
            self._way.remove()
            self._way = None
        self._handles, self._titles, self._kinds, self._colour = [], (), (), None
