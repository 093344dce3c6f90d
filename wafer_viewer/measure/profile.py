"""A section along a line: the curve, and the two heights people read off it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.level import Values
from wafer_viewer.measure.step import length_of
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import Contribution, Length, Profile, ProfileCurve
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import HeightMap, Mosaic

MOST_POINTS = 20_000


def profile(
    surface: Mosaic, line: Region, *, calibration_valid: bool = True, count_filled: bool = False
) -> tuple[Profile, ProfileCurve]:
    """The heights along a line, sampled once a pixel and averaged over the line's width.

    A point is read bilinearly between measured pixels and is NaN where one of them is unmeasured. Long lines are read
    from a coarser level of the surface. U of the heights counts the z scale and the repeatability of neighbouring
    points. Raises MeasureError when the line is shorter than a pixel, leaves the surface, or meets nothing measured.
    """
    level = _level_for(surface, line)
    window = surface.window(_grown(line, surface.pixel_um * 2**level), level)
    curve = _sample(window, line, window.to_measure(count_filled))
    good = np.isfinite(curve.z_um)
    if not good.any():
        raise MeasureError("Nothing is measured along this line: move it to where the surface is measured.")
    z = curve.z_um[good]
    provenance = surface.provenance
    noise_um = _repeatability_um(curve.z_um)
    scale = 0.0 if provenance.calibration is None else provenance.calibration.u_z_scale

    def length(value_um: float) -> Length:
        budget = (
            Contribution(name="repeatability of two points", u_um=noise_um * math.sqrt(2)),
            Contribution(name="z scale", u_um=abs(value_um) * scale),
        )
        return length_of(value_um, budget, provenance, calibration_valid)

    found = Profile(
        line=line,
        length_um=float(curve.distance_um[-1]),
        pt=length(float(z.max() - z.min())),
        rise=length(float(z[-1] - z[0])),
        measured_fraction=float(good.mean()),
        surface="filled" if count_filled else provenance.recipe.measure_on,
        simulated=provenance.simulated,
        notes=(f"read from level {level} of the surface",) if level else (),
    )
    return found, curve


def _level_for(surface: Mosaic, line: Region) -> int:
    pixels = _length_um(line) / surface.pixel_um
    if line.kind != "line" or pixels < 1:
        raise MeasureError(f"A profile needs a line of at least one pixel ({surface.pixel_um:g} um): draw it longer.")
    return int(np.clip(np.ceil(np.log2(max(1.0, pixels / MOST_POINTS))), 0, surface.levels - 1))


def _length_um(line: Region) -> float:
    a, b = line.points[0], line.points[-1]
    return float(np.hypot(b.x_um - a.x_um, b.y_um - a.y_um))


def _grown(line: Region, margin_um: float) -> Region:
    x0, y0, x1, y1 = line.bounds_um
    return Region.rectangle(x0 - margin_um, y0 - margin_um, x1 + margin_um, y1 + margin_um)


def _sample(window: HeightMap, line: Region, z_um: NDArray[np.float32]) -> ProfileCurve:
    a, b = line.points
    n = max(2, round(_length_um(line) / window.pixel_um) + 1)
    t = np.linspace(0.0, 1.0, n)
    x, y = a.x_um + (b.x_um - a.x_um) * t, a.y_um + (b.y_um - a.y_um) * t
    across = _across(line, window.pixel_um)
    nx, ny = -(b.y_um - a.y_um) / _length_um(line), (b.x_um - a.x_um) / _length_um(line)
    lanes = np.stack([_bilinear(window, z_um, x + nx * d, y + ny * d) for d in across])
    counts = np.isfinite(lanes).sum(axis=0)
    z = np.where(counts > 0, np.nansum(lanes, axis=0) / np.maximum(counts, 1), np.nan)
    return ProfileCurve(distance_um=t * _length_um(line), z_um=z, x_um=x, y_um=y)


def _across(line: Region, pixel_um: float) -> Values:
    """Offsets of the lanes that are averaged, a pixel apart, symmetric about the line."""
    lanes = max(1, round(line.width_um / pixel_um))
    return (np.arange(lanes, dtype=np.float64) - (lanes - 1) / 2) * pixel_um


def _bilinear(window: HeightMap, z_um: NDArray[np.float32], x_um: Values, y_um: Values) -> Values:
    """Heights at points; NaN outside and wherever a pixel that weighs in is unmeasured."""
    col, row = (x_um - window.x0_um) / window.pixel_um, (window.y0_um - y_um) / window.pixel_um
    c0, r0 = np.floor(col + 1e-6).astype(int), np.floor(row + 1e-6).astype(int)
    fc, fr = np.clip(col - c0, 0, 1), np.clip(row - r0, 0, 1)
    total = np.zeros(len(x_um))
    for dr, dc in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = (fr if dr else 1 - fr) * (fc if dc else 1 - fc)
        weight = np.where(weight < 1e-6, 0.0, weight)
        total += np.where(weight > 0, weight * _pixel(z_um, r0 + dr, c0 + dc), 0.0)
    return total


def _pixel(z_um: NDArray[np.float32], row: NDArray[np.int64], col: NDArray[np.int64]) -> Values:
    rows, cols = z_um.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    values = z_um[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)].astype(float)
    return np.where(inside, values, np.nan)


def _repeatability_um(z_um: Values) -> float:
    """Spread of a point against its neighbours, robust to steps: MAD of second differences, which weigh 1, -2, 1."""
    second = np.diff(z_um, 2)
    second = second[np.isfinite(second)]
    return 0.0 if second.size == 0 else float(1.4826 * np.median(np.abs(second)) / np.sqrt(6))
