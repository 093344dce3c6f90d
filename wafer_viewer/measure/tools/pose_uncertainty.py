"""Uncertainty of a step height due to the poses of the fields: heights of some fields relative to others.

A height or tilt error of a field shifts what is measured on it. Two regions of one field shift together, regions of
neighbouring fields as far as their overlap couples them. The covariance of all poses therefore matters, from the
overlaps and from the stage.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.plane_faces import Face
from wafer_viewer.measure.base.tile_statistics import SIDES, Tiles
from wafer_viewer.measure.tools.step_definitions import LinearFunctional, StepFaces
from wafer_viewer.model.surface.field_poses import HasPoses, Poses
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, ReadThrough

MOST_FIELDS = 300
"""Largest number of fields considered; more distant ones have negligible influence.

Regions that extend beyond them have no such budget line.
"""
TILT_ERROR = 1e-3
"""Prior standard deviation of a field's tilt, um per um: an upper bound, before overlaps are used."""


class PoseSensitivities(NamedTuple):
    """Places on the surface, and sensitivity coefficients of a number to the height at each: float64 [n]."""

    x_um: Floats
    y_um: Floats
    weight: Floats


def pose_sensitivities(faces: StepFaces, of: LinearFunctional) -> PoseSensitivities:
    """Return the sensitivity coefficients of a linear functional of two faces, at the centres of tiles."""
    pairs = zip(_weights(faces.high, of.high), _weights(faces.low, of.low), strict=True)
    return PoseSensitivities(*(np.concatenate(pair) for pair in pairs))


def poses_u_um(surface: Mosaic, pulls: PoseSensitivities) -> float | None:
    """Return the standard uncertainty of a number due to the poses of its fields.

    0 where all was measured in one field; None where the poses are unknown.
    """
    bare = surface
    while isinstance(bare, ReadThrough) and not isinstance(bare, HasPoses):
        bare = bare.surface
    if isinstance(bare, HeightMap):
        return 0.0 if bare.overlap_um is None else None
    poses = bare.poses if isinstance(bare, HasPoses) else None
    return None if poses is None else _of_fields(poses, pulls)


def _of_fields(poses: Poses, pulls: PoseSensitivities) -> float | None:
    x_um, y_um, weight = pulls
    field = _field_of(poses, x_um, y_um)
    if len(np.unique(field)) == 1:
        return 0.0
    if poses.z_error_um == 0:
        return None
    some = _nearest(poses, float(x_um.mean()), float(y_um.mean()))
    if not np.isin(field, some).all():
        return None
    pull = np.zeros((len(poses.x_um), 3))
    from_middle = np.stack([np.ones(len(field)), x_um - poses.x_um[field], y_um - poses.y_um[field]], axis=1)
    np.add.at(pull, field, weight[:, None] * from_middle)
    by = pull[some].ravel()
    return float(np.sqrt(max(0.0, by @ np.linalg.solve(_information(poses, some), by))))


def _weights(face: Face, gradient: Floats) -> tuple[Floats, Floats, Floats]:
    """Return tile centres x, y of a face, and their sensitivity coefficients for gradient times the face's plane."""
    columns = np.column_stack([face.points.x_um, face.points.y_um, face.design])
    means = Tiles.of(face.points, columns, face.part, SIDES[0]).means
    return means[:, 0], means[:, 1], gradient @ np.linalg.pinv(means[:, 2:])


def _field_of(poses: Poses, x_um: Floats, y_um: Floats) -> NDArray[np.intp]:
    """Return the field whose centre is nearest to each place, relative to the field size."""
    from scipy.spatial import KDTree

    there = np.flatnonzero(~poses.left_out)
    size = np.array(poses.form.field_size_um)
    middles = np.column_stack([poses.x_um[there], poses.y_um[there]]) / size
    _, nearest = KDTree(middles).query(np.column_stack([x_um, y_um]) / size, p=np.inf)
    return there[nearest]


def _nearest(poses: Poses, x_um: float, y_um: float) -> NDArray[np.intp]:
    return np.sort(np.argsort(np.hypot(poses.x_um - x_um, poses.y_um - y_um), kind="stable")[:MOST_FIELDS])


def _information(poses: Poses, some: NDArray[np.intp]) -> Floats:
    """Return the inverse covariance of (height, slope x, slope y) of some fields, from stage and overlaps."""
    n, seams = len(some), poses.seams
    told = np.diag(np.tile([poses.z_error_um**-2.0, TILT_ERROR**-2.0, TILT_ERROR**-2.0], n))
    place = np.full(len(poses.x_um), -1)
    place[some] = np.arange(n)
    tells = (seams.weight > 0) & np.isfinite(seams.mid_x_um) & (seams.information[:, 0, 0] > 0)
    for k in np.flatnonzero(tells & (place[seams.first] >= 0) & (place[seams.second] >= 0)):
        a, b = int(seams.first[k]), int(seams.second[k])
        arms = (_at(poses, field, float(seams.mid_x_um[k]), float(seams.mid_y_um[k])) for field in (a, b))
        difference = np.concatenate([sign * arm for sign, arm in zip((-1, 1), arms, strict=True)], axis=1)
        rows = np.concatenate([3 * place[field] + np.arange(3) for field in (a, b)])
        told[np.ix_(rows, rows)] += seams.weight[k] * difference.T @ seams.information[k] @ difference
    return told


def _at(poses: Poses, field: int, x_um: float, y_um: float) -> Floats:
    """Return the matrix [3, 3] from height and slopes at a field's centre to those at a place."""
    return np.array([[1.0, x_um - poses.x_um[field], y_um - poses.y_um[field]], [0, 1, 0], [0, 0, 1]])
