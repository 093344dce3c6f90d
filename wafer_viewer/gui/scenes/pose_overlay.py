"""Layer of the Surface step with solved field positions, their offsets from the stage, and the overlaps.

Pieces are straight, float64 [n, 2, 2]: start and end, x and y.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import msgspec
import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.draw.raster_text import tag, text_atlas
from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.scene.primitives import DrapedLines, Layer, Layers, lines
from wafer_viewer.gui.scene.reconciler import SceneItem
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface, colours
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, Poses, RejectionReason
from wafer_viewer.session.rendering.render_request import CoarseHeightField, RenderRequest, SurfaceKey


@dataclass(frozen=True, slots=True, eq=False)
class CachedPoses:
    """Field poses of a surface; None if its fields are at their stage positions."""

    of: SurfaceKey
    poses: Poses | None


class PoseCache:
    """Cache of field poses. `read` may block and raise; `failed` receives its errors."""

    def __init__(self, read: Callable[[], Poses | None], failed: Callable[[Exception], None]) -> None:
        self._read, self._failed = read, failed
        self._requested: SurfaceKey | None = None
        self._cached: CachedPoses | None = None
        self._listeners: list[Callable[[], object]] = []
        self._worker = LatestOnlyWorker("poses")

    def on_arrival(self, callback: Callable[[], object]) -> None:
        """Call back on the cache's thread when poses have been read."""
        self._listeners.append(callback)

    def at(self, source: SurfaceKey) -> CachedPoses | None:
        """Return the poses of a surface, the previous ones while new ones are read; None if there are none yet."""
        if source != self._requested:
            self._requested = source
            self._worker.ask(lambda: self._look_up(source))
        cached = self._cached
        same = cached is not None and (cached.of.dataset, cached.of.result) == (source.dataset, source.result)
        return cached if same else None

    def close(self) -> None:
        """Stop the thread."""
        self._worker.close()

    def _look_up(self, source: SurfaceKey) -> None:
        try:
            self._cached = CachedPoses(source, self._read())
        except WaferViewerError as fault:  # told, and the page goes on without poses
            self._cached = CachedPoses(source, None)
            self._failed(fault)
        for listener in self._listeners:
            listener()


Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LONG, _WIDE = 0.55, 0.25
"""Limits for the 90th percentile of arrow lengths and circle radii, as fractions of a field's shorter side."""
_MOST_TIMES = 1000.0
_HEAD = 0.07
_TURN = np.linspace(0, 2 * np.pi, 25)
_LEAST_CIRCLE, _MOST_CIRCLE = 0.012, 0.45
STITCH = 0.15
"""Length of the line across an overlap, as a fraction of a field's shorter side."""
_INSET = 0.14
"""Inset of an overlap's frame, as a fraction of its shorter side."""


