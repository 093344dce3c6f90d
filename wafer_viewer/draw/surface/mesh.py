"""Triangle meshes of a height map: surface with holes, walls of its block, flat images.

Scene coordinates are mm; z is the height above a reference, in mm too: the scene scales it by the exaggeration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """vertices: float32 [n, 3] in mm; uv: float32 [n, 2] in 0 ... 1, v downwards; triangles: uint32 [m, 3]."""

    vertices: Floats
    uv: Floats
    triangles: NDArray[np.uint32]


Skirts = tuple[bool, bool, bool, bool]
"""Whether a surface has a skirt at its bottom, top, left and right edge."""
NO_SKIRTS: Skirts = (False, False, False, False)
_SKIRT_STEPS = 4
"""Half width, in vertices, of the window along an edge that sets the depth of a skirt."""
_STEEP = 1.5
"""Rise over run above which a partly measured cell is a wall, not a slope."""


def picked(n: int, step: int) -> NDArray[np.intp]:
    """Return every step-th index of n, and the last."""
    return np.unique(np.append(np.arange(0, n, step), n - 1))


def surface(
    z_um: Floats,
    there: NDArray[np.bool_],
    x_mm: Floats,
    y_mm: Floats,
    z0_um: float,
    step: int,
    skirts: Skirts = NO_SKIRTS,
) -> Mesh:
    """Return a surface of heights without gaps, a vertex every `step` pixels; cells without a valid pixel are omitted.

    Steep cells that are only partly measured are omitted too, as they would show as ragged fragments. x_mm [col], y_mm
    [row] are the pixel positions; the texture covers the same pixels, edge to edge. Skirts extend to the lowest height
    nearby, so that no cracks show next to a tile with other vertices.
    """
    rows, cols = picked(len(y_mm), step), picked(len(x_mm), step)
    grid_y, grid_x = np.meshgrid(y_mm[rows], x_mm[cols], indexing="ij")
    height = (z_um[np.ix_(rows, cols)] - np.float32(z0_um)) * np.float32(1e-3)
    v, u = np.meshgrid((rows + 0.5) / len(y_mm), (cols + 0.5) / len(x_mm), indexing="ij")
    kept = _cells(there, rows, cols, np.logical_or)
    ragged = kept & ~(_cells(there, rows, cols, np.logical_and) & _corners(there[np.ix_(rows, cols)]).all(axis=0))
    kept &= ~(ragged & (_rise(height) > _STEEP * step * abs(float(x_mm[-1] - x_mm[0])) / max(1, len(x_mm) - 1)))
    whole = Mesh(
        np.stack([grid_x, grid_y, height], axis=-1).reshape(-1, 3).astype(np.float32),
        np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32),
        quads(len(rows), len(cols))[kept.ravel()].reshape(-1, 3),
    )
    return _joined([whole, *_skirts(whole, height, kept, skirts)])


def _skirts(of: Mesh, height: Floats, kept: NDArray[np.bool_], skirts: Skirts) -> list[Mesh]:
    """Return a skirt for each requested edge, along the cells that are kept."""
    index = np.arange(height.size).reshape(height.shape)
    edges = (index[-1], kept[-1]), (index[0], kept[0]), (index[:, 0], kept[:, 0]), (index[:, -1], kept[:, -1])
    return [_skirt(of, line, there) for wanted, (line, there) in zip(skirts, edges, strict=True) if wanted]


def _skirt(of: Mesh, line: NDArray[np.intp], there: NDArray[np.bool_]) -> Mesh:
    top, width = of.vertices[line], 2 * _SKIRT_STEPS + 1
    around = np.lib.stride_tricks.sliding_window_view(np.pad(top[:, 2], _SKIRT_STEPS, mode="edge"), width)
    spacing = float(np.hypot(*(top[-1, :2] - top[0, :2]))) / max(1, len(line) - 1)
    foot = np.column_stack([top[:, :2], around.min(axis=1) - 0.1 * spacing])
    return Mesh(
        np.concatenate([top, foot]).astype(np.float32),
        np.concatenate([of.uv[line]] * 2),
        quads(2, len(line))[there].reshape(-1, 3),
    )


def _joined(parts: list[Mesh]) -> Mesh:
    """Merge several meshes into one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.triangles + np.uint32(start) for part, start in zip(parts, starts, strict=True)]),
    )


