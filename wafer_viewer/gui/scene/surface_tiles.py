"""Scene items of a surface: pyramid tiles by view, or of one level, with side walls."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from typing import Any, TypeVar

import msgspec
import numpy as np
import viser

from wafer_viewer.draw.colormaps import DIVERGING
from wafer_viewer.draw.surface.display_style import DisplayStyle, Light
from wafer_viewer.gui.scene.primitives import add_glb
from wafer_viewer.gui.scene.quadtree import DRAFT_LEVELS, Frustum, Ground, Heights, Leaf, Span, leaves, roots
from wafer_viewer.gui.scene.reconciler import Handle, NotReady, Paint, RenderQueue, SceneItem, TileExtent
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.state.view_state import Look as LookMode
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.measurement.tool_options import Datum, Levelling
from wafer_viewer.session.rendering.render_request import (
    CoarseHeightField,
    ColourScale,
    Kind,
    RenderRequest,
    SurfaceKey,
    SurfaceStatistics,
    unpack_points,
)

# -------------------------------------------------------------------------------------------------------- surface cache


FindDatum = Callable[[Levelling, int], Datum]
_MAX_DATUMS = 64


class DatumCache:
    """Datums by surface and levelling. `arrived` is called on another thread when one is available."""

    def __init__(self, find: FindDatum, arrived: Callable[[], None]) -> None:
        self._find, self._arrived = find, arrived
        self._requested: dict[tuple[SurfaceKey, Levelling], Future[Datum]] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="datum")

    def of(self, source: SurfaceKey, levelling: Levelling) -> Datum | None:
        """Return the datum, None for the stage's zero. Raises NotReady; MeasureError if it cannot be determined."""
        if levelling.by == "stage":
            return None
        future = self._requested.get((source, levelling))
        if future is None:
            while len(self._requested) >= _MAX_DATUMS:
                del self._requested[next(iter(self._requested))]
            future = self._requested[source, levelling] = self._pool.submit(self._find, levelling, source.show)
            future.add_done_callback(lambda _: self._arrived())
        if not future.done():
            raise NotReady
        return future.result()

    def close(self) -> None:
        """Stop the thread."""
        self._pool.shutdown(wait=False, cancel_futures=True)


Answer = TypeVar("Answer", SurfaceStatistics, ColourScale, CoarseHeightField)
_MAX_ENTRIES = 256


class SurfaceInfoCache:
    """Statistics, colour scales and coarse heights by request. Pending requests raise NotReady.

    All values are relative to the datum if one is given. `find_datum` is called on its own thread.
    """

    def __init__(self, paint: Paint, arrived: Callable[[], None], find_datum: FindDatum) -> None:
        self._orders = RenderQueue(paint, arrived)
        self._answers: dict[RenderRequest, SurfaceStatistics | ColourScale | CoarseHeightField] = {}
        self._datums = DatumCache(find_datum, arrived)

    def close(self) -> None:
        """Stop the thread."""
        self._datums.close()

    def datum(self, source: SurfaceKey, levelling: Levelling) -> Datum | None:
        """Return the zero-height datum; None for the stage's zero. Raises MeasureError if it cannot be determined."""
        return self._datums.of(source, levelling)

    def facts(self, source: SurfaceKey, datum: Datum | None = None) -> SurfaceStatistics:
        """Return the statistics of the surface."""
        return self._look_up(RenderRequest(source, "facts", datum=datum), SurfaceStatistics)

    def available_facts(self, sources: dict[int, SurfaceKey]) -> dict[int, SurfaceStatistics]:
        """Return the statistics of the surfaces for which they are available, and request the others."""
        facts: dict[int, SurfaceStatistics] = {}
        for number, source in sources.items():
            try:
                facts[number] = self.facts(source)
            except NotReady:
                continue
        return facts

    def scale(self, source: SurfaceKey, view: View, datum: Datum | None = None) -> ColourScale:
        """Return the colour scale of the displayed quantity, with the selected range or its default."""
        light, look = self.facts(source, datum).light, DisplayStyle(colour_by=view.colour_by)
        request = RenderRequest(source, "scale", look=look, light=light, range_values=view.range_um, datum=datum)
        return self._look_up(request, ColourScale)

    def relief(self, shown: DisplayedSurface) -> CoarseHeightField:
        """Return the coarse heights of the displayed surface."""
        return self._look_up(RenderRequest(shown.source, "relief", datum=shown.datum), CoarseHeightField)

    def available_relief(self, source: SurfaceKey, datum: Datum | None) -> CoarseHeightField | None:
        """Return the coarse heights; None while they are pending."""
        try:
            return self._look_up(RenderRequest(source, "relief", datum=datum), CoarseHeightField)
        except NotReady:
            return None

    def _look_up(self, request: RenderRequest, kind: type[Answer]) -> Answer:
        cached = self._answers.get(request)
        if isinstance(cached, kind):
            return cached
        answer = msgspec.msgpack.decode(self._orders.outcome(request).result(), type=kind)
        while len(self._answers) >= _MAX_ENTRIES:
            del self._answers[next(iter(self._answers))]
        self._answers[request] = answer
        return answer