class Fields:
    """Field frames of equal size at their solved positions, boxes [n, 4] as x low, y low, x high, y high.

    every: only each n-th of very many fields is drawn, in addition to all excluded fields.
    """

    def __init__(self, poses: Poses, width_um: float, height_um: float, most: int = 4000) -> None:
        self.poses = poses
        self.unit_um = min(width_um, height_um)
        x, y = poses.x_um, poses.y_um
        half = width_um / 2, height_um / 2
        self.boxes: Floats = np.stack([x - half[0], y - half[1], x + half[0], y + half[1]], axis=1)
        self.every = max(1, math.ceil(len(x) / most))
        self.drawn: Mask = ~poses.left_out & (np.arange(len(x)) % self.every == 0)
        self.times = self._times()

    def _times(self) -> float:
        """Return the magnification of arrows and circles: 1, 2 or 5 times a power of ten, limited by the field size."""
        poses, included = self.poses, ~self.poses.left_out
        moved, u_um = np.hypot(*self._moved(included)), 2 * np.maximum(poses.u_x_um, poses.u_y_um)[included]
        u_um = u_um[np.isfinite(u_um)]
        shares = [float(np.percentile(um, 90)) / room for um, room in ((moved, _LONG), (u_um, _WIDE)) if len(um)]
        largest = max(shares, default=0.0)
        return min(_MOST_TIMES, round_below(self.unit_um / largest)) if moved.any() and largest > 0 else 1.0

    def _moved(self, which: Mask) -> tuple[Floats, Floats]:
        poses = self.poses
        return (poses.x_um - poses.stage_x_um)[which], (poses.y_um - poses.stage_y_um)[which]

    # ---------------------------------------------------------------- fields

    def outlines(self) -> Floats:
        """Return the frames of the included fields."""
        return sides(self.boxes[self.drawn])

    def left_out(self) -> Floats:
        """Return the crosses through the excluded fields."""
        x0, y0, x1, y1 = self.boxes[self.poses.left_out].T
        rising, falling = np.stack([x0, y0, x1, y1], axis=1), np.stack([x0, y1, x1, y0], axis=1)
        return np.concatenate([rising, falling]).reshape(-1, 2, 2)

    def left_out_frames(self) -> Floats:
        """Return the frames of the excluded fields."""
        return sides(self.boxes[self.poses.left_out])

    # ---------------------------------------------------------------- from the stage's place to the solved one

    def arrows(self) -> Floats:
        """Return arrows with heads from stage to solved positions, magnified by `times`: [n, 3, 2, 2]."""
        tails = np.stack([self.poses.stage_x_um, self.poses.stage_y_um], axis=1)[self.drawn]
        shifts = np.stack(self._moved(self.drawn), axis=1) * self.times
        long = np.hypot(shifts[:, 0], shifts[:, 1])
        large = long > _LEAST_CIRCLE * self.unit_um
        tails, shifts, long = tails[large], shifts[large], long[large, None]
        along = shifts / long
        normals = along[:, ::-1] * (-1.0, 1.0)
        head, tips = np.minimum(0.4 * long, _HEAD * self.unit_um), tails + shifts
        barbs = [tips - head * (along + side * normals) for side in (0.5, -0.5)]
        return np.stack([_pieces(tails, tips), *(_pieces(tips, barb) for barb in barbs)], axis=1)

    def circles(self) -> Floats:
        """Return the expanded uncertainties (k = 2), magnified by `times`, around the arrow tips: [n, 24, 2, 2]."""
        poses = self.poses
        tips = np.stack([poses.stage_x_um, poses.stage_y_um], axis=1)[self.drawn]
        tips = tips + np.stack(self._moved(self.drawn), axis=1) * self.times
        radii = 2 * self.times * np.stack([poses.u_x_um, poses.u_y_um], axis=1)[self.drawn]
        large = np.isfinite(radii).all(axis=1) & (radii.max(axis=1) > _LEAST_CIRCLE * self.unit_um)
        radii = np.minimum(radii[large], _MOST_CIRCLE * self.unit_um)
        round_ = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
        rims = tips[large, None] + radii[:, None] * round_
        return np.stack([rims[:, :-1], rims[:, 1:]], axis=2)

    # ---------------------------------------------------------------- overlaps

    def stitches(self) -> Floats:
        """Return a short line across each accepted overlap, from field to field."""
        first, second = self._pairs(self.poses.shifts.believed)
        between = self._centres(second) - self._centres(first)
        along = between / np.maximum(np.hypot(between[:, 0], between[:, 1]), 1e-9)[:, None]
        middle, half = (self._centres(first) + self._centres(second)) / 2, STITCH / 2 * self.unit_um
        return _pieces(middle - half * along, middle + half * along)

    def doubted(self, blank: bool) -> Floats:
        """Return boxes of the rejected overlaps: the blank ones (`blank`), or those with another reason."""
        doubt = self.poses.shifts.doubt
        which = (
            doubt == RejectionReason.BLANK
            if blank
            else (doubt != RejectionReason.NONE) & (doubt != RejectionReason.BLANK)
        )
        return self.overlaps(which)

    def overlaps(self, which: Mask) -> Floats:
        """Return the common areas of overlapping fields, slightly inset; [n, 4], without empty ones."""
        a, b = (self.boxes[k] for k in self._pairs(which))
        low, high = np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, 2:], b[:, 2:])
        short = (high - low).min(axis=1, keepdims=True)
        boxes = np.concatenate([low + _INSET * short, high - _INSET * short], axis=1)
        return boxes[short[:, 0] > 0]

    def _pairs(self, which: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return first and second fields of the selected overlaps, without those of excluded fields."""
        shifts = self.poses.shifts
        which = which & ~self.poses.left_out[shifts.first] & ~self.poses.left_out[shifts.second]
        which = which & (self.drawn[shifts.first] | self.drawn[shifts.second])
        return shifts.first[which], shifts.second[which]

    def _centres(self, k: NDArray[np.int32]) -> Floats:
        return np.stack([self.poses.x_um[k], self.poses.y_um[k]], axis=1)


def round_below(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20 … that does not exceed a value; at least 1."""
    if value < 1:
        return 1.0
    ten = 10.0 ** math.floor(math.log10(value))
    return ten * max(step for step in (1.0, 2.0, 5.0) if step * ten <= value * (1 + 1e-9))


def sides(boxes: Floats) -> Floats:
    """Return the four sides of boxes [n, 4] as pieces [4 n, 2, 2]."""
    x0, y0, x1, y1 = boxes.T
    corners = np.stack([np.stack(c, axis=1) for c in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], axis=1)
    return np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)


