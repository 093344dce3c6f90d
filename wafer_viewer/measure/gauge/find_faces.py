"""The two faces of a pair of gauge blocks, found by themselves: plane search in a thinned cloud, then a square on each.

The planes are those that most points lie on (RANSAC, Open3D). A square goes where all round it is its own face: off the
border of what was seen, off the joint by as far as a wall of that height shades the lower face.
"""

from __future__ import annotations

import importlib
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer, height_window, layer_of
from wafer_viewer.measure.base.robust_plane import SIGMA_OF_MAD, LevelPlane, fit_plane
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Heights, Mosaic

SIZE_PX = 800
"""Side of the areas that the paper measures its blocks on."""
LATTICE = 250_000
"""Points of the surface that are looked at, at most."""
CLOUD = 20_000
"""Points that planes are searched in, at most."""
LEAST_POINTS = 500
LEAST_SHARE = 0.08
"""Of the measured points: fewer are no face."""
MOST_PLANES = 3
MOST_TILT = 0.02
"""Between faces that count as parallel, um per um: wrung blocks lie within a hundredth of it."""
SEARCH_SIGMAS, WITHIN_SIGMAS = 3.0, 5.0
"""Points so many robust deviations off a plane do not belong to it: while it is searched, and once it is found."""
LEAST_NOISE_UM = 0.01
TRIES = 1000
LAGS = 16
"""Noise is told from heights that lie this share of the surface's width apart."""
SHADE = 0.3
"""A wall shades the face at its foot as far as so many times its height: the tangent of an aperture of 0.28."""
RIM = 0.25
"""Of that, what the upper face keeps off its own rim."""
TIGHT = 0.9
"""Of the room that there is, what a square takes at most."""
WHOLE_PX = 10
"""A square that has to be made smaller is so many pixels wide, or a multiple."""
ROUND_ABOUT = 9
"""Pixels of the lattice of which most have to lie on a face."""
SMALLEST_PX = 50
SEED = 0
STEEP = 0.5
"""A plane whose normal is tilted so far (its z component) is no face that a microscope sees."""
Mask = NDArray[np.bool_]
Place = NDArray[np.float64]


class FoundFaces(NamedTuple):
    """A square on the upper face and one on the lower, and what to say of them."""

    upper: Region
    lower: Region
    notes: tuple[str, ...] = ()


class SeenFace(NamedTuple):
    """The surface on a coarse lattice, heights float64 [row, col], and the points of it that were measured, [n, 3]."""

    z_um: Floats
    x_um: Floats
    y_um: Floats
    points: Floats

    @property
    def pixel_um(self) -> float:
        """Of the lattice."""
        return float(self.x_um[1] - self.x_um[0])


class FacePlane(NamedTuple):
    """A plane, and how far off it a point still belongs to it."""

    fitted: LevelPlane
    band_um: float


