"""Which tiles a camera needs: they cover the surface at any time, and are as fine as the screen can show."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.gui.scene.quadtree import AABB, FINEST_LEVEL, MOST_ROOTS, Frustum, Ground, leaves, roots

PIXEL_MM = 0.5e-3
SCREEN = 900, 800
MOST, SHARP_PX = 40, 1.3
CAMERAS = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(0.02, 20.0), st.floats(-1.3, 1.3))


def ground(rows: int, cols: int, first: int = 0) -> Ground:
    middle = (first + cols / 2) * PIXEL_MM, (first + rows / 2) * PIXEL_MM
    return Ground(
        (first, first + rows), (first, first + cols), -middle[0], middle[1], PIXEL_MM, lambda rows, cols: (0.0, 0.01)
    )


def sight(right: float, back: float, away_mm: float, slant: float, size_mm: float = 6.0) -> Frustum:
    look_at = right * size_mm, back * size_mm, 0.0
    eye = look_at[0], look_at[1] - away_mm * math.sin(slant), away_mm * math.cos(slant)
    return Frustum.of(eye, look_at, (0.0, 1.0, 0.0), 0.5, *SCREEN)


@given(CAMERAS, st.integers(100, 13_000), st.integers(100, 13_000), st.integers(0, 3000))
def test_leaves_cover_all_of_the_surface_and_nothing_twice(
    camera: tuple[float, float, float, float], rows: int, cols: int, first: int
) -> None:
    over = ground(rows, cols, first)
    result = leaves(over, sight(*camera), SHARP_PX, MOST)
    squares = [leaf.node.spans for leaf in result]
    inside = sum(
        (min(r[1], over.rows[1]) - max(r[0], over.rows[0])) * (min(c[1], over.cols[1]) - max(c[0], over.cols[0]))
        for r, c in squares
    )
    assert inside == rows * cols
    assert len(set(squares)) == len(squares)
    assert sum(leaf.in_view for leaf in result) <= MOST


@given(CAMERAS)
def test_what_is_in_sight_is_sharp_as_far_as_tiles_go(camera: tuple[float, float, float, float]) -> None:
    over, seen_from = ground(12_850, 12_850), sight(*camera)
    result = [leaf.node for leaf in leaves(over, seen_from, SHARP_PX, MOST) if leaf.in_view]
    coarse = [n for n in result if over.texel_px(n, over.box(n), seen_from) > SHARP_PX and n.level > FINEST_LEVEL]
    assert not coarse or len(result) > MOST - 4


def test_cost_does_not_grow_with_the_surface() -> None:
    near = sight(0.01, 0.02, 0.4, 0.7, 1.0)
    counts = [len(leaves(ground(side, side), near, SHARP_PX, MOST)) for side in (6_633, 12_850, 51_400)]
    assert counts[2] < counts[0] + 40


def test_roots_are_few() -> None:
    for side in (1, 300, 12_850, 200_000):
        assert 1 <= len(roots(ground(side, side))) <= MOST_ROOTS


@given(CAMERAS, st.floats(-3, 3), st.floats(-3, 3), st.floats(-0.5, 0.5))
def test_a_camera_sees_every_box_round_a_point_on_its_screen(
    camera: tuple[float, float, float, float], x: float, y: float, z: float
) -> None:
    seen_from = sight(*camera)
    off = np.array([x, y, z]) - seen_from.eye
    ahead = float(off @ seen_from.ahead)
    tall = SCREEN[1] / 2 / seen_from.focal_px
    up = np.cross(np.cross(seen_from.ahead, (0.0, 1.0, 0.0)), seen_from.ahead)
    above = abs(off @ up / np.linalg.norm(up)) if np.linalg.norm(up) > 0 else math.inf
    wide = math.sqrt(max(0.0, off @ off - ahead**2 - above**2))
    if ahead > 1e-6 and above < tall * ahead and wide < tall * ahead * SCREEN[0] / SCREEN[1]:
        assert seen_from.sees(AABB((x - 0.01, y - 0.01, z - 0.01), (x + 0.01, y + 0.01, z + 0.01)))


def test_the_part_of_the_ground_in_view_is_as_large_as_the_screen_shows() -> None:
    corners = sight(0.0, 0.0, 2.0, 0.0).ground_um(0.0)
    assert corners is not None
    width, height = np.ptp(np.array(corners), axis=0)
    assert abs(height / (2e3 * 2 * math.tan(0.25) * 1.06) - 1) < 1e-6
    assert abs(width / height - SCREEN[0] / SCREEN[1]) < 1e-6
    assert sight(0.0, 0.0, 2.0, 1.4).ground_um(0.0) is None
