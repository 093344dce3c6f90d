"""Selection of pyramid tiles for a camera: its view frustum, and a quadtree split where texels are large.

The leaves always cover the entire surface, so that turning the camera never shows holes. Leaves out of view are drafts.
Levels below 0 are finer meshes of the pixels of level 0, for close views.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

# -------------------------------------------------------------------------------------------------------------- frustum


Triple = tuple[float, float, float]
_WIDER = 1.06
"""Widening factor of the view: a small turn of the camera then shows no coarse tiles at its edge."""


@dataclass(frozen=True, slots=True)
class AABB:
    """Axis-aligned box in scene mm."""

    low: Triple
    high: Triple


@dataclass(frozen=True, slots=True)
class Frustum:
    """Frustum of a camera at `eye` looking along `ahead`.

    sides: inward normals of the four side planes through the eye.
    focal_px: height in pixels of an object 1 mm high at a distance of 1 mm.
    """

    eye: Triple
    ahead: Triple
    sides: tuple[Triple, ...]
    focal_px: float

    @classmethod
    def of(cls, eye: Triple, look_at: Triple, up: Triple, fov_rad: float, width_px: int, height_px: int) -> Frustum:
        """Return the frustum of a camera; fov_rad is the vertical field of view."""
        ahead = _unit(_minus(look_at, eye))
        right = _unit(_cross(ahead, up))
        above = _cross(right, ahead)
        tall = math.tan(fov_rad / 2)
        wide = tall * width_px / max(1, height_px)
        sides = tuple(
            _sum(axis, ahead, _WIDER * slope)
            for axis, slope in ((right, wide), (_turned(right), wide), (above, tall), (_turned(above), tall))
        )
        return cls(eye, ahead, sides, max(1, height_px) / 2 / tall)

    def sees(self, box: AABB) -> bool:
        """Return whether any part of a box may be in view."""
        return all(self._reach(side, box) >= 0 for side in (*self.sides, self.ahead))

    def px_per_mm(self, box: AABB) -> float:
        """Return the pixels per millimetre at the nearest point of a box."""
        away = [
            max(low - coordinate, 0.0, coordinate - high)
            for low, coordinate, high in zip(box.low, self.eye, box.high, strict=True)
        ]
        return self.focal_px / max(math.hypot(*away), 1e-6)

    def aside(self, box: AABB) -> float:
        """Return the angular offset of a box centre from the view axis, as a slope; infinite behind the camera."""
        off = _minus(_middle(box), self.eye)
        ahead = _dot(off, self.ahead)
        return math.sqrt(max(0.0, _dot(off, off) - ahead * ahead)) / ahead if ahead > 0 else math.inf

    def ground_um(self, z_mm: float) -> tuple[tuple[float, float], ...] | None:
        """Return the intersections of the four view corners with a level plane, in um; None if any of them misses."""
        right, left, above, below = self.sides
        corners = [_cross(a, b) for a, b in ((left, above), (above, right), (right, below), (below, left))]
        rays = [ray if _dot(ray, self.ahead) > 0 else _turned(ray) for ray in corners]
        times = [(z_mm - self.eye[2]) / ray[2] if ray[2] else -1.0 for ray in rays]
        if min(times) <= 0:
            return None
        met = [_sum(self.eye, ray, t) for ray, t in zip(rays, times, strict=True)]
        return tuple((x * 1e3, y * 1e3) for x, y, _ in met)

    def _reach(self, normal: Triple, box: AABB) -> float:
        """Return the largest extent of a box on the inner side of a plane through the eye."""
        return sum(
            n * ((high if n > 0 else low) - coordinate)
            for n, low, high, coordinate in zip(normal, box.low, box.high, self.eye, strict=True)
        )


def _middle(box: AABB) -> Triple:
    (x0, y0, z0), (x1, y1, z1) = box.low, box.high
    return (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2


def _minus(a: Triple, b: Triple) -> Triple:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _sum(a: Triple, b: Triple, times: float) -> Triple:
    return a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2]


def _turned(a: Triple) -> Triple:
    return -a[0], -a[1], -a[2]


def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Triple, b: Triple) -> Triple:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _unit(a: Triple) -> Triple:
    length = math.sqrt(_dot(a, a))
    return (a[0] / length, a[1] / length, a[2] / length) if length > 0 else (1.0, 0.0, 0.0)


# ------------------------------------------------------------------------------------------------------------- quadtree


TILE_PX = 256
FINEST_LEVEL = -3
DRAFT_LEVELS = 2
"""Number of levels by which a tile out of view is coarser."""
MOST_ROOTS = 6
Span = tuple[int, int]
"""[first, end) of rows or columns."""
Heights = Callable[[Span, Span], tuple[float, float]]
"""Returns the lowest and highest height, scene mm, of rows and columns of level 0."""


@dataclass(frozen=True, slots=True)
class Node:
    """A square tile of `TILE_PX` pixels at a level, by its tile row and column."""

    level: int
    row: int
    col: int

    @property
    def side_px(self) -> int:
        """Side length in pixels of level 0."""
        return TILE_PX << self.level if self.level >= 0 else TILE_PX >> -self.level

    @property
    def spans(self) -> tuple[Span, Span]:
        """Rows and columns of level 0."""
        side = self.side_px
        return (self.row * side, (self.row + 1) * side), (self.col * side, (self.col + 1) * side)

    @property
    def quarters(self) -> Iterator[Node]:
        """The four child nodes at the next finer level."""
        return (Node(self.level - 1, 2 * self.row + n // 2, 2 * self.col + n % 2) for n in range(4))


@dataclass(frozen=True, slots=True)
class Leaf:
    """A node to be drawn; `in_view`: True if in view, drawn at full resolution."""

    node: Node
    in_view: bool


@dataclass(frozen=True, slots=True)
class Ground:
    """Geometry of a surface: window of level 0, corner of pixel (0, 0) and heights.

    x0_mm, y0_mm: outer corner of pixel (0, 0) in mm.
    """

    rows: Span
    cols: Span
    x0_mm: float
    y0_mm: float
    pixel_mm: float
    heights_mm: Heights

    def holds(self, node: Node) -> bool:
        """Return whether the window overlaps a node."""
        rows, cols = node.spans
        return _meet(rows, self.rows) and _meet(cols, self.cols)

    def box(self, node: Node) -> AABB:
        """Return the bounding box of the window's part within a node, with its heights."""
        rows, cols = (_common(*spans) for spans in zip(node.spans, (self.rows, self.cols), strict=True))
        low, high = self.heights_mm(rows, cols)
        x, y = ([self.x0_mm + c * self.pixel_mm for c in cols], [self.y0_mm - r * self.pixel_mm for r in rows])
        return AABB((x[0], y[1], low), (x[1], y[0], high))

    def texel_px(self, node: Node, box: AABB, sight: Frustum) -> float:
        """Return the maximum screen size of a pixel at the node's level."""
        return self.pixel_mm * node.side_px / TILE_PX * sight.px_per_mm(box)