def in_dashes(pieces: Floats, dash_um: float, share: float = 0.55) -> Floats:
    """Return pieces in dashes. Each is divided into full periods, so that a dash begins at every corner."""
    counts = np.maximum(1, np.round(np.hypot(*(pieces[:, 1] - pieces[:, 0]).T) / dash_um)).astype(int)
    piece = np.repeat(np.arange(len(pieces)), counts)
    place = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    begin, vector = pieces[piece, 0], pieces[piece, 1] - pieces[piece, 0]
    first, last = (((place + end) / counts[piece])[:, None] for end in (0.0, share))
    return _pieces(begin + vector * first, begin + vector * last)


def _pieces(begin: Floats, end: Floats) -> Floats:
    return np.stack([begin, end], axis=1)


Place = tuple[float, float]
VisibleRange = tuple[float, float]
"""A length in mm and its least size in pixels for the layer to be visible."""
ALWAYS: VisibleRange = (math.inf, 0.0)
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
    cached: CachedPoses, on_show: DisplayedSurface, size_um: tuple[float, float], dark: bool, flat: bool
) -> list[SceneItem]:
    """Return the layer as one item that requires the coarse heights; none if only stage positions are known."""
    if cached.poses is None:
        return []
    make = partial(_overlay, poses=cached.poses, size_um=size_um, dark=dark, flat=flat, z0_um=on_show.z0_um)
    content = (cached.of, on_show.source, on_show.z0_um, size_um, dark, flat)
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

    def line(
        self, layer: int, kind: str, pieces_um: Floats, colour: Rgb, width_px: float, visible: VisibleRange = ALWAYS
    ) -> None:
        """Add cased lines; nothing for no pieces. Figures, [n, m, 2, 2], are drawn level."""
        segments = self._drape.level(pieces_um) if pieces_um.ndim == 4 else self._drape.segments(pieces_um)
        wide = width_px * self._weight
        if not len(segments):
            return
        casing = lines(self._scene, f"{self._name}/{kind}/casing", segments, self._casing, wide + 2.8 * self._weight)
        line = lines(self._scene, f"{self._name}/{kind}/line", segments, colour, wide)
        foot_px = layer * _LAYER_PX
        self.layers += [Layer(casing, foot_px + 1.0, *visible), Layer(line, foot_px + 3.0, *visible)]

    def words(
        self, layer: int, kind: str, tags: list[NDArray[np.uint8]], at_um: Floats, high_um: float, anchor: Place
    ) -> None:
        """Add labels above the heights they cover; `anchor`: fraction of their size (from below) at the position."""
        if not tags:
            return
        picture, uv = text_atlas(tags)
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
    tags = [tag(str(n), ink.on_plate, ink.field) for n in fields.poses.numbers[fields.drawn].tolist()]
    inset = _CORNER * fields.unit_um
    corners = fields.boxes[fields.drawn][:, (0, 3)] + np.array([inset, -inset])
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
    labels = [
        (fields.overlaps(np.arange(len(doubt)) == row), DOUBT_TITLES[RejectionReason(int(doubt[row]))]) for row in rows
    ]
    labels = [(box, words) for box, words in labels if len(box)]
    middles = np.array([(box[0, :2] + box[0, 2:]) / 2 for box, _ in labels]).reshape(-1, 2)
    tags = [tag(words, ink.on_plate, ink.doubt) for _, words in labels]
    pen.words(3, "reasons", tags, middles, _REASON * fields.unit_um, (0.5, 0.5))