_MAX_RANGES = 4096


def heights_of(on_show: DisplayedSurface, relief: CoarseHeightField | None) -> Heights:
    """Return a function for the lowest and highest scene z (mm) of a part; the global range without a relief."""
    facts = on_show.facts
    full_range = on_show.scene_z(facts.low_um), on_show.scene_z(facts.high_um)
    if relief is None:
        return lambda rows, cols: full_range
    z_um = np.frombuffer(relief.z_um, "<f4").reshape(relief.rows, relief.cols)
    scale = relief.pixel_um / facts.pixel_um

    @lru_cache(maxsize=_MAX_RANGES)
    def heights(rows: Span, cols: Span) -> tuple[float, float]:
        (r0, r1), (c0, c1) = (_part(span, scale, n) for span, n in zip((rows, cols), z_um.shape, strict=True))
        part = z_um[r0:r1, c0:c1]
        return on_show.scene_z(float(part.min())), on_show.scene_z(float(part.max()))

    return heights


def _part(span: Span, scale: float, n: int) -> Span:
    """Convert a span of level 0 to pixels of the relief, at least one."""
    first = min(max(0, int(span[0] / scale)), n - 1)
    return first, max(first + 1, min(n, int(np.ceil(span[1] / scale))))


# -------------------------------------------------------------------------------------------------------- surface tiles


Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""
VERTICES = 200_000
"""Most vertices of a surface drawn at one level."""
SHARP_PX: dict[LookMode, float] = {"surface": 1.5, "points": 2.6, "plan": 1.5}
MOST_TILES: dict[LookMode, int] = {"surface": 34, "points": 9, "plan": 34}
"""Largest texel in view, in screen pixels, and the limit of tiles, which takes precedence."""
_STEP, _FLAT_STEP = 8, 64
"""Pixels between vertices of a tile at its own level."""
OWN_COLOURS = {"grey": "grey", "difference": DIVERGING, "confidence": "cividis", "uncertainty": "cividis"}
"""Colour map of quantities with a fixed one."""
LIGHT_ON = {"origin": 0.25, "overlap": 0.6, "uncertainty": 0.6}
"""Hillshade factor for categorical colours (origin), and where shadows look like values (overlap, uncertainty)."""
_TILE_PX = 320
_DRAWN_LARGER = 2.0
"""viser draws points larger than their set size by this factor and by the mean scale of their node."""
_NEARLY = 0.96, 1.04
"""Relative tolerance within which the point size is not updated."""
READ_AROUND_PX = 16
"""Margin that the renderer reads around a tile, for continuous lighting across its edge."""
_SHAPES: dict[LookMode, Kind] = {"surface": "tile", "points": "points", "plan": "flat"}


@dataclasses.dataclass(frozen=True, slots=True)
class TileCut:
    """A level, its window with data, and the step between vertices."""

    level: int
    rows: Span
    cols: Span
    step: int

    def tiles(self) -> Iterator[tuple[Span, Span]]:
        """Yield [first, end) rows and columns of each tile; neighbours share a line of pixels, so that they join."""
        for rows in _spans(*self.rows, self.step):
            for cols in _spans(*self.cols, self.step):
                yield rows, cols