def roots(ground: Ground) -> list[Node]:
    """Return the nodes of the finest level at which at most `MOST_ROOTS` nodes cover the window."""
    level = 0
    while True:
        side = TILE_PX << level
        rows, cols = (range(first // side, -(-end // side)) for first, end in (ground.rows, ground.cols))
        if len(rows) * len(cols) <= MOST_ROOTS:
            return [Node(level, row, col) for row in rows for col in cols]
        level += 1


def leaves(ground: Ground, sight: Frustum, sharp_px: float, most: int) -> list[Leaf]:
    """Return the nodes to draw, those in the centre of the view first.

    Visible nodes are split until no texel exceeds `sharp_px` or `most` tiles are reached. The largest texels are split
    first, so that a tile limit reduces the resolution evenly.
    """
    heap, unseen = list[tuple[float, int, Node]](), list[Node]()
    settled = list[Node]()
    number = 0

    def sort_in(node: Node) -> None:
        nonlocal number
        box = ground.box(node)
        if not sight.sees(box):
            unseen.append(node)
            return
        number += 1
        heapq.heappush(heap, (-ground.texel_px(node, box, sight), number, node))

    for node in roots(ground):
        sort_in(node)
    while heap and -heap[0][0] > sharp_px and len(heap) + len(settled) + 3 <= most:
        node = heapq.heappop(heap)[2]
        if node.level == FINEST_LEVEL:
            settled.append(node)
            continue
        for quarter in node.quarters:
            if ground.holds(quarter):
                sort_in(quarter)
    visible = sorted([*settled, *(node for _, _, node in heap)], key=lambda node: sight.aside(ground.box(node)))
    unseen.sort(key=lambda node: -node.level)
    return [*(Leaf(node, True) for node in visible), *(Leaf(node, False) for node in unseen)]


def _meet(a: Span, b: Span) -> bool:
    return a[0] < b[1] and b[0] < a[1]


def _common(a: Span, b: Span) -> Span:
    return max(a[0], b[0]), min(a[1], b[1])
