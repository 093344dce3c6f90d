"""Registration of two surfaces: shift and rotation from their images, then height, tilt and a small shift.

At each resolution a few patches of the first are searched for on the second, in the same way as fields are stitched. A
rigid motion is fitted to the accepted patches, and the next resolution starts from it. The number of patches does not
grow with the surfaces.

A plane is first fitted to their differences; then point-to-plane ICP (Y. Chen, G. Medioni, Image Vis. Comput. 10 (1992)
145) by Open3D runs on a bounded sample of both, with Tukey's loss, so that changed areas do not count. Relief
determines x and y less well than images do, unless these are poor; each is weighted by its covariance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import FoundBy, Registration
from wafer_viewer.model.surface.field_poses import RejectionReason
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.numerics.grids.robust_plane import Plane, fit_plane
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.numerics.open3d_library import load_open3d
from wafer_viewer.reconstruct.comparison.resampled_surface import ResampledMosaic, SampleGrid
from wafer_viewer.reconstruct.registration.overlap_strips import Read, height_of, picture_of
from wafer_viewer.reconstruct.registration.picture_match import MATCH_ACCEPTANCE, match


@dataclass(frozen=True, slots=True)
class PatchParameters:
    """Patches that are matched between two surfaces, and the limits of their agreement.

    Parameters
    ----------
    side_px : int, px
        Side of a patch.
    grid : int
        Largest number of patches along each axis.
    levels_at_once : int
        Step between the levels that are searched.
    reach_px : float, px
        Search reach of a patch initially.
    near_px : float, px
        Search reach of a patch after a coarser resolution has located it.
    most_turn_mrad : float, mrad
        Range of the rotations tried if no match is found without, in both directions.
    turn_step_mrad : float, mrad
        Step of those rotations; a step moves a patch's rim by at most 1 px.
    least : int
        Minimum number of patches to estimate a rotation with redundancy.
    far_off : float
        Largest deviation of an agreeing patch: from the median in pixels at first, then from the fit in standard
        deviations of the patches.
    most_turn : float, rad
        Rotation that is allowed for when deviations from the median are judged.
    least_spread_px : float, px
        Minimum scatter of patches, due to interpolation and pixel shape.
    least_u_px : float, px
        Common error of the patches, due to interpolation and pixel shape.
    """

    side_px: int = 256
    grid: int = 5
    levels_at_once: int = 2
    reach_px: float = 96.0
    near_px: float = 8.0
    most_turn_mrad: float = 60.0
    turn_step_mrad: float = 6.0
    least: int = 3
    far_off: float = 4.0
    most_turn: float = 0.05
    least_spread_px: float = 0.03
    least_u_px: float = 0.02


PATCHES = PatchParameters()
Numbers = NDArray[np.float64]
Bounds = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""


@dataclass(frozen=True, slots=True, eq=False)
class InPlane:
    """Registration by images, with the covariance of (x_um, y_um, turn in rad) about its centre and the doubt."""

    registration: Registration
    covariance: Numbers
    doubt: RejectionReason


@dataclass(frozen=True, slots=True, eq=False)
class _Sightings:
    """Matched patches, all [n]: centres, offsets, standard uncertainties and doubts."""

    at_um: Numbers
    off_um: Numbers
    u_um: Numbers
    doubts: list[RejectionReason]


def in_plane(first: Mosaic, second: Mosaic, overlap_um: Bounds) -> InPlane:
    """Register the second surface to the first by their images, or by their relief if that fails.

    overlap_um: (x low, y low, x high, y high) of the possible overlap, by the stage.
    """
    found = _by(picture_of, "images", first, second, overlap_um)
    if found.doubt is RejectionReason.NONE:
        return found
    felt = _by(height_of, "heights", first, second, overlap_um)
    return felt if felt.doubt is RejectionReason.NONE else found


def _by(read: Read, by: FoundBy, first: Mosaic, second: Mosaic, overlap_um: Bounds) -> InPlane:
    xa, ya, xb, yb = overlap_um
    start = Registration(by=by, about_x_um=(xa + xb) / 2, about_y_um=(ya + yb) / 2)
    best = InPlane(start, np.full((3, 3), np.inf), RejectionReason.BLANK)
    levels = _levels(first, overlap_um)
    for level in levels:
        begun = best.doubt is RejectionReason.NONE
        sightings = _sightings(read, ResampledMosaic(first, second, best.registration), overlap_um, level, begun)
        now = _solved(best.registration, sightings, first.pixel_um * 2**level)
        if level == levels[0] and now.doubt is not RejectionReason.NONE:
            now = _turned(read, first, second, best.registration, overlap_um, level) or now
        if now.doubt is RejectionReason.NONE or not begun:
            best = now
        else:
            break
    return best


def _levels(first: Mosaic, overlap_um: Bounds) -> list[int]:
    """Return the levels, from the one at which 1.5 patches span the overlap to full resolution, which is used twice."""
    xa, ya, xb, yb = overlap_um
    side_px = max(xb - xa, yb - ya) / first.pixel_um
    coarsest = min(first.levels - 1, max(0, math.ceil(math.log2(side_px / (1.5 * PATCHES.side_px)))))
    return [*range(coarsest, 0, -PATCHES.levels_at_once), 0, 0]


def _sightings(read: Read, resampled: ResampledMosaic, overlap_um: Bounds, level: int, begun: bool) -> _Sightings:
    """Match the patches of a level, with a wide search until a coarser level has succeeded."""
    pixel = resampled.first.pixel_um * 2**level
    found = [
        _sighting(read, resampled, centre, level, PATCHES.near_px if begun else PATCHES.reach_px)
        for centre in _centres(overlap_um, pixel)
    ]
    centre, off, u, doubts = zip(*found, strict=True)
    return _Sightings(np.array(centre), np.array(off), np.array(u), list(doubts))


def _centres(overlap_um: Bounds, pixel_um: float) -> list[tuple[float, float]]:
    """Return the centres of a grid of patches over the overlap; patches overlap where space is limited."""
    xa, ya, xb, yb = overlap_um
    half = PATCHES.side_px / 2 * pixel_um
    xs, ys = _along(xa, xb, half), _along(ya, yb, half)
    return [(x, y) for x in xs for y in ys]


def _along(low: float, high: float, half: float) -> Numbers:
    if high - low <= 2.2 * half:
        return np.array([(low + high) / 2])
    n = min(PATCHES.grid, max(2, math.ceil((high - low) / half) - 1))
    return np.linspace(low + half, high - half, n)


def _sighting(
    read: Read, resampled: ResampledMosaic, at_um: tuple[float, float], level: int, reach_px: float
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float], RejectionReason]:
    """Match a patch of the second against the first and return its centre, offset, uncertainty and doubt."""
    pixel = resampled.first.pixel_um * 2**level
    nowhere = at_um, (0.0, 0.0), (math.inf, math.inf), RejectionReason.BLANK
    try:
        one = resampled.first.window(_square(at_um, pixel, PATCHES.side_px).region, level)
    except MeasureError:
        return nowhere
    other = resampled.on(_on_pixels_of(one, _square(at_um, pixel, PATCHES.side_px)))
    if not (_holds_enough(one) and _holds_enough(other)):
        return nowhere
    fit = match(one, other, reach_px, read)
    down, right = fit.off_px
    u_down, u_right = fit.u_px
    shows_lines_only = fit.doubt is RejectionReason.NONE and max(fit.u_px) > MATCH_ACCEPTANCE.most_u_px
    doubt = RejectionReason.AMBIGUOUS if shows_lines_only else fit.doubt
    return at_um, (right * pixel, -down * pixel), (u_right * pixel, u_down * pixel), doubt


def _square(at_um: tuple[float, float], pixel_um: float, side_px: int) -> SampleGrid:
    half = (side_px - 1) / 2 * pixel_um
    return SampleGrid(pixel_um, at_um[0] - half, at_um[1] + half, (side_px, side_px))


def _on_pixels_of(one: HeightMap, square: SampleGrid) -> SampleGrid:
    """Return the square moved by less than a pixel, so that it coincides with the pixels of a map."""
    right, down = round((square.x0_um - one.x0_um) / one.pixel_um), round((one.y0_um - square.y0_um) / one.pixel_um)
    return SampleGrid(one.pixel_um, one.x0_um + right * one.pixel_um, one.y0_um - down * one.pixel_um, square.shape)


def _holds_enough(part: HeightMap) -> bool:
    return min(part.shape) >= PATCHES.side_px // 8


def _solved(before: Registration, sightings: _Sightings, pixel_um: float) -> InPlane:
    """Fit a rigid motion to the accepted patches, and add it to the registration used for the search."""
    believed = np.array([doubt is RejectionReason.NONE for doubt in sightings.doubts])
    if not believed.any():
        return InPlane(before, np.full((3, 3), np.inf), _usual(sightings.doubts))
    about = np.array([before.about_x_um, before.about_y_um])
    positions, off, u = sightings.at_um[believed] - about, sightings.off_um[believed], sightings.u_um[believed]
    inliers, motion, covariance = _agreed(positions, off, u, pixel_um)
    if inliers.sum() < believed.sum() / 2:
        return InPlane(before, covariance, RejectionReason.AMBIGUOUS)
    if inliers.sum() < min(PATCHES.least, max(1, len(believed) // 2)):
        return InPlane(before, covariance, RejectionReason.UNLIKE)
    after = replace(
        before,
        x_um=before.x_um + float(motion[0]),
        y_um=before.y_um + float(motion[1]),
        turn_mrad=before.turn_mrad + float(motion[2]) * 1e3,
    )
    reach_um = max(float(np.hypot(*positions.T).max()), pixel_um)
    floor = np.diag([1.0, 1.0, 1 / reach_um**2]) * (PATCHES.least_u_px * pixel_um) ** 2
    return InPlane(after, covariance + floor, RejectionReason.NONE)


def _agreed(
    positions: Numbers, off: Numbers, u: Numbers, pixel_um: float
) -> tuple[NDArray[np.bool_], Numbers, Numbers]:
    """Return (mask of agreeing patches, shift and rotation, covariance); the others may have changed."""
    u = np.hypot(u, PATCHES.least_spread_px * pixel_um)
    inliers = np.hypot(*(off - np.median(off, axis=0)).T) <= max(
        PATCHES.far_off * pixel_um, PATCHES.most_turn * float(np.abs(positions).max(initial=0))
    )
    motion, covariance = np.zeros(3), np.diag([np.inf] * 3)
    for _ in range(4):
        motion, covariance, residuals = _through(positions, off, u, inliers)
        if inliers.sum() < PATCHES.least:
            break
        spread = max(MAD_TO_SIGMA * float(np.median(np.abs(residuals[inliers]))), PATCHES.least_spread_px * pixel_um)
        inliers = np.abs(residuals).max(axis=1) <= PATCHES.far_off * spread
    return inliers, motion, covariance


def _through(
    positions: Numbers, off: Numbers, u: Numbers, inliers: NDArray[np.bool_]
) -> tuple[Numbers, Numbers, Numbers]:
    """Return weighted least squares of (x, y, turn), its covariance, and the residuals [n, 2].

    One or two patches determine a shift only.
    """
    n = len(positions)
    design = np.zeros((n, 2, 3))
    design[:, 0, 0] = design[:, 1, 1] = 1
    if inliers.sum() >= PATCHES.least:
        design[:, 0, 2], design[:, 1, 2] = -positions[:, 1], positions[:, 0]
    rows, values, weights = design[inliers].reshape(-1, 3), off[inliers].ravel(), 1 / u[inliers].ravel()
    normal = (rows * weights[:, None] ** 2).T @ rows
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
    motion = inverse @ ((rows * weights[:, None] ** 2).T @ values)
    residuals = off - design @ motion
    freedom = max(1, values.size - 3)
    excess = max(1.0, float((((residuals[inliers].ravel()) * weights) ** 2).sum()) / freedom)
    return motion, np.asarray(inverse * excess, np.float64), residuals


def _usual(doubts: list[RejectionReason]) -> RejectionReason:
    """Return the most frequent doubt of the patches, ignoring blank ones unless all are blank."""
    telling = [doubt for doubt in doubts if doubt is not RejectionReason.BLANK] or doubts
    return max(set(telling), key=lambda doubt: (telling.count(doubt), doubt))


def _turned(
    read: Read,
    first: Mosaic,
    second: Mosaic,
    start: Registration,
    overlap_um: Bounds,
    level: int,
) -> InPlane | None:
    """Return the fit at the rotation with the best match of the middle patch; None if it is rejected."""
    pixel = first.pixel_um * 2**level
    middle = _centres(overlap_um, pixel)
    angle = middle[len(middle) // 2]
    best: tuple[float, Registration] | None = None
    for turn in _turns():
        turned = replace(start, turn_mrad=turn)
        correlation = _match_sigmas(read, ResampledMosaic(first, second, turned), angle, level)
        if best is None or correlation > best[0]:
            best = correlation, turned
    if best is None:
        return None
    begun = _sightings(read, ResampledMosaic(first, second, best[1]), overlap_um, level, begun=False)
    found = _solved(best[1], begun, pixel)
    return found if found.doubt is RejectionReason.NONE else None


def _turns() -> Iterator[float]:
    n = round(PATCHES.most_turn_mrad / PATCHES.turn_step_mrad)
    return (k * PATCHES.turn_step_mrad for k in range(-n, n + 1))


def _match_sigmas(read: Read, resampled: ResampledMosaic, at_um: tuple[float, float], level: int) -> float:
    """Return the significance of the correlation of a patch, in standard deviations."""
    from wafer_viewer.numerics.cross_correlation import contrast, normalised_cross_correlation

    pixel = resampled.first.pixel_um * 2**level
    one = resampled.first.window(_square(at_um, pixel, PATCHES.side_px).region, level)
    other = resampled.on(_on_pixels_of(one, _square(at_um, pixel, PATCHES.side_px)))
    pictures = [read(part, slice(0, part.shape[0]), slice(0, part.shape[1])) for part in (one, other)]
    valid = [picture.valid > 0 for picture in pictures]
    details = [contrast(p.values, k, 11) for p, k in zip(pictures, valid, strict=True)]
    correlation = normalised_cross_correlation(
        details[0], valid[0], details[1], valid[1], (0, 0), int(PATCHES.reach_px)
    )
    enough = correlation.pixels >= 0.3 * correlation.pixels.max(initial=1.0)
    return float(np.where(enough, correlation.sigmas, 0.0).max(initial=0.0))


@dataclass(frozen=True, slots=True)
class ReliefParameters:
    """Sample of two surfaces, and limits of their alignment by the relief.

    Parameters
    ----------
    sample_px : int
        Number of sample points along each side of the common region.
    least_points : int
        Smallest number of sample points that are measured in both.
    block_px : int, sample points
        Side of the blocks of the plane fit.
    tukey : float
        Scale of Tukey's loss, in standard deviations of the differences; points beyond it do not count.
    least_sigma_um : float, um
        Smallest standard deviation of the differences.
    steepest : float, um per um
        Slope above which a height is a wall, whose position depends more on the microscope than on the sample.
    least_u_px : float, sample points
        Minimum lateral uncertainty of a sample point, because points are means of many pixels.
    """

    sample_px: int = 256
    least_points: int = 100
    block_px: int = 16
    tukey: float = 4.685
    least_sigma_um: float = 1e-4
    steepest: float = 1.0
    least_u_px: float = 0.1


RELIEF = ReliefParameters()


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


def _sample(resampled: ResampledMosaic, region: Region) -> _Sample:
    xa, ya, xb, yb = region.bounds_um
    side_px = max(xb - xa, yb - ya) / resampled.first.pixel_um
    level = min(resampled.first.levels - 1, max(0, int(np.ceil(np.log2(max(side_px, 1.0) / RELIEF.sample_px)))))
    one = resampled.first.window(region, level)
    other = resampled.on(SampleGrid(one.pixel_um, one.x0_um, one.y0_um, one.shape))
    return _Sample(SampleGrid(one.pixel_um, one.x0_um, one.y0_um, one.shape), _heights(one), _heights(other))


def _heights(part: HeightMap) -> NDArray[np.float32]:
    return part.z_raw_um


def _plane(sample: _Sample) -> Plane:
    """Fit a robust plane to the differences. Raises MeasureError when there are too few."""
    n = int(np.isfinite(sample.difference_um).sum())
    found = fit_plane(sample.difference_um, RELIEF.block_px) if n >= RELIEF.least_points else None
    if found is None:
        raise MeasureError(
            f"Both surfaces are measured at {n} of the places looked at and at least {RELIEF.least_points} are needed: "
            "take surfaces of the same part of the sample."
        )
    return found


def _on_plane(registration: Registration, sample: _Sample, plane: Plane) -> Registration:
    """Subtract the plane of the differences from a registration."""
    pixel = sample.lattice.pixel_um
    x_um, y_um = sample.lattice.x0_um + plane.col0 * pixel, sample.lattice.y0_um - plane.row0 * pixel
    slope_x, slope_y = plane.slope_right / pixel, -plane.slope_down / pixel
    offset_at_centre = (
        plane.value + slope_x * (registration.about_x_um - x_um) + slope_y * (registration.about_y_um - y_um)
    )
    spread = np.linalg.pinv(plane.information, hermitian=True)
    return replace(
        registration,
        z_um=float(registration.z_um - offset_at_centre),
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
    if len(target) < RELIEF.least_points:
        return np.zeros(3), np.zeros((3, 3))
    registration = load_open3d().pipelines.registration
    sigma = max(plane.rms, RELIEF.least_sigma_um)
    estimation = registration.TransformationEstimationPointToPlane(registration.TukeyLoss(k=RELIEF.tukey * sigma))
    reach_um = float(np.hypot(sample.lattice.pixel_um, 2 * RELIEF.tukey * sigma))
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
    usable = np.isfinite(down + right + sample.second_um) & (np.hypot(down, right) < RELIEF.steepest)
    rows, cols = np.nonzero(usable)
    x = sample.lattice.x0_um + cols * sample.lattice.pixel_um - about_um[0]
    y = sample.lattice.y0_um - rows * sample.lattice.pixel_um - about_um[1]
    normals = np.stack([-right[usable], down[usable], np.ones(len(rows))], axis=1).astype(np.float64)
    normals /= np.sqrt((normals**2).sum(axis=1, keepdims=True))
    target, source = (_xyz(x, y, z[usable]) for z in (sample.first_um, sample.second_um))
    return target, source, normals


def _xyz(x_um: Any, y_um: Any, z_um: NDArray[np.float32]) -> Numbers:
    return np.stack([x_um, y_um, z_um], axis=1).astype(np.float64)


def _information(target: Numbers, normals: Numbers, source: Numbers, plane: Plane, pixel_um: float) -> Numbers:
    """Return the inverse covariance of (x, y, turn), with height and tilts marginalised."""
    x, y = target[:, 0], target[:, 1]
    nx, ny, nz = normals.T
    design = np.stack([nx, ny, x * ny - y * nx, nz, x * nz, y * nz], axis=1)
    sigma = max(plane.rms, RELIEF.least_sigma_um)
    design = design[np.abs(((source - target) * normals).sum(axis=1)) < RELIEF.tukey * sigma]
    correlation = max(1.0, plane.n_pixels / sigma**2 / max(float(plane.information[0, 0]), 1e-30))
    full = design.T @ design / (sigma**2 * correlation)
    free = full[:3, :3] - full[:3, 3:] @ np.linalg.pinv(full[3:, 3:], hermitian=True) @ full[3:, :3]
    reach_um = max(float(np.hypot(x, y).max()), pixel_um)
    floor = np.diag([1.0, 1.0, 1 / reach_um**2]) * (RELIEF.least_u_px * pixel_um) ** 2
    return np.asarray(np.linalg.pinv(np.linalg.pinv(free, hermitian=True) + floor, hermitian=True), np.float64)


def _cloud(points: Numbers, normals: Numbers | None = None) -> Any:
    open3d = load_open3d()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    if normals is not None:
        cloud.normals = open3d.utility.Vector3dVector(normals)
    return cloud
