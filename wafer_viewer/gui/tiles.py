"""The surface as items: which level of the pyramid, cut into which tiles, with walls round them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator

import viser

from wafer_viewer.draw.look import Light, Look
from wafer_viewer.gui.stage import Handle, Item
from wafer_viewer.gui.view import View
from wafer_viewer.session.paint_request import Facts, PaintRequest, Scale, Source, unpack_points

Span = tuple[int, int]
"""[first, end) of rows or columns."""
Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""
TEXTURE_PIXELS = 2_200_000
FIRST_PIXELS = 260_000
"""What a first, quick picture may have."""
VERTICES = 200_000
LIGHT_ON = {"origin": 0.25, "overlap": 0.6}
"""How much of the hillshade falls on colours that are looked up one by one, and on those that are far apart."""
_TILE_PX = 320
READ_AROUND_PX = 16
"""The painter reads a little more than a tile, for light to go on across its edge."""
_SHAPES = {"surface": "tile", "points": "points", "plan": "flat"}


@dataclasses.dataclass(frozen=True, slots=True)
class Cut:
    """A level, the window of its lattice that holds anything, and the step from vertex to vertex."""

    level: int
    rows: Span
    cols: Span
    step: int

    def tiles(self) -> Iterator[tuple[Span, Span]]:
        """[first, end) rows and columns of each tile; neighbours share a line of pixels, so that they meet."""
        for rows in _spans(*self.rows, self.step):
            for cols in _spans(*self.cols, self.step):
                yield rows, cols


def _spans(first: int, end: int, step: int) -> list[Span]:
    length = max(step, _TILE_PX // step * step)
    starts = range(first, max(end - 1, first + 1), length)
    return [(start, min(start + length + 1, end)) for start in starts]


def cut(facts: Facts, texture_pixels: int) -> Cut:
    """The finest level within a budget of texture pixels, with at most `VERTICES` vertices."""
    rows, cols = facts.end_row - facts.first_row, facts.end_col - facts.first_col
    level = max(0, math.ceil(math.log2(max(1.0, rows * cols / texture_pixels)) / 2))
    scale = 2**level
    step = max(1, math.ceil(math.sqrt(rows * cols / scale**2 / VERTICES)))
    rows_there, cols_there = (_at_level(window, level) for window in _window(facts))
    return Cut(level, rows_there, cols_there, step)


def _at_level(window: Span, level: int) -> Span:
    """Pixels of level 0 as those of a coarser level, at least two."""
    first, end = window
    return first >> level, max((first >> level) + 2, -(-end >> level))


def _window(facts: Facts) -> tuple[Span, Span]:
    return (facts.first_row, facts.end_row), (facts.first_col, facts.end_col)


def bounds_mm(facts: Facts) -> tuple[float, float, float, float]:
    """(x low, y low, x high, y high) of what is measured."""
    pixel = facts.pixel_um * 1e-3
    x, y = facts.x0_um * 1e-3, facts.y0_um * 1e-3
    return (
        x + facts.first_col * pixel, y - (facts.end_row - 1) * pixel,
        x + (facts.end_col - 1) * pixel, y - facts.first_row * pixel,
    )  # fmt: skip


def look_of(view: View, scale: Scale) -> Look:
    """What the operator chose, with the range the colours span; origins in little light, to be found in the legend."""
    colours = "grey" if view.colour_by == "grey" else view.colours
    shade = view.hillshade * LIGHT_ON.get(view.colour_by, 1.0)
    return Look(view.colour_by, colours, scale.low, scale.high, shade, view.all_in_focus)


@dataclasses.dataclass(frozen=True, slots=True)
class Shown:
    """A surface to be drawn: `facts` with the window that is cut into tiles, and `measured`, where walls stand.

    stamp_of: by box in um, the stamp by which that part became what it is; None: the source's own.
    """

    source: Source
    facts: Facts
    measured: Facts
    stamp_of: Callable[[Box], int] | None = None

    def at(self, level: int, rows: Span, cols: Span) -> Source:
        """The source of a part: an older stamp where nothing has changed since."""
        if self.stamp_of is None:
            return self.source
        return dataclasses.replace(self.source, stamp=self.stamp_of(_box_um(self.facts, level, rows, cols)))


def surface_items(shown: Shown, look: Look, view: View, z0_um: float, texture_pixels: int, prefix: str) -> list[Item]:
    """The tiles of a surface and its walls; with ``plan`` it lies flat and has none."""
    facts = shown.facts
    part = cut(facts, texture_pixels)
    base = PaintRequest(
        shown.source,
        "tile",
        level=part.level,
        step=part.step,
        look=look,
        light=facts.light,
        z0_um=z0_um,
        dark=view.dark,
    )
    items = [
        _tile(
            prefix,
            dataclasses.replace(
                base, source=shown.at(part.level, rows, cols), what=_SHAPES[view.look], rows=rows, cols=cols
            ),
            facts,
        )
        for rows, cols in part.tiles()
    ]
    return items + ([_walls(prefix, base, part, shown)] if view.look == "surface" else [])


def _box_um(facts: Facts, level: int, rows: Span, cols: Span) -> Box:
    """A window of a level's lattice with what is read round it."""
    pixel, spare = facts.pixel_um * 2**level, READ_AROUND_PX * facts.pixel_um * 2**level
    x0, y0 = facts.x0_um - spare, facts.y0_um + spare
    return (
        x0 + cols[0] * pixel,
        y0 - rows[1] * pixel - 2 * spare,
        x0 + cols[1] * pixel + 2 * spare,
        y0 - rows[0] * pixel,
    )


