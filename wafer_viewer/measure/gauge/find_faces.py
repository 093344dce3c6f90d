"""Automatic detection of the two faces of a gauge-block pair: plane search in a thinned cloud, then a square on each.

The planes are those with the most points (RANSAC, Open3D). A square is placed where it is surrounded by its own face:
away from the border of the scan, and away from the joint by the distance that a wall of that height shades.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer, height_window, layer_of
from wafer_viewer.measure.base.robust_fit import LevelPlane, fit_plane
from wafer_viewer.model.acquisition.calibration import shaded_um
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Heights, Mosaic
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.numerics.open3d_library import load_open3d

SIZE_PX = 800
"""Side of the areas on which the paper measures its blocks."""


@dataclass(frozen=True, slots=True)
class FaceSearchParameters:
    """Limits of the search for two parallel faces.

    Parameters
    ----------
    lattice : int
        Largest number of surface points used.
    cloud : int
        Approximate number of points for the plane search.
    least_points : int
        Smallest number of measured points of a surface.
    least_share : float
        Smallest fraction of the measured points that forms a face.
    most_planes : int
        Number of planes at which the search ends; with a third one the surface is refused.
    most_tilt : float, um per um
        Largest tilt between parallel faces; wrung blocks are within a hundredth of it.
    search_sigmas : float
        Inlier band of a plane during the search, in robust deviations.
    within_sigmas : float
        Inlier band of the final plane, in robust deviations.
    least_noise_um : float, um
        Lower limit of the noise of the heights.
    tries : int
        Number of random planes of each search.
    refits : int
        Number of least-squares fits to the inliers of the best of them.
    lags : int
        The lag for the noise estimate is the surface's width divided by this.
    rim : float
        Distance of the upper square from its face's rim, relative to the shaded distance.
    tight : float
        Largest fraction of the available room that a square takes.
    least_window_px : int, px
        Step to which the side of a reduced square is rounded.
    round_about : int, lattice px
        Window in which the majority must lie on a face.
    smallest_px : int, px
        Smallest side of a square.
    seed : int
        Seed of the random planes, fixed so that the same surface gives the same squares.
    steep : float
        Smallest z component of a plane's normal for a visible face.
    """

    lattice: int = 250_000
    cloud: int = 20_000
    least_points: int = 500
    least_share: float = 0.08
    most_planes: int = 3
    most_tilt: float = 0.02
    search_sigmas: float = 3.0
    within_sigmas: float = 5.0
    least_noise_um: float = 0.01
    tries: int = 1000
    refits: int = 2
    lags: int = 16
    rim: float = 0.25
    tight: float = 0.9
    least_window_px: int = 10
    round_about: int = 9
    smallest_px: int = 50
    seed: int = 0
    steep: float = 0.5


FACE_SEARCH = FaceSearchParameters()
Mask = NDArray[np.bool_]
Place = NDArray[np.float64]


class FoundFaces(NamedTuple):
    """A square on the upper face and one on the lower, with notes."""

    upper: Region
    lower: Region
    notes: tuple[str, ...] = ()


class VisibleFace(NamedTuple):
    """The surface on a coarse lattice, heights float64 [row, col], and its measured points, [n, 3]."""

    z_um: Floats
    x_um: Floats
    y_um: Floats
    points: Floats

    @property
    def pixel_um(self) -> float:
        """Pixel pitch of the lattice."""
        return float(self.x_um[1] - self.x_um[0])


class FacePlane(NamedTuple):
    """A plane and the half-width of its inlier band."""

    fitted: LevelPlane
    band_um: float


def find_faces(surface: Mosaic, *, size_px: float = SIZE_PX, layer: Layer | None = None) -> FoundFaces:
    """Find a square on each of the two parallel faces of a surface.

    Planes are searched in a thinned cloud of the measured points (RANSAC, Open3D). A square is placed where it is
    surrounded by its own face: away from the border of the scan, and away from the joint by the distance over which a
    wall of that height hides part of the objective's aperture. The two squares are close to each other, centred along
    the joint.

    Parameters
    ----------
    surface : Mosaic
        The scan of a gauge-block pair, or another surface with two parallel faces.
    size_px : float, default 800
        Side of each square in pixels of the surface. The paper measures its blocks on areas of 800 px.
    layer : {"unsmoothed", "smoothed", "filled"}, optional
        Height layer to search. By default the one that the recipe of the surface measures on.

    Returns
    -------
    FoundFaces
        `upper` and `lower`: a square on the higher face and one on the lower, rectangles in stage um. `notes`: says so
        if the squares were reduced because a face is too small for them; the side of reduced squares is a multiple of
        10 px.

    Raises
    ------
    MeasureError
        If too little of the surface is measured, the surface does not have exactly two faces, the faces differ in tilt
        by more than 20 mrad, or one has no room for a square of 50 pixels.
    ComputeError
        If Open3D cannot be loaded.

    Notes
    -----
    A face holds at least 8 % of the measured points. The search has a fixed random seed.

    References
    ----------
    M. A. Fischler and R. C. Bolles, Random sample consensus, Commun. ACM 24 (1981) 381.
    """
    faces = _visible_faces(surface, layer_of(surface.provenance.recipe, layer))
    middle = float(faces.x_um.mean()), float(faces.y_um.mean())
    low, high = sorted(_two_parallel(faces), key=lambda plane: plane.fitted.at(*middle))
    high_um, low_um = (plane.fitted.at(*middle) for plane in (high, low))
    shade_um = shaded_um(float(high_um - low_um), surface.provenance.calibration)
    above_um, below_um = _room_um(faces, high, low, FACE_SEARCH.rim * shade_um), _room_um(faces, low, high, shade_um)
    room_px = FACE_SEARCH.tight * 2 * float(min(above_um.max(), below_um.max())) / surface.pixel_um
    side_px = size_px if room_px >= size_px else FACE_SEARCH.least_window_px * (room_px // FACE_SEARCH.least_window_px)
    if room_px < FACE_SEARCH.smallest_px:
        which = "upper" if above_um.max() < below_um.max() else "lower"
        raise MeasureError(
            f"The {which} face has no room for a square of {FACE_SEARCH.smallest_px} pixels away from its borders: "
            "draw the two regions by hand."
        )
    side_um = side_px * surface.pixel_um
    upper_um, lower_um = _nearest_pair(faces, above_um >= side_um / 2, below_um >= side_um / 2)
    return FoundFaces(_square(upper_um, side_um), _square(lower_um, side_um), _note(side_px, size_px))


def _visible_faces(surface: Mosaic, layer: Layer) -> VisibleFace:
    rows, cols = surface.shape
    level = min(surface.levels - 1, max(0, math.ceil(math.log(rows * cols / FACE_SEARCH.lattice, 4))))
    part = height_window(surface, layer, _whole(surface), level)
    step = max(1, math.ceil(math.sqrt(part.z_um.size / FACE_SEARCH.lattice)))
    z_um, x_um, y_um = _thinned(part, step)
    finite_rows, finite_cols = np.nonzero(np.isfinite(z_um))
    if len(finite_rows) < FACE_SEARCH.least_points:
        raise MeasureError("Too little of the surface is measured to look for faces: scan it again.")
    points = np.stack([x_um[finite_cols], y_um[finite_rows], z_um[finite_rows, finite_cols]], axis=1)
    return VisibleFace(z_um, x_um, y_um, points)


def _whole(surface: Mosaic) -> Region:
    rows, cols = surface.shape
    right_um, bottom_um = (cols - 1) * surface.pixel_um, (rows - 1) * surface.pixel_um
    return Region.rectangle(surface.x0_um, surface.y0_um - bottom_um, surface.x0_um + right_um, surface.y0_um)


def _thinned(part: Heights, step: int) -> tuple[Floats, Floats, Floats]:
    return part.z_um[::step, ::step].astype(np.float64), part.x_um[::step], part.y_um[::step]


def _two_parallel(faces: VisibleFace) -> tuple[FacePlane, FacePlane]:
    planes = _planes(faces)
    if len(planes) != 2:
        count = {0: "no face", 1: "one face"}.get(len(planes), f"{len(planes)} faces or more")
        raise MeasureError(
            f"The surface shows {count} where two parallel ones are looked for: draw the two regions by hand."
        )
    a, b = (plane.fitted for plane in planes)
    tilt = math.hypot(a.slope_x - b.slope_x, a.slope_y - b.slope_y)
    if tilt > FACE_SEARCH.most_tilt:
        raise MeasureError(
            f"The two faces are {1e3 * tilt:.0f} mrad apart in tilt, {1e3 * FACE_SEARCH.most_tilt:.0f} mrad at most "
            "are parallel: draw the two regions by hand."
        )
    return planes[0], planes[1]


def _planes(faces: VisibleFace) -> list[FacePlane]:
    """Return up to three planes in order of their number of points; each removes its points from the search."""
    left, found = faces.points, list[FacePlane]()
    least = FACE_SEARCH.least_share * len(faces.points)
    while len(left) >= least and len(found) < FACE_SEARCH.most_planes:
        plane = _searched(left, _noise_um(faces.z_um))
        off_um = np.abs(left[:, 2] - plane.fitted.at(left[:, 0], left[:, 1]))
        near_um = off_um[off_um <= plane.band_um]
        if len(near_um) < least / 2:
            break
        band_um = FACE_SEARCH.within_sigmas * max(
            MAD_TO_SIGMA * float(np.median(near_um)), plane.band_um / FACE_SEARCH.search_sigmas
        )
        if np.count_nonzero(off_um <= band_um) < least:
            break
        found.append(plane._replace(band_um=band_um))
        left = left[off_um > band_um]
    return found


def _searched(points: Floats, noise_um: float) -> FacePlane:
    """Find the plane with the most points, then fit it to them."""
    open3d = load_open3d()
    open3d.utility.random.seed(FACE_SEARCH.seed)
    some = points[:: max(1, len(points) // FACE_SEARCH.cloud)]
    middle = some.mean(axis=0)
    x_um, y_um, z_um = middle.tolist()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(some - middle))
    band_um = FACE_SEARCH.search_sigmas * noise_um
    (a, b, c, d), _ = cloud.segment_plane(distance_threshold=band_um, ransac_n=3, num_iterations=FACE_SEARCH.tries)
    if abs(c) < FACE_SEARCH.steep:
        return FacePlane(LevelPlane(x_um, y_um, z_um, 0.0, 0.0), 0.0)
    rough = LevelPlane(x_um, y_um, z_um - d / c, -a / c, -b / c)
    for _ in range(FACE_SEARCH.refits):
        rough = fit_plane(
            HeightSamples(*points[np.abs(points[:, 2] - rough.at(points[:, 0], points[:, 1])) <= band_um].T)
        )[0]
    return FacePlane(rough, band_um)


def _noise_um(z_um: Floats) -> float:
    """Return the robust deviation of heights from detrended differences at a lag beyond the error correlation."""
    lag = max(1, z_um.shape[1] // FACE_SEARCH.lags)
    differ = z_um[:, lag:] - z_um[:, :-lag]
    return max(
        FACE_SEARCH.least_noise_um,
        MAD_TO_SIGMA / math.sqrt(2) * float(np.nanmedian(np.abs(differ - np.nanmedian(differ)))),
    )


def _room_um(faces: VisibleFace, own: FacePlane, other: FacePlane, shade_um: float) -> Floats:
    """Return half the side of the largest square about each pixel on its own face and out of the wall's shade."""
    free, wall = (_on(faces, plane) for plane in (own, other))
    to_end_um, to_wall_um = (
        faces.pixel_um * _distance(free, beyond=False),
        faces.pixel_um * _distance(~wall, beyond=True),
    )
    return np.minimum(to_end_um, to_wall_um - shade_um)


