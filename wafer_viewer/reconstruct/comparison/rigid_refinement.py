"""Refinement of a registration between two aligned surfaces: height, tilt, and a small shift and rotation.

A plane is first fitted to their differences; then point-to-plane ICP (Y. Chen, G. Medioni, Image Vis. Comput. 10 (1992)
145) by Open3D runs on a bounded sample of both, with Tukey's loss, so that changed areas do not count. Relief
determines x and y less well than images do, unless these are poor; each is weighted by its covariance.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import ComputeError, MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import Registration
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.numerics.grids.robust_plane import Plane, fit_plane
from wafer_viewer.reconstruct.comparison.resampled_surface import ResampledMosaic, SampleGrid

SAMPLE_PX = 256
"""Number of sample points along each side of the common region."""
LEAST_POINTS = 100
_BLOCK_PX = 16
_TUKEY = 4.685
_STEEPEST = 1.0
"""Slope above which a height is a wall, whose position depends more on the microscope than on the sample."""
_LEAST_U_PX = 0.1
"""Minimum lateral uncertainty of a sample point, because points are means of many pixels."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Sample:
    """Both surfaces at the same positions, as currently aligned; heights float32 [row, col], NaN unmeasured."""

    lattice: SampleGrid
    first_um: NDArray[np.float32]
    second_um: NDArray[np.float32]

    @property
    def difference_um(self) -> NDArray[np.float32]:
        """Second minus first."""
        return self.second_um - self.first_um


def levelled(first: Mosaic, second: Mosaic, registration: Registration, region: Region) -> Registration:
    """Return the registration with height and tilts estimated by a robust plane fit.

    region: common region. Raises MeasureError when too little is measured in both.
    """
    sample = _sample(ResampledMosaic(first, second, registration), region)
    return _on_plane(registration, sample, _plane(sample))


def settled(
    first: Mosaic, second: Mosaic, registration: Registration, covariance: Numbers, region: Region
) -> Registration:
    """Return the registration with height, tilts, shift and rotation refined by the relief.

    covariance: of (x_um, y_um, turn in rad) from the images. Raises MeasureError when too little is measured in both,
    ComputeError when Open3D cannot be loaded.
    """
    near = levelled(first, second, registration, region)
    sample = _sample(ResampledMosaic(first, second, near), region)
    motion, information = _icp(sample, _plane(sample), (near.about_x_um, near.about_y_um))
    prior = np.linalg.pinv(covariance, hermitian=True) if np.isfinite(covariance).all() else np.zeros((3, 3))
    both = np.linalg.pinv(information + prior, hermitian=True)
    x, y, turn = both @ information @ motion
    u = 2 * np.sqrt(np.diag(both))
    moved = replace(
        registration,
        x_um=registration.x_um + float(x),
        y_um=registration.y_um + float(y),
        turn_mrad=registration.turn_mrad + 1e3 * float(turn),
        u_xy_um=float(max(u[:2])),
        u_turn_mrad=float(1e3 * u[2]),
    )
    return levelled(first, second, moved, region)


def _sample(laid: ResampledMosaic, region: Region) -> _Sample:
    xa, ya, xb, yb = region.bounds_um
    side_px = max(xb - xa, yb - ya) / laid.first.pixel_um
    level = min(laid.first.levels - 1, max(0, int(np.ceil(np.log2(max(side_px, 1.0) / SAMPLE_PX)))))
    one = laid.first.window(region, level)
    other = laid.on(SampleGrid(one.pixel_um, one.x0_um, one.y0_um, one.shape))
    return _Sample(SampleGrid(one.pixel_um, one.x0_um, one.y0_um, one.shape), _heights(one), _heights(other))


def _heights(part: HeightMap) -> NDArray[np.float32]:
    return part.z_raw_um


def _plane(sample: _Sample) -> Plane:
    """Fit a robust plane to the differences. Raises MeasureError when there are too few."""
    n = int(np.isfinite(sample.difference_um).sum())
    found = fit_plane(sample.difference_um, _BLOCK_PX) if n >= LEAST_POINTS else None
    if found is None:
        raise MeasureError(
            f"Both surfaces are measured at {n} of the places looked at and at least {LEAST_POINTS} are needed: "
            "take surfaces of the same part of the sample."
        )
    return found


