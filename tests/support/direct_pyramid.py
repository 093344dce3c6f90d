"""Levels of a pyramid computed directly from level 0, a pixel at a time, in float64."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap, Origin

GREY_PER_LEVEL = 0.5
"""Largest error of a grey value by the rounding of each level."""


def direct_level(surface: HeightMap, level: int) -> dict[str, NDArray]:
    """The layers of a level from 1 on: means of the measured pixels of level 0, their extremes, the best origins."""
    n = 2**level
    shape = tuple(-(-size // n) for size in surface.shape)
    means = ("z_um", "confidence", "z_raw_um", "all_in_focus", *(k for k in ("overlap_um", "u_um") if has(surface, k)))
    out = {name: np.full(shape, np.nan) for name in (*means, "z_min_um", "z_max_um", "origin")}
    for row, col in np.ndindex(shape):
        below = np.s_[row * n : (row + 1) * n, col * n : (col + 1) * n]
        origin = surface.origin[below]
        best = out["origin"][row, col] = origin.min()
        measured = surface.z_um[below][origin == Origin.MEASURED]
        counted = {"z_um": origin == best, "confidence": origin == best, "all_in_focus": origin != Origin.NOT_COVERED}
        for name in means:
            values = getattr(surface, name)[below].astype(float)[counted.get(name, np.s_[:])].ravel()
            out[name][row, col] = mean(values)
        if measured.size:
            out["z_min_um"][row, col], out["z_max_um"][row, col] = measured.min(), measured.max()
    for name in ("confidence", "all_in_focus"):
        out[name] = np.nan_to_num(out[name])
    return out


def has(surface: HeightMap, name: str) -> bool:
    return getattr(surface, name) is not None


def mean(values: NDArray) -> float:
    valid = values[np.isfinite(values)]
    return valid.mean() if valid.size else np.nan


def assert_level(layers: dict[str, NDArray], surface: HeightMap, level: int) -> None:
    """Compare layers of a level, as many as there are, with those computed directly."""
    for name, expected in direct_level(surface, level).items():
        if name in layers:
            tolerance = GREY_PER_LEVEL * level if name == "all_in_focus" else 1e-5
            np.testing.assert_allclose(layers[name], expected, rtol=0, atol=tolerance, err_msg=f"{name}, level {level}")


def with_gaps(surface: HeightMap, seed: int = 0) -> HeightMap:
    """The surface with gaps of all sizes: single pixels, blocks, filled parts, a corner that no field covers."""
    rng = np.random.default_rng(seed)
    rows, cols = surface.shape
    origin = rng.choice(
        np.array([Origin.MEASURED, Origin.FILLED, Origin.NO_TEXTURE, Origin.CLIPPED], np.uint8),
        surface.shape,
        p=(0.6, 0.1, 0.2, 0.1),
    )
    for _ in range(12):
        row, col, size = rng.integers(rows), rng.integers(cols), 2 ** int(rng.integers(1, 6))
        origin[row : row + size, col : col + size] = rng.choice([Origin.FILLED, Origin.NO_TEXTURE])
    origin[: rows // 4, : cols // 3] = Origin.NOT_COVERED
    valid, measured, covered = origin < 10, origin == Origin.MEASURED, origin != Origin.NOT_COVERED
    z = (surface.z_raw_um[0, 0] + rng.normal(0, 3, surface.shape)).astype(np.float32)
    nan = np.float32(np.nan)
    return dataclasses.replace(
        surface,
        z_um=np.where(valid, z, nan),
        z_raw_um=np.where(measured, z + np.float32(0.1), nan),
        confidence=np.where(covered, rng.random(surface.shape, np.float32), np.float32(0)),
        all_in_focus=np.where(covered, rng.integers(0, 255, surface.shape), 0).astype(surface.all_in_focus.dtype),
        origin=origin,
        overlap_um=np.where(measured & (rng.random(surface.shape) < 0.3), np.abs(z), nan).astype(np.float32),
        u_um=np.where(measured, np.float32(0.1) + rng.random(surface.shape, np.float32), nan),
    )  # fmt: skip
