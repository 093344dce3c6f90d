"""Layer of the Surface step with solved field positions, their offsets from the stage positions and the overlaps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import msgspec
import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.draw.raster_text import sheet, tag
from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.glb import painted
from wafer_viewer.gui.scene.draped_lines import DrapedLines
from wafer_viewer.gui.scene.primitives import Layer, Layers, lines
from wafer_viewer.gui.scene.reconciler import SceneItem
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.scene.scene_theme import colours
from wafer_viewer.gui.scenes.pose_cache import CachedPoses
from wafer_viewer.gui.scenes.pose_geometry import STITCH, Fields, Floats, in_dashes, sides
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, Poses, RejectionReason
from wafer_viewer.session.rendering.render_request import CoarseHeightField, RenderRequest

Place = tuple[float, float]
Seen = tuple[float, float]
"""A length in mm and its least size in pixels for the layer to be visible."""
ALWAYS: Seen = (math.inf, 0.0)
LEAST_WORD_PX, LEAST_STITCH_PX = 10.0, 7.0
_FEW = 40
"""Largest number of fields drawn with lines of full width."""
_MOST_NUMBERS = 1000
"""Beyond this number of fields, numbers are shown only on the map."""
_MOST_REASONS = 12
_LAYER_PX = 5.0
_SCREEN_PX = 900
"""Assumed width of the surface on the screen until the camera has reported."""
_NUMBER, _CORNER, _REASON, _NAME = 0.2, 0.17, 0.125, 0.2
"""Label heights and the inset of numbers, as fractions of a field's shorter side."""
_DASH, _SPAN = 0.085, 0.07


@dataclass(frozen=True, slots=True)
class Inks:
    """Colours of the layer: muted for accepted items, a warning colour for rejected ones, ink for arrows."""

    field: Rgb
    doubt: Rgb
    blank: Rgb
    arrow: Rgb
    casing: Rgb
    on_plate: Rgb


def inks(dark: bool) -> Inks:
    """Return the colours of a theme."""
    palette = colours(dark)
    return Inks(
        field=palette.accent,
        doubt=palette.doubt,
        blank=palette.soft_ink,
        arrow=palette.arrow,
        casing=palette.under_lines,
        on_plate=palette.under_lines,
    )


def pose_items(
    known: CachedPoses, on_show: DisplayedSurface, size_um: tuple[float, float], dark: bool, flat: bool
) -> list[SceneItem]:
    """Return the layer as one item that requires the coarse heights; none if only stage positions are known."""
    if known.poses is None:
        return []
    make = partial(_overlay, poses=known.poses, size_um=size_um, dark=dark, flat=flat, z0_um=on_show.z0_um)
    content = (known.of, on_show.source, on_show.z0_um, size_um, dark, flat)
    return [
        SceneItem("poses", content, make, RenderRequest(on_show.source, "relief", datum=on_show.datum), stretched=True)
    ]


def _overlay(
    scene: viser.SceneApi, name: str, data: bytes,
    *, poses: Poses, size_um: tuple[float, float], dark: bool, flat: bool, z0_um: float,
) -> Layers:  # fmt: skip
    fields = Fields(poses, *size_um)
    drape = DrapedLines(
        None if flat else msgspec.msgpack.decode(data, type=CoarseHeightField), z0_um, _SPAN * fields.unit_um
    )
    pen = _Pen(scene, name, drape, inks(dark).casing, 1.0 if len(poses.numbers) <= _FEW else 0.6)
    _draw(fields, pen, inks(dark))
    return Layers(pen.layers, float(np.ptp(fields.boxes)) * 1e-3 / _SCREEN_PX)