def _on_plane(registration: Registration, sample: _Sample, plane: Plane) -> Registration:
    """Subtract the plane of the differences from a registration."""
    pixel = sample.lattice.pixel_um
    x_um, y_um = sample.lattice.x0_um + plane.col0 * pixel, sample.lattice.y0_um - plane.row0 * pixel
    slope_x, slope_y = plane.slope_right / pixel, -plane.slope_down / pixel
    at_centre = plane.value + slope_x * (registration.about_x_um - x_um) + slope_y * (registration.about_y_um - y_um)
    spread = np.linalg.pinv(plane.information, hermitian=True)
    return replace(
        registration,
        z_um=float(registration.z_um - at_centre),
        tilt_x_mrad=registration.tilt_x_mrad - float(1e3 * slope_x),
        tilt_y_mrad=registration.tilt_y_mrad - float(1e3 * slope_y),
        u_z_um=2 * float(np.sqrt(spread[0, 0])),
        u_tilt_mrad=2e3 / pixel * float(np.sqrt(max(spread[1, 1], spread[2, 2]))),
        levelled=True,
        residual_um=plane.rms,
    )


def _icp(sample: _Sample, plane: Plane, about_um: tuple[float, float]) -> tuple[Numbers, Numbers]:
    """Return the motion (x, y, turn) of the second estimated from its relief, and its inverse covariance."""
    target, source, normals = _points(sample, about_um)
    if len(target) < LEAST_POINTS:
        return np.zeros(3), np.zeros((3, 3))
    registration = _open3d().pipelines.registration
    sigma = max(plane.rms, 1e-4)
    estimation = registration.TransformationEstimationPointToPlane(registration.TukeyLoss(k=_TUKEY * sigma))
    reach_um = float(np.hypot(sample.lattice.pixel_um, 2 * _TUKEY * sigma))
    found = registration.registration_icp(
        _cloud(source), _cloud(target, normals), reach_um, np.eye(4), estimation
    ).transformation
    motion = np.array([found[0, 3], found[1, 3], found[1, 0]])
    if not (np.isfinite(motion).all() and np.hypot(*motion[:2]) < sample.lattice.pixel_um):
        return np.zeros(3), np.zeros((3, 3))
    return motion, _information(target, normals, source, plane, sample.lattice.pixel_um)


def _points(sample: _Sample, about_um: tuple[float, float]) -> tuple[Numbers, Numbers, Numbers]:
    """Return points of both, [n, 3] in um from the centre, and normals of the first, without walls and edges."""
    down, right = (np.asarray(d, np.float64) for d in np.gradient(sample.first_um, sample.lattice.pixel_um))
    there = np.isfinite(down + right + sample.second_um) & (np.hypot(down, right) < _STEEPEST)
    rows, cols = np.nonzero(there)
    x = sample.lattice.x0_um + cols * sample.lattice.pixel_um - about_um[0]
    y = sample.lattice.y0_um - rows * sample.lattice.pixel_um - about_um[1]
    normals = np.stack([-right[there], down[there], np.ones(len(rows))], axis=1).astype(np.float64)
    normals /= np.sqrt((normals**2).sum(axis=1, keepdims=True))
    target, source = (_xyz(x, y, z[there]) for z in (sample.first_um, sample.second_um))
    return target, source, normals


def _xyz(x_um: Any, y_um: Any, z_um: NDArray[np.float32]) -> Numbers:
    return np.stack([x_um, y_um, z_um], axis=1).astype(np.float64)


def _information(target: Numbers, normals: Numbers, source: Numbers, plane: Plane, pixel_um: float) -> Numbers:
    """Return the inverse covariance of (x, y, turn), with height and tilts marginalised."""
    x, y = target[:, 0], target[:, 1]
    nx, ny, nz = normals.T
    design = np.stack([nx, ny, x * ny - y * nx, nz, x * nz, y * nz], axis=1)
    design = design[np.abs(((source - target) * normals).sum(axis=1)) < _TUKEY * max(plane.rms, 1e-4)]
    alike = max(1.0, plane.n_pixels / max(plane.rms, 1e-4) ** 2 / max(float(plane.information[0, 0]), 1e-30))
    full = design.T @ design / (max(plane.rms, 1e-4) ** 2 * alike)
    free = full[:3, :3] - full[:3, 3:] @ np.linalg.pinv(full[3:, 3:], hermitian=True) @ full[3:, :3]
    reach_um = max(float(np.hypot(x, y).max()), pixel_um)
    floor = np.diag([1.0, 1.0, 1 / reach_um**2]) * (_LEAST_U_PX * pixel_um) ** 2
    return np.asarray(np.linalg.pinv(np.linalg.pinv(free, hermitian=True) + floor, hermitian=True), np.float64)


def _cloud(points: Numbers, normals: Numbers | None = None) -> Any:
    open3d = _open3d()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    if normals is not None:
        cloud.normals = open3d.utility.Vector3dVector(normals)
    return cloud


def _open3d() -> Any:
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as fault:
        raise ComputeError(f"Open3D cannot be loaded ({fault}): `wafer-viewer doctor` says what it lacks.") from fault