def _cells(
    there: NDArray[np.bool_], rows: NDArray[np.intp], cols: NDArray[np.intp], how: np.ufunc
) -> NDArray[np.bool_]:
    """Return for each cell between picked rows and columns whether any or every pixel in it is valid.

    how: logical_or for any, logical_and for every.
    """
    by_row = how.reduceat(there, rows[:-1], axis=0)
    return how.reduceat(by_row, cols[:-1], axis=1)


def _rise(height: Floats) -> Floats:
    """Return the largest difference between the four corners of each cell."""
    return np.ptp(_corners(height), axis=0)


def _corners(lattice: NDArray[Any]) -> NDArray[Any]:
    """Return the values at the four corners of each cell, [4, row, col]."""
    return np.stack([lattice[:-1, :-1], lattice[:-1, 1:], lattice[1:, :-1], lattice[1:, 1:]])


def quads(rows: int, cols: int) -> NDArray[np.uint32]:
    """Return the two triangles of each cell of a vertex lattice, uint32 [cell, 2, 3], anticlockwise from above."""
    i = np.arange(rows * cols, dtype=np.uint32).reshape(rows, cols)
    a, b, c, d = i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]
    return np.stack([a, d, c, a, c, b], axis=-1).reshape(-1, 2, 3)


def flat(x0_mm: float, y0_mm: float, x1_mm: float, y1_mm: float, z_mm: float = 0.0) -> Mesh:
    """Return one horizontal rectangle at z, with the top edge of the image at y1 (the larger)."""
    corners = [(x0_mm, y1_mm), (x1_mm, y1_mm), (x1_mm, y0_mm), (x0_mm, y0_mm)]
    return Mesh(
        np.array([(x, y, z_mm) for x, y in corners], np.float32),
        np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32),
        np.array([(0, 3, 2), (0, 2, 1)], np.uint32),
    )


def plates(boxes_mm: NDArray[np.float64], z_mm: NDArray[np.float64], uv: Floats) -> Mesh:
    """Return horizontal rectangles, each at its own height: boxes [n, 4] as x low, y low, x high, y high, z [n].

    uv [n, 4]: part of the image for each, as u0, v0, u1, v1 with v downwards.
    """
    (x0, y0, x1, y1), (u0, v0, u1, v1) = boxes_mm.T, uv.T
    corners = [np.stack([x, y, z_mm], axis=1) for x, y in ((x0, y1), (x1, y1), (x1, y0), (x0, y0))]
    places = [np.stack([u, v], axis=1) for u, v in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))]
    one = np.array([(0, 3, 2), (0, 2, 1)], np.uint32)
    return Mesh(
        np.stack(corners, axis=1).reshape(-1, 3).astype(np.float32),
        np.stack(places, axis=1).reshape(-1, 2).astype(np.float32),
        (one + 4 * np.arange(len(boxes_mm), dtype=np.uint32)[:, None, None]).reshape(-1, 3),
    )


WALL_SIDES = 4


def walls(edges: dict[int, tuple[Floats, Floats, Floats]], base_mm: float) -> Mesh:
    """Return walls down from the edges of a block: each edge as x_mm, y_mm, z_mm [n]; NaN in z omits the wall.

    u identifies the edge, (its key + 0.5) / `WALL_SIDES`; v runs from the top (0) to the base (1).
    """
    return _joined([_wall(x, y, z, base_mm, (k + 0.5) / WALL_SIDES) for k, (x, y, z) in edges.items()])


def _wall(x: Floats, y: Floats, z: Floats, base_mm: float, u: float) -> Mesh:
    there = np.isfinite(z)
    top = np.stack([x, y, np.where(there, z, base_mm)], axis=1)
    foot = np.stack([x, y, np.full(len(x), base_mm)], axis=1)
    v = np.repeat([0.0, 1.0], len(x))
    kept = there[:-1] & there[1:]
    return Mesh(
        np.concatenate([top, foot]).astype(np.float32),
        np.stack([np.full(2 * len(x), u), v], axis=1).astype(np.float32),
        quads(2, len(x))[kept].reshape(-1, 3),
    )
