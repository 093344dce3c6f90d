"""A surface read on a lattice of its own: as smooth as it is, however it is turned, and unknown where it is unknown."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.numerics.grids.die_cell_kernels import fill_single_pixels, read_affine, subtract_products

ROWS, COLS = np.mgrid[:90, :120].astype(np.float32)
WAYS = {
    "moved": (20.3, 1.0, 0.0, 25.8, 0.0, 1.0),
    "turned": (20.3, 0.9998, 0.02, 25.8, -0.02, 0.9998),
    "turned the other way": (22.0, 0.9998, -0.02, 24.0, 0.02, 0.9998),
    "finer": (20.0, 0.5, 0.0, 30.25, 0.0, 0.5),
    "coarser": (10.0, 1.5, 0.0, 10.0, 0.0, 1.3),
    "mirrored": (20.0, 1.0, 0.0, 100.4, 0.0, -1.0),
}


def bent(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """What a bicubic gives back exactly: bent as a parabola along either axis."""
    return 0.01 * rows**2 - 0.3 * rows + 0.02 * cols**2 + 0.001 * rows * cols


def read(plane: np.ndarray, direction: tuple[float, ...], shape: tuple[int, int] = (40, 60)) -> np.ndarray:
    out = np.empty(shape, np.float32)
    read_affine(plane.astype(np.float32), fill_single_pixels(plane.astype(np.float32)), np.array(direction), out)
    return out


def places(direction: tuple[float, ...], shape: tuple[int, int] = (40, 60)) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.mgrid[: shape[0], : shape[1]]
    return direction[0] + direction[1] * i + direction[2] * j, direction[3] + direction[4] * i + direction[5] * j


@pytest.mark.parametrize("direction", WAYS.values(), ids=WAYS)
def test_a_bent_surface_is_read_between_its_pixels(direction: tuple[float, ...]) -> None:
    np.testing.assert_allclose(read(bent(ROWS, COLS), direction), bent(*places(direction)), atol=2e-4)


def test_products_of_rows_and_columns_are_taken_off() -> None:
    out, plane = np.empty(ROWS.shape, np.float32), bent(ROWS, COLS).astype(np.float32)
    r, c = np.arange(90.0), np.arange(120.0)
    subtract_products(plane, np.stack([r**0, r, r**2]), np.stack([0.02 * c**2, 0.001 * c - 0.3, 0.01 * c**0]), out)
    assert np.abs(out).max() < 1e-4


@pytest.mark.parametrize("direction", WAYS.values(), ids=WAYS)
def test_what_has_no_pixel_next_to_it_is_unknown_and_no_more(direction: tuple[float, ...]) -> None:
    plane = bent(ROWS, COLS)
    plane[40:50, 45:60] = np.nan
    rows, cols = places(direction)
    hole = np.isnan(plane[np.floor(rows + 0.5).astype(int), np.floor(cols + 0.5).astype(int)])
    found = read(plane, direction)
    assert hole.any()
    assert np.isnan(found[hole]).all()
    rim = np.isnan(found) & ~hole
    assert not (rim & ((np.abs(rows - 44.5) > 6) | (np.abs(cols - 52) > 8.5))).any()
    np.testing.assert_allclose(found[~hole & ~rim], bent(rows, cols)[~hole & ~rim], atol=0.5)


def test_a_lost_pixel_takes_no_others_with_it() -> None:
    plane = bent(ROWS, COLS)
    plane[40, 50] = np.nan
    assert np.isnan(read(plane, WAYS["moved"])).sum() == 1


def test_beyond_the_surface_nothing_is_known_and_its_border_is() -> None:
    found = read(bent(ROWS, COLS), (-2.5, 1.0, 0.0, 117.5, 0.0, 1.0), (6, 6))
    assert np.isfinite(found).tolist() == [[r >= 3 and c <= 1 for c in range(6)] for r in range(6)]