def _tile(prefix: str, request: PaintRequest, facts: Facts) -> Item:
    name = f"{prefix}/{request.level}/{request.rows[0]}_{request.cols[0]}"
    if request.what != "points":
        return Item(name, request, add_glb, request, stretched=request.what == "tile")
    return Item(name, request, lambda scene, node, data: _add_points(scene, node, data, request, facts), request, True)


def _walls(prefix: str, base: PaintRequest, part: Cut, shown: Shown) -> Item:
    rows, cols = (_at_level(window, part.level) for window in _window(shown.measured))
    (top, foot), (left, right) = rows, cols
    edges = ((rows, (left, left)), (rows, (right, right)), ((top, top), cols), ((foot, foot), cols))
    source = max((shown.at(part.level, *edge) for edge in edges), key=lambda edge: edge.stamp)
    # Walls do not depend on how the surface is coloured: a request without the look stays the same.
    request = dataclasses.replace(base, source=source, what="walls", rows=rows, cols=cols, look=Look(), light=Light())
    return Item(f"{prefix}/{part.level}/walls", request, add_glb, request, stretched=True)


def add_glb(scene: viser.SceneApi, name: str, data: bytes) -> Handle:
    """An unlit mesh; shadows would darken what is baked."""
    return scene.add_glb(name, data, cast_shadow=False, receive_shadow=False)


def _add_points(scene: viser.SceneApi, name: str, data: bytes, request: PaintRequest, facts: Facts) -> Handle:
    """Points stand relative to the middle of their window: float16 would be too coarse from the stage's origin."""
    places, colours = unpack_points(data)
    pixel = facts.pixel_um * 2**request.level * 1e-3
    first = (2**request.level - 1) / 2 * facts.pixel_um * 1e-3
    x = facts.x0_um * 1e-3 + first + (sum(request.cols) - 1) / 2 * pixel
    y = facts.y0_um * 1e-3 - first - (sum(request.rows) - 1) / 2 * pixel
    return scene.add_point_cloud(
        name, places, colours, point_size=pixel * 1.15, point_shape="square", point_shading="flat",
        precision="float16", position=(x, y, 0.0),
    )  # fmt: skip
