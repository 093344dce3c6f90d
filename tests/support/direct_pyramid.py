"""Levels of a pyramid computed directly from level 0 in float64, each level by itself."""

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
    means = ("z_um", "confidence", "z_raw_um", "all_in_focus", *(k for k in ("overlap_um", "u_um") if has(surface, k)))
    origin = blocks(surface.origin, n)
    best = np.nanmin(origin, axis=-1, keepdims=True)
    counted = {"z_um": origin == best, "confidence": origin == best, "all_in_focus": origin != Origin.NOT_COVERED}
    out = {name: mean(blocks(getattr(surface, name), n), counted.get(name)) for name in means}
    for name in ("confidence", "all_in_focus"):
        out[name] = np.nan_to_num(out[name])
    measured, z_um = origin == Origin.MEASURED, blocks(surface.z_um, n)
    for name, extreme, far in (("z_min_um", np.min, np.inf), ("z_max_um", np.max, -np.inf)):
        found = extreme(np.where(measured, z_um, far), axis=-1)
        out[name] = np.where(measured.any(axis=-1), found, np.nan)
    return {**out, "origin": best[..., 0]}


def blocks(layer: NDArray, n: int) -> NDArray[np.float64]:
    """The n x n pixels below each pixel of a coarser level, along the last axis: NaN beyond the border."""
    rows, cols = (-(-size // n) for size in layer.shape)
    padded = np.full((rows * n, cols * n), np.nan)
    padded[: layer.shape[0], : layer.shape[1]] = layer
    return padded.reshape(rows, n, cols, n).swapaxes(1, 2).reshape(rows, cols, n * n)


def has(surface: HeightMap, name: str) -> bool:
    return getattr(surface, name) is not None


def mean(values: NDArray, counted: NDArray[np.bool_] | None = None) -> NDArray:
    """The mean of the finite values along the last axis, of those that count: NaN of none."""
    valid = np.isfinite(values) if counted is None else np.isfinite(values) & counted
    numbers = valid.sum(axis=-1)
    total = np.where(valid, values, 0.0).sum(axis=-1)
    return np.divide(total, numbers, out=np.full(total.shape, np.nan), where=numbers > 0)


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
