"""Saved results in the scene: measured regions with labels. The selected result is shown by its handles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import Rgb, rgb
from wafer_viewer.gui.presenters.measurement import sign_colour, symbol
from wafer_viewer.gui.presenters.result_regions import drawn_regions
from wafer_viewer.gui.scene.billboards import Billboard, corner_on_screen
from wafer_viewer.gui.scene.drag_handles import CasedLine
from wafer_viewer.gui.scene.heightfield import HeightField
from wafer_viewer.gui.scene.scene_theme import colours
from wafer_viewer.gui.scene.view_axes import ViewAxes
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.region_shapes import outline_of
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.region import Region

MOST_SIGNS = 60
"""Largest number of marked results, the newest ones, because overlapping labels are illegible."""
_LINE_PX, _SIGN_PX, _RING_PX, _UP_PX = 1.8, 20, 6.0, 1.2
_BESIDE_PX, _ABOVE_PX = 8, 16
_ROUND = np.linspace(0, 2 * np.pi, 24, endpoint=False)


@dataclass(frozen=True, slots=True)
class _Kept:
    """One result: its regions, its label and its selection."""

    places: tuple[Region, ...]
    sign: str
    colour: Rgb
    chosen: bool


class KeptMarks:
    """Markers of the saved results: one node for all outlines of a colour, one node per label."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._kept: list[_Kept] = []
        self._lines: dict[Rgb, CasedLine] = {}
        self._signs: list[Billboard] = []

    def show(self, findings: Sequence[AnyResult], view: View) -> None:
        """Show the results that were measured on the surface of a view."""
        kept = [_kept(f, view) for f in findings if f.show == view.show][-MOST_SIGNS:]
        if kept == self._kept:
            return
        self.remove()
        self._kept = kept
        outlined = {one.colour for one in kept if not one.chosen}
        self._lines = {c: CasedLine(self._scene, f"kept/line/{k}", c, _LINE_PX) for k, c in enumerate(outlined)}
        self._signs = [
            Billboard(self._scene, f"kept/sign/{k}", one.sign, one.colour, _SIGN_PX) for k, one in enumerate(kept)
        ]

    def draw(self, land: HeightField, gaze: ViewAxes) -> None:
        """Draw the markers on the displayed surface."""
        for colour, line in self._lines.items():
            drawn = [p for one in self._kept if one.colour == colour and not one.chosen for p in one.places]
            pieces = np.concatenate([_outline(p, land, gaze.mm_per_pixel) for p in drawn])
            line.lay(pieces, None, 1.6 * gaze.mm_per_pixel)
        for one, sign in zip(self._kept, self._signs, strict=True):
            _place(sign, one.places[0], land, gaze)

    def remove(self) -> None:
        """Remove all markers from the scene."""
        for part in (*self._lines.values(), *self._signs):
            part.remove()
        self._kept, self._lines, self._signs = [], {}, []


def _kept(finding: AnyResult, view: View) -> _Kept:
    chosen = finding.number == view.selected
    colour = colours(view.dark).mark if chosen else rgb(sign_colour(finding)[1:])
    return _Kept(drawn_regions(finding), symbol(finding), colour, chosen)


def _outline(region: Region, land: HeightField, mm_per_pixel: float) -> NDArray[np.float32]:
    """Return the segments of an outline, [n, 2, 3]: a line is draped, a point gets a ring."""
    lift = _UP_PX * mm_per_pixel
    if region.kind == "line":
        first, last = ((p.x_um, p.y_um) for p in region.points)
        points, _ = land.drape_line(first, last, lift)
        return np.stack([points[:-1], points[1:]], axis=1)
    corners = outline_of(region)
    if len(corners) == 0:
        ring_um, at = _RING_PX * 1e3 * mm_per_pixel, region.points[0]
        corners = np.stack([at.x_um + ring_um * np.cos(_ROUND), at.y_um + ring_um * np.sin(_ROUND)], axis=1)
    return land.drape_outline(corners, lift)


def _place(sign: Billboard, region: Region, land: HeightField, gaze: ViewAxes) -> None:
    """Place a label at the upper left corner of a region on the screen, or at the end of a line."""
    place = region if region.kind != "line" else Region.point(region.points[1].x_um, region.points[1].y_um)
    corner, up_px = corner_on_screen(place, land, gaze, -1, 1), _ABOVE_PX if region.kind == "point" else _BESIDE_PX
    sign.place(corner, land, gaze, -_BESIDE_PX, up_px)