def _spans(first: int, end: int, step: int) -> list[Span]:
    length = max(step, _TILE_PX // step * step)
    starts = range(first, max(end - 1, first + 1), length)
    return [(start, min(start + length + 1, end)) for start in starts]


def cut(facts: SurfaceStatistics, texture_pixels: int) -> TileCut:
    """Return the finest level within a budget of texture pixels, with at most `VERTICES` vertices."""
    rows, cols = facts.end_row - facts.first_row, facts.end_col - facts.first_col
    level = max(0, math.ceil(math.log2(max(1.0, rows * cols / texture_pixels)) / 2))
    scale = 2**level
    step = max(1, math.ceil(math.sqrt(rows * cols / scale**2 / VERTICES)))
    level_rows, level_cols = (_at_level(window, level) for window in _window(facts))
    return TileCut(level, level_rows, level_cols, step)


def _at_level(window: Span, level: int) -> Span:
    """Convert a span of level 0 to a coarser level, with at least two pixels."""
    first, end = window
    return first >> level, max((first >> level) + 2, -(-end >> level))


def _window(facts: SurfaceStatistics) -> tuple[Span, Span]:
    return (facts.first_row, facts.end_row), (facts.first_col, facts.end_col)


def bounds_mm(facts: SurfaceStatistics) -> tuple[float, float, float, float]:
    """Return (x low, y low, x high, y high) of the measured window."""
    pixel = facts.pixel_um * 1e-3
    x, y = facts.x0_um * 1e-3, facts.y0_um * 1e-3
    return (
        x + facts.first_col * pixel, y - (facts.end_row - 1) * pixel,
        x + (facts.end_col - 1) * pixel, y - facts.first_row * pixel,
    )  # fmt: skip


def display_style_of(view: View, scale: ColourScale) -> DisplayStyle:
    """Return the display style of a view with the colour range; origin colours get little shading for legibility."""
    colours = OWN_COLOURS.get(view.colour_by, view.colours)
    light = LIGHT_ON.get(view.colour_by, 1.0)
    points = view.look == "points"
    return DisplayStyle(
        view.colour_by,
        colours,
        scale.low,
        scale.high,
        hillshade=0.0 if points else view.hillshade * light,
        all_in_focus=view.all_in_focus,
        depth_shade=view.depth_shade * light if points else 0.0,
        brush_um=view.brush,
    )


@dataclasses.dataclass(frozen=True, slots=True)
class Shown:
    """A surface to be drawn.

    facts: statistics with the window that is divided into tiles.
    measured: statistics with the window that the walls enclose.
    stamp_of: returns the stamp of the last change within a box in um; None: that of the source.
    datum: zero-height reference; None: the stage's zero.
    """

    source: SurfaceKey
    facts: SurfaceStatistics
    measured: SurfaceStatistics
    stamp_of: Callable[[Box], int] | None = None
    datum: Datum | None = None

    def at(self, level: int, rows: Span, cols: Span) -> SurfaceKey:
        """Return the source of a part, with an older stamp where nothing has changed since."""
        if self.stamp_of is None:
            return self.source
        return dataclasses.replace(self.source, stamp=self.stamp_of(_box_um(self.facts, level, rows, cols)))


def surface_items(
    shown: Shown, look: DisplayStyle, view: View, z0_um: float, texture_pixels: int, prefix: str
) -> list[SceneItem]:
    """Return a surface at one level with its walls, independent of the camera; a ``plan`` is flat without walls."""
    facts = shown.facts
    part = cut(facts, texture_pixels)
    base = _base(shown, look, view, z0_um)
    items = [
        _tile(
            f"{prefix}/{part.level}/{rows[0]}_{cols[0]}",
            dataclasses.replace(base, level=part.level, step=part.step, rows=rows, cols=cols),
            shown,
        )
        for rows, cols in part.tiles()
    ]
    request = dataclasses.replace(base, level=part.level, step=part.step)
    return items + (_walls(f"{prefix}/{part.level}/walls", request, shown) if view.look == "surface" else [])


def _base(shown: Shown, look: DisplayStyle, view: View, z0_um: float) -> RenderRequest:
    """Return the render request that all tiles of a surface share."""
    return RenderRequest(
        shown.source, _SHAPES[view.look], look=look, light=shown.facts.light, z0_um=z0_um, dark=view.dark,
        datum=shown.datum, clip=view.clipped,
    )  # fmt: skip


@dataclasses.dataclass(frozen=True, slots=True)
class TiledSurface:
    """A surface with view-dependent tiles. heights_mm: height range of a part as drawn; see `quadtree`."""

    shown: Shown
    look: DisplayStyle
    view: View
    z0_um: float
    heights_mm: Heights
    prefix: str = "surface"

    def first_items(self) -> list[SceneItem]:
        """Return a coarse version of the entire surface."""
        return self._items([Leaf(node, True) for node in roots(self._ground)])

    def items(self, sight: Frustum, finer: float = 1.0) -> list[SceneItem]:
        """Return the items for a view, its centre first; `finer`: rendered pixels per screen pixel."""
        look = self.view.look
        return self._items(leaves(self._ground, sight, SHARP_PX[look] / finer, round(MOST_TILES[look] * finer**2)))

    @property
    def _ground(self) -> Ground:
        facts = self.shown.facts
        rows, cols = _window(facts)
        pixel = facts.pixel_um * 1e-3
        x0, y0 = facts.x0_um * 1e-3 - pixel / 2, facts.y0_um * 1e-3 + pixel / 2
        return Ground(rows, cols, x0, y0, pixel, self.heights_mm)

    def _items(self, cover: list[Leaf]) -> list[SceneItem]:
        base = _base(self.shown, self.look, self.view, self.z0_um)
        base = dataclasses.replace(base, refused=self.view.draws_refused)
        return [item for leaf in cover for item in self._leaf_items(leaf, base)]

    def _leaf_items(self, leaf: Leaf, base: RenderRequest) -> Iterator[SceneItem]:
        """Yield the tile of a leaf, and the walls at the surface edges within it."""
        node, shown = leaf.node, self.shown
        request = _cut_out(base, leaf, shown.facts)
        place = f"{node.level}/{node.row}_{node.col}"
        yield _tile(f"{self.prefix}/{place}", request, shown, TileExtent(self.prefix, *node.spans))
        if self.view.look == "surface":
            for side, edge in _edges_in(request, shown.measured):
                wall = dataclasses.replace(_wall(edge, shown), side=side)
                layer = f"{self.prefix}/wall-{side}"
                yield SceneItem(f"{layer}/{place}", wall, add_glb, wall, True, TileExtent(layer, *node.spans))


def _cut_out(base: RenderRequest, leaf: Leaf, facts: SurfaceStatistics) -> RenderRequest:
    """Return the request for a leaf: its pixels and one more on each side, so that tiles of all levels overlap.

    Points have no overlap, because each must be drawn only once.
    """
    node = leaf.node
    level = max(0, node.level if leaf.in_view else node.level + DRAFT_LEVELS)
    side = node.side_px >> level
    step = max(1, _STEP >> max(0, -node.level)) if leaf.in_view else _STEP
    window = [_at_level(span, level) for span in _window(facts)]
    more = 0 if base.what == "points" else 1
    rows, cols = (
        (
            max(first, index * side - more),
            max(min(end, (index + 1) * side + more), max(first, index * side - more) + 1 + more),
        )
        for index, (first, end) in zip((node.row, node.col), window, strict=True)
    )
    inner = (rows[1] < window[0][1], rows[0] > window[0][0], cols[0] > window[1][0], cols[1] < window[1][1])
    step = _FLAT_STEP if base.what == "flat" else step
    return dataclasses.replace(base, level=level, step=step, rows=rows, cols=cols, skirts=inner)


def _edges_in(request: RenderRequest, measured: SurfaceStatistics) -> Iterator[tuple[int, RenderRequest]]:
    """Yield the edges of the measured window within a tile, by the number of their side: see `mesh.walls`."""
    rows, cols = (_at_level(window, request.level) for window in _window(measured))
    across = max(rows[0], request.rows[0]), min(rows[1], request.rows[1])
    along = max(cols[0], request.cols[0]), min(cols[1], request.cols[1])
    for side, line in enumerate((rows[1] - 1, rows[0])):
        if request.rows[0] <= line < request.rows[1] and along[0] + 1 < along[1]:
            yield side, dataclasses.replace(request, rows=(line, line + 1), cols=along)
    for side, line in enumerate((cols[0], cols[1] - 1), 2):
        if request.cols[0] <= line < request.cols[1] and across[0] + 1 < across[1]:
            yield side, dataclasses.replace(request, rows=across, cols=(line, line + 1))


def _box_um(facts: SurfaceStatistics, level: int, rows: Span, cols: Span) -> Box:
    """Return the box of a window at a level, including the margin read around it."""
    pixel, spare = facts.pixel_um * 2**level, READ_AROUND_PX * facts.pixel_um * 2**level
    x0, y0 = facts.x0_um - spare, facts.y0_um + spare
    return (
        x0 + cols[0] * pixel,
        y0 - rows[1] * pixel - 2 * spare,
        x0 + cols[1] * pixel + 2 * spare,
        y0 - rows[0] * pixel,
    )


def _tile(name: str, request: RenderRequest, shown: Shown, cover: TileExtent | None = None) -> SceneItem:
    request = dataclasses.replace(request, source=shown.at(request.level, request.rows, request.cols))
    if request.what != "points":
        return SceneItem(name, request, add_glb, request, request.what == "tile", cover)
    facts = shown.facts
    return SceneItem(
        name, request, lambda scene, node, data: _add_points(scene, node, data, request, facts), request, True, cover
    )


def _walls(name: str, base: RenderRequest, shown: Shown) -> list[SceneItem]:
    """Return the four walls of a surface at one level."""
    rows, cols = (_at_level(window, base.level) for window in _window(shown.measured))
    request = _wall(dataclasses.replace(base, rows=rows, cols=cols), shown)
    return [SceneItem(name, request, add_glb, request, stretched=True)]


def _wall(window: RenderRequest, shown: Shown) -> RenderRequest:
    """Return the request for the walls of a window; it has no display style, because walls do not depend on it."""
    (top, foot), (left, right) = window.rows, window.cols
    edges = (
        (window.rows, (left, left)), (window.rows, (right, right)),
        ((top, top), window.cols), ((foot, foot), window.cols),
    )  # fmt: skip
    source = max((shown.at(window.level, *edge) for edge in edges), key=lambda edge: edge.stamp)
    none = (False, False, False, False)
    return dataclasses.replace(window, source=source, what="walls", look=DisplayStyle(), light=Light(), skirts=none)


class PointTile:
    """Points of a tile with a constant screen size at the point looked at. size_px: requested size."""

    def __init__(self, handle: Any, n_points: int) -> None:
        self._handle, self.n_points, self.size_px = handle, n_points, 3.0

    def settle(self, mm_per_pixel: float) -> None:
        """Set the point size for a pixel size in mm."""
        stretch = float(np.cbrt(np.prod(np.broadcast_to(self._handle.scale, 3))))
        size = self.size_px * mm_per_pixel / _DRAWN_LARGER / stretch
        if not _NEARLY[0] < size / self._handle.point_size < _NEARLY[1]:
            self._handle.point_size = size

    @property
    def scale(self) -> Any:
        """Scale of the node."""
        return self._handle.scale

    @scale.setter
    def scale(self, scale: Any) -> None:
        self._handle.scale = scale

    def remove(self) -> None:
        """Remove the points from the scene."""
        self._handle.remove()


def _add_points(
    scene: viser.SceneApi, name: str, data: bytes, request: RenderRequest, facts: SurfaceStatistics
) -> Handle:
    """Add points relative to the centre of their window, because float16 is too coarse in stage coordinates."""
    places, colours = unpack_points(data)
    pixel = facts.pixel_um * 2**request.level * 1e-3
    first = (2**request.level - 1) / 2 * facts.pixel_um * 1e-3
    x = facts.x0_um * 1e-3 + first + (sum(request.cols) - 1) / 2 * pixel
    y = facts.y0_um * 1e-3 - first - (sum(request.rows) - 1) / 2 * pixel
    shades = colours if len(places) else np.zeros(3, np.uint8)  # the browser complains of a cloud without any colour
    cloud = scene.add_point_cloud(
        name, places, shades, point_size=pixel * 1.15, point_shape="square", point_shading="flat",
        precision="float16", position=(x, y, 0.0),
    )  # fmt: skip
    return PointTile(cloud, len(places))