def _on(faces: VisibleFace, plane: FacePlane) -> Mask:
    """Return the mask of pixels whose neighbourhood lies mostly on a plane; single holes are ignored."""
    from scipy.ndimage import uniform_filter

    z_um = plane.fitted.at(faces.x_um[None, :], faces.y_um[:, None])
    on = np.abs(faces.z_um - z_um) <= plane.band_um
    return uniform_filter(on.astype(np.float32), FACE_SEARCH.round_about, mode="constant") > 0.5


def _distance(mask: Mask, *, beyond: bool) -> Floats:
    """Return the chessboard distance in px to the nearest pixel off the mask; beyond: the mask continues outside."""
    from scipy.ndimage import distance_transform_cdt

    inside = distance_transform_cdt(np.pad(mask, 1, constant_values=beyond), metric="chessboard")
    return np.asarray(inside, np.float64)[1:-1, 1:-1] - 0.5


def _nearest_pair(faces: VisibleFace, upper: Mask, lower: Mask) -> tuple[Place, Place]:
    """Return the closest pair of places for both squares, centred along the joint: a short lever arm."""
    above, below = (np.stack([faces.x_um[c], faces.y_um[r]], 1) for r, c in (np.nonzero(m) for m in (upper, lower)))
    start = above.mean(axis=0)
    for places in (below, above, below, above):
        other, start = start, places[np.argmin(np.hypot(*(places - start).T))]
    return start, other


def _square(center: Place, side_um: float) -> Region:
    (x_um, y_um), half_um = np.round(center, 2).tolist(), side_um / 2
    return Region.rectangle(x_um - half_um, y_um - half_um, x_um + half_um, y_um + half_um)


def _note(side_px: float, size_px: float) -> tuple[str, ...]:
    if side_px == size_px:
        return ()
    return (f"The faces have room for squares of {side_px:.0f} px, not for {size_px:g} px.",)