def find_faces(surface: Mosaic, *, size_px: float = SIZE_PX, layer: Layer | None = None) -> FoundFaces:
    """A square of `size_px` pixels on each of the two parallel faces of a surface, the higher one first.

    Squares are made smaller, with a note, where a face is too small for them. Raises MeasureError when there are not
    exactly two parallel faces, or one has no room for a square of 50 pixels.
    """
    seen = _seen(surface, layer_of(surface.provenance.recipe, layer))
    middle = float(seen.x_um.mean()), float(seen.y_um.mean())
    low, high = sorted(_two_parallel(seen), key=lambda plane: plane.fitted.at(*middle))
    shade_um = SHADE * float(high.fitted.at(*middle) - low.fitted.at(*middle))
    above_um, below_um = _room_um(seen, high, low, RIM * shade_um), _room_um(seen, low, high, shade_um)
    room_px = TIGHT * 2 * float(min(above_um.max(), below_um.max())) / surface.pixel_um
    side_px = size_px if room_px >= size_px else WHOLE_PX * (room_px // WHOLE_PX)
    if room_px < SMALLEST_PX:
        which = "upper" if above_um.max() < below_um.max() else "lower"
        raise MeasureError(
            f"The {which} face has no room for a square of {SMALLEST_PX} pixels away from its borders: "
            "draw the two regions by hand."
        )
    side_um = side_px * surface.pixel_um
    at_upper, at_lower = _nearest_pair(seen, above_um >= side_um / 2, below_um >= side_um / 2)
    return FoundFaces(_square(at_upper, side_um), _square(at_lower, side_um), _note(side_px, size_px))


def _seen(surface: Mosaic, layer: Layer) -> SeenFace:
    rows, cols = surface.shape
    level = min(surface.levels - 1, max(0, math.ceil(math.log(rows * cols / LATTICE, 4))))
    part = height_window(surface, layer, _whole(surface), level)
    step = max(1, math.ceil(math.sqrt(part.z_um.size / LATTICE)))
    z_um, x_um, y_um = _thinned(part, step)
    known_rows, known_cols = np.nonzero(np.isfinite(z_um))
    if len(known_rows) < LEAST_POINTS:
        raise MeasureError("Too little of the surface is measured to look for faces: scan it again.")
    points = np.stack([x_um[known_cols], y_um[known_rows], z_um[known_rows, known_cols]], axis=1)
    return SeenFace(z_um, x_um, y_um, points)


def _whole(surface: Mosaic) -> Region:
    rows, cols = surface.shape
    right_um, bottom_um = (cols - 1) * surface.pixel_um, (rows - 1) * surface.pixel_um
    return Region.rectangle(surface.x0_um, surface.y0_um - bottom_um, surface.x0_um + right_um, surface.y0_um)


def _thinned(part: Heights, step: int) -> tuple[Floats, Floats, Floats]:
    return part.z_um[::step, ::step].astype(np.float64), part.x_um[::step], part.y_um[::step]


def _two_parallel(seen: SeenFace) -> tuple[FacePlane, FacePlane]:
    planes = _planes(seen)
    if len(planes) != 2:
        count = {0: "no face", 1: "one face"}.get(len(planes), f"{len(planes)} faces or more")
        raise MeasureError(
            f"The surface shows {count} where two parallel ones are looked for: draw the two regions by hand."
        )
    a, b = (plane.fitted for plane in planes)
    tilt = math.hypot(a.slope_x - b.slope_x, a.slope_y - b.slope_y)
    if tilt > MOST_TILT:
        raise MeasureError(
            f"The two faces are {1e3 * tilt:.0f} mrad apart in tilt, {1e3 * MOST_TILT:.0f} mrad at most are parallel: "
            "draw the two regions by hand."
        )
    return planes[0], planes[1]


def _planes(seen: SeenFace) -> list[FacePlane]:
    """Up to three planes, those with the most points first; each takes its points away from the next."""
    left, found = seen.points, list[FacePlane]()
    least = LEAST_SHARE * len(seen.points)
    while len(left) >= least and len(found) < MOST_PLANES:
        plane = _searched(left, _noise_um(seen.z_um))
        off_um = np.abs(left[:, 2] - plane.fitted.at(left[:, 0], left[:, 1]))
        near_um = off_um[off_um <= plane.band_um]
        if len(near_um) < least / 2:
            break
        band_um = WITHIN_SIGMAS * max(SIGMA_OF_MAD * float(np.median(near_um)), plane.band_um / SEARCH_SIGMAS)
        if np.count_nonzero(off_um <= band_um) < least:
            break
        found.append(plane._replace(band_um=band_um))
        left = left[off_um > band_um]
    return found


def _searched(points: Floats, noise_um: float) -> FacePlane:
    """The plane that most points lie on, then fitted to those that do."""
    open3d = _open3d()
    open3d.utility.random.seed(SEED)
    some = points[:: max(1, len(points) // CLOUD)]
    middle = some.mean(axis=0)
    x_um, y_um, z_um = middle.tolist()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(some - middle))
    band_um = SEARCH_SIGMAS * noise_um
    (a, b, c, d), _ = cloud.segment_plane(distance_threshold=band_um, ransac_n=3, num_iterations=TRIES)
    if abs(c) < STEEP:
        return FacePlane(LevelPlane(x_um, y_um, z_um, 0.0, 0.0), 0.0)
    rough = LevelPlane(x_um, y_um, z_um - d / c, -a / c, -b / c)
    for _ in range(2):
        rough = fit_plane(
            HeightSamples(*points[np.abs(points[:, 2] - rough.at(points[:, 0], points[:, 1])) <= band_um].T)
        )[0]
    return FacePlane(rough, band_um)


def _noise_um(z_um: Floats) -> float:
    """Robust deviation of heights, from how far those differ that lie too far apart to err alike, tilt apart."""
    lag = max(1, z_um.shape[1] // LAGS)
    differ = z_um[:, lag:] - z_um[:, :-lag]
    return max(LEAST_NOISE_UM, SIGMA_OF_MAD / math.sqrt(2) * float(np.nanmedian(np.abs(differ - np.nanmedian(differ)))))


def _room_um(seen: SeenFace, own: FacePlane, other: FacePlane, shade_um: float) -> Floats:
    """Half the side of the largest square about each pixel with nothing but its own face, out of the wall's shade."""
    free, wall = (_on(seen, plane) for plane in (own, other))
    to_end_um, to_wall_um = seen.pixel_um * _distance(free, beyond=False), seen.pixel_um * _distance(~wall, beyond=True)
    return np.minimum(to_end_um, to_wall_um - shade_um)


def _on(seen: SeenFace, plane: FacePlane) -> Mask:
    """Where most pixels round about lie on a plane: single holes do not count."""
    from scipy.ndimage import uniform_filter

    z_um = plane.fitted.at(seen.x_um[None, :], seen.y_um[:, None])
    on = np.abs(seen.z_um - z_um) <= plane.band_um
    return uniform_filter(on.astype(np.float32), ROUND_ABOUT, mode="constant") > 0.5


def _distance(mask: Mask, *, beyond: bool) -> Floats:
    """Pixels to the nearest outside of the mask, along rows or columns, whichever is more; beyond: is the end in it?"""
    from scipy.ndimage import distance_transform_cdt

    inside = distance_transform_cdt(np.pad(mask, 1, constant_values=beyond), metric="chessboard")
    return np.asarray(inside, np.float64)[1:-1, 1:-1] - 0.5


def _nearest_pair(seen: SeenFace, upper: Mask, lower: Mask) -> tuple[Place, Place]:
    """The places for both squares that lie nearest together, in the middle along the joint: a short lever."""
    above, below = (np.stack([seen.x_um[c], seen.y_um[r]], 1) for r, c in (np.nonzero(m) for m in (upper, lower)))
    at = above.mean(axis=0)
    for places in (below, above, below, above):
        other, at = at, places[np.argmin(np.hypot(*(places - at).T))]
    return at, other


def _square(at: Place, side_um: float) -> Region:
    (x_um, y_um), half_um = np.round(at, 2).tolist(), side_um / 2
    return Region.rectangle(x_um - half_um, y_um - half_um, x_um + half_um, y_um + half_um)


def _note(side_px: float, size_px: float) -> tuple[str, ...]:
    if side_px == size_px:
        return ()
    return (f"The faces have room for squares of {side_px:.0f} px, not for {size_px:g} px.",)


def _open3d() -> Any:
    """Imported where it is used: it takes long, and fails on a bare machine."""
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as fault:
        raise MeasureError(
            "Faces are looked for with Open3D, which cannot be loaded here: 'wafer-viewer doctor' says what it lacks, "
            "or draw the two regions by hand."
        ) from fault