class _Pen:
    """Draws lines and labels over the surface in layers; `weight` scales the line widths."""

    def __init__(self, scene: viser.SceneApi, name: str, drape: DrapedLines, casing: Rgb, weight: float) -> None:
        self._scene, self._name, self._drape, self._casing, self._weight = scene, name, drape, casing, weight
        self.layers: list[Layer] = []

    def line(self, layer: int, kind: str, pieces_um: Floats, colour: Rgb, width_px: float, seen: Seen = ALWAYS) -> None:
        """Add cased lines; nothing for no pieces. Figures, [n, m, 2, 2], are drawn level."""
        segments = self._drape.level(pieces_um) if pieces_um.ndim == 4 else self._drape.segments(pieces_um)
        wide = width_px * self._weight
        if not len(segments):
            return
        casing = lines(self._scene, f"{self._name}/{kind}/casing", segments, self._casing, wide + 2.8 * self._weight)
        line = lines(self._scene, f"{self._name}/{kind}/line", segments, colour, wide)
        foot_px = layer * _LAYER_PX
        self.layers += [Layer(casing, foot_px + 1.0, *seen), Layer(line, foot_px + 3.0, *seen)]

    def words(
        self, layer: int, kind: str, tags: list[NDArray[np.uint8]], at_um: Floats, high_um: float, anchor: Place
    ) -> None:
        """Add labels above the heights they cover; `anchor`: fraction of their size (from below) at the position."""
        if not tags:
            return
        picture, uv = sheet(tags)
        wide_um = np.array([high_um * t.shape[1] / t.shape[0] for t in tags])
        x, y = at_um[:, 0] - anchor[0] * wide_um, at_um[:, 1] - anchor[1] * high_um
        boxes = np.stack([x, y, x + wide_um, y + high_um], axis=1)
        data = painted(mesh.plates(boxes * 1e-3, self._drape.highest_mm(boxes), uv), picture, blend=True)
        node = self._scene.add_glb(f"{self._name}/{kind}", data, cast_shadow=False, receive_shadow=False)
        self.layers.append(Layer(node, layer * _LAYER_PX + 2.0, high_um * 1e-3, LEAST_WORD_PX))


def _draw(fields: Fields, pen: _Pen, ink: Inks) -> None:
    """Draw all parts, in order of increasing importance."""
    dash = max(_DASH * fields.unit_um, 0.006 * float(np.ptp(fields.boxes)))
    pen.line(0, "fields", fields.outlines(), ink.field, 1.9)
    pen.line(0, "stitches", fields.stitches(), ink.field, 2.8, (STITCH * fields.unit_um * 1e-3, LEAST_STITCH_PX))
    pen.line(1, "blank", in_dashes(sides(fields.doubted(blank=True)), dash), ink.blank, 2.0)
    pen.line(1, "circles", fields.circles(), ink.arrow, 1.6)
    pen.line(2, "arrows", fields.arrows(), ink.arrow, 2.4)
    pen.line(2, "doubted", in_dashes(sides(fields.doubted(blank=False)), dash), ink.doubt, 3.2)
    pen.line(
        2, "left out", np.concatenate([in_dashes(fields.left_out_frames(), dash), fields.left_out()]), ink.doubt, 2.4
    )
    _numbers(fields, pen, ink)
    _names(fields, pen, ink)
    _reasons(fields, pen, ink)


def _numbers(fields: Fields, pen: _Pen, ink: Inks) -> None:
    """Draw field numbers in the upper left corners of the included fields."""
    if len(fields.poses.numbers) > _MOST_NUMBERS:
        return
    tags = [tag(str(n), ink.on_plate, ink.field) for n in fields.poses.numbers[fields.kept].tolist()]
    inset = _CORNER * fields.unit_um
    corners = fields.boxes[fields.kept][:, (0, 3)] + np.array([inset, -inset])
    pen.words(2, "numbers", tags, corners, _NUMBER * fields.unit_um, (0.0, 1.0))


def _names(fields: Fields, pen: _Pen, ink: Inks) -> None:
    """Draw labels on the excluded fields."""
    out = fields.poses.left_out
    tags = [tag(f"{n} left out", ink.on_plate, ink.doubt) for n in fields.poses.numbers[out].tolist()[:_MOST_NUMBERS]]
    middles = (fields.boxes[out][:, :2] + fields.boxes[out][:, 2:])[: len(tags)] / 2
    pen.words(3, "names", tags, middles, _NAME * fields.unit_um, (0.5, 0.5))


def _reasons(fields: Fields, pen: _Pen, ink: Inks) -> None:
    """Draw rejection reasons on the overlaps, if there are few; the list in the panel contains all of them."""
    doubt = fields.poses.shifts.doubt
    rows = np.flatnonzero((doubt != RejectionReason.NONE) & (doubt != RejectionReason.BLANK))
    if len(rows) > _MOST_REASONS:
        return
    found = [
        (fields.overlaps(np.arange(len(doubt)) == row), DOUBT_TITLES[RejectionReason(int(doubt[row]))]) for row in rows
    ]
    found = [(box, words) for box, words in found if len(box)]
    middles = np.array([(box[0, :2] + box[0, 2:]) / 2 for box, _ in found]).reshape(-1, 2)
    tags = [tag(words, ink.on_plate, ink.doubt) for _, words in found]
    pen.words(3, "reasons", tags, middles, _REASON * fields.unit_um, (0.5, 0.5))
