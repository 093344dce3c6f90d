"""Step height between two faces, with its definitions and its uncertainty budget.

The distance between tilted faces depends on the place, so the definition of h belongs to the result. Each definition is
a pair of gradients: h is their product with (slope x, slope y, height at the centre) of the upper and of the lower
face.

A height or tilt error of a field shifts what is measured on it. Two regions of one field shift together, regions of
neighbouring fields as far as their overlap couples them. The covariance of all poses therefore matters, from the
overlaps and from the stage.

Each face is one plane through one or several regions, fitted with rejection beyond 3 robust deviations. Where faces are
tilted against each other the definition of h is part of the result, so the values of other definitions are reported
with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.correlated_errors import Scatter, Tiles
from wafer_viewer.measure.base.error_covariance import WeightedHeights
from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer, level_for, require_area
from wafer_viewer.measure.base.levelled_surface import levelling_of
from wafer_viewer.measure.base.measurement_context import (
    INTERPOLATION,
    LEVELLING,
    NOISE,
    PIXEL_SCALE,
    POSES,
    Budget,
    Lines,
    MeasurementContext,
    between_frames_um,
    combined,
    step_budget,
)
from wafer_viewer.measure.base.pixel_noise import noise_um, pixel_noise_um
from wafer_viewer.measure.base.plane_faces import (
    Face,
    Regions,
    as_region_tuple,
    enough_points,
    face_of,
    require_measured,
)
from wafer_viewer.model.acquisition.calibration import Calibration, shaded_um
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import StepHeight
from wafer_viewer.model.measurement.tool_options import Conditions, StepDefinition, StepOptions
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.field_poses import HasPoses, Poses
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, ReadThrough

TILTS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
"""Gradients of the slopes of a face along x and along y by its parameters: slope x, slope y, height."""


@dataclass(frozen=True, slots=True, eq=False)
class StepFaces:
    """The upper and the lower face of a step."""

    high: Face
    low: Face

    @property
    def apart_um(self) -> Floats:
        """Vector from the centre of the lower face to that of the upper one, (x, y)."""
        high, low = self.high.plane, self.low.plane
        return np.array([high.x_um - low.x_um, high.y_um - low.y_um])

    @property
    def joint_um(self) -> Floats:
        """Midpoint between the facing borders of the regions, on the line between their centres.

        Where regions of both faces alternate there is no such place; then the midpoint of their centres.
        """
        start, along, last_low, first_high = self._facing_um()
        middle_um = last_low + first_high if last_low <= first_high else float(np.hypot(*self.apart_um))
        return start + along * middle_um / 2

    @property
    def between_um(self) -> float:
        """Distance between the facing borders of the regions; negative where regions of both faces alternate."""
        *_, last_low, first_high = self._facing_um()
        return first_high - last_low

    def _facing_um(self) -> tuple[Floats, Floats, float, float]:
        """Centre of the lower face, direction to the upper one, and where they end towards each other on that line."""
        start, direction = np.array([self.low.plane.x_um, self.low.plane.y_um]), self.apart_um
        along = direction / max(float(np.hypot(*direction)), 1e-9)
        last_low = float(_along(self.low, start, along).max())
        return start, along, last_low, float(_along(self.high, start, along).min())


@dataclass(frozen=True, slots=True, eq=False)
class LinearFunctional:
    """Linear functional of two faces: gradients [3] times the parameters of the upper and the lower one."""

    high: Floats
    low: Floats

    def value(self, faces: StepFaces) -> float:
        """Return the value of the functional."""
        return float(self.high @ faces.high.parameters + self.low @ faces.low.parameters)

    def scatter(self, faces: StepFaces) -> Scatter:
        """Return its uncertainty from the errors of both faces."""
        return Scatter.joined(faces.high.scatter(self.high), faces.low.scatter(self.low))

    def pixel_noise_um(self, reading: MeasurementContext, faces: StepFaces) -> float:
        """Return its uncertainty from the noise of the pixels of both faces; regions err independently."""
        sums = (*faces.high.sums(self.high), *faces.low.sums(self.low))
        return math.hypot(*(pixel_noise_um(reading, heights) for heights in sums))

    def minus(self, other: LinearFunctional) -> LinearFunctional:
        """Return the difference of two functionals."""
        return LinearFunctional(self.high - other.high, self.low - other.low)


def gradients(faces: StepFaces, definition: StepDefinition) -> LinearFunctional:
    """Return the functional of h for a definition."""
    return DEFINITIONS[definition](faces)


def tilts(faces: StepFaces) -> tuple[LinearFunctional, LinearFunctional]:
    """Return the slopes along x and along y of the upper face relative to the lower one."""
    along_x, along_y = (np.array(axis) for axis in TILTS)
    return LinearFunctional(along_x, -along_x), LinearFunctional(along_y, -along_y)


def _common_plane(faces: StepFaces) -> LinearFunctional:
    """Return h by least squares of z = a x + b y + c + h [upper]; wider faces weigh more in the common slopes."""
    high, low = _width(faces.high), _width(faces.low)
    share = np.linalg.solve(high + low, high)
    slopes = faces.apart_um @ share, faces.apart_um @ (np.eye(2) - share)
    return LinearFunctional(np.array([*-slopes[0], 1.0]), np.array([*-slopes[1], -1.0]))


def _upper_face(faces: StepFaces) -> LinearFunctional:
    return LinearFunctional(np.array([*-faces.apart_um, 1.0]), np.array([0.0, 0.0, -1.0]))


def _lower_face(faces: StepFaces) -> LinearFunctional:
    return LinearFunctional(np.array([0.0, 0.0, 1.0]), np.array([*-faces.apart_um, -1.0]))


def _joint(faces: StepFaces) -> LinearFunctional:
    from_high, from_low = (
        faces.joint_um - np.array([face.plane.x_um, face.plane.y_um]) for face in (faces.high, faces.low)
    )
    return LinearFunctional(np.array([*from_high, 1.0]), np.array([*-from_low, -1.0]))


DEFINITIONS: dict[StepDefinition, Callable[[StepFaces], LinearFunctional]] = {
    "common_plane": _common_plane,
    "upper_face": _upper_face,
    "lower_face": _lower_face,
    "joint": _joint,
}
SENTENCES: dict[StepDefinition, str] = {
    "common_plane": "Offset between the regions over one plane fitted to both: z = a x + b y + c + h [upper].",
    "upper_face": "Upper face over the middle of the lower region, levelled to the upper face.",
    "lower_face": "Middle of the upper region over the lower face, levelled to the lower face.",
    "joint": "Both faces extended to the middle between the regions.",
}
"""Description of each definition in results."""


def _width(face: Face) -> Floats:
    """Return the sums of squares and products of x and y about the centre, [2, 2]."""
    design = face.design[:, :2]
    return design.T @ design


def _along(face: Face, start: Floats, along: Floats) -> Floats:
    return (face.points.x_um - start[0]) * along[0] + (face.points.y_um - start[1]) * along[1]


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


def pose_sensitivities(faces: StepFaces, functional: LinearFunctional) -> PoseSensitivities:
    """Return the sensitivity coefficients of a linear functional of two faces, at the centres of tiles."""
    pairs = zip(_weights(faces.high, functional.high), _weights(faces.low, functional.low), strict=True)
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
    means = Tiles.of(face.points, columns, face.part).means
    return means[:, 0], means[:, 1], gradient @ np.linalg.pinv(means[:, 2:])


def _field_of(poses: Poses, x_um: Floats, y_um: Floats) -> NDArray[np.intp]:
    """Return the field whose centre is nearest to each place, relative to the field size."""
    from scipy.spatial import KDTree

    placed = np.flatnonzero(~poses.left_out)
    size = np.array(poses.form.field_size_um)
    middles = np.column_stack([poses.x_um[placed], poses.y_um[placed]]) / size
    _, nearest = KDTree(middles).query(np.column_stack([x_um, y_um]) / size, p=np.inf)
    return placed[nearest]


def _nearest(poses: Poses, x_um: float, y_um: float) -> NDArray[np.intp]:
    return np.sort(np.argsort(np.hypot(poses.x_um - x_um, poses.y_um - y_um), kind="stable")[:MOST_FIELDS])


def _information(poses: Poses, some: NDArray[np.intp]) -> Floats:
    """Return the inverse covariance of (height, slope x, slope y) of some fields, from stage and overlaps."""
    n, seams = len(some), poses.seams
    information = np.diag(np.tile([poses.z_error_um**-2.0, TILT_ERROR**-2.0, TILT_ERROR**-2.0], n))
    place = np.full(len(poses.x_um), -1)
    place[some] = np.arange(n)
    tells = (seams.weight > 0) & np.isfinite(seams.mid_x_um) & (seams.information[:, 0, 0] > 0)
    for k in np.flatnonzero(tells & (place[seams.first] >= 0) & (place[seams.second] >= 0)):
        a, b = int(seams.first[k]), int(seams.second[k])
        arms = (_at(poses, field, float(seams.mid_x_um[k]), float(seams.mid_y_um[k])) for field in (a, b))
        difference = np.concatenate([sign * arm for sign, arm in zip((-1, 1), arms, strict=True)], axis=1)
        rows = np.concatenate([3 * place[field] + np.arange(3) for field in (a, b)])
        information[np.ix_(rows, rows)] += seams.weight[k] * difference.T @ seams.information[k] @ difference
    return information


def _at(poses: Poses, field: int, x_um: float, y_um: float) -> Floats:
    """Return the matrix [3, 3] from height and slopes at a field's centre to those at a place."""
    return np.array([[1.0, x_um - poses.x_um[field], y_um - poses.y_um[field]], [0, 1, 0], [0, 0, 1]])


WHAT = "a step height"


def step_height(
    surface: Mosaic,
    upper: Regions,
    lower: Regions,
    *,
    definition: StepDefinition = "common_plane",
    conditions: Conditions = Conditions(),
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> StepHeight:
    """Measure the height of one face over another.

    Each face is one plane through one or several regions, fitted with rejection beyond 3 robust deviations.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    upper : Region or sequence of Region
        One or several regions on the upper face, in stage um.
    lower : Region or sequence of Region
        One or several regions on the lower face, in stage um.
    definition : {'common_plane', 'upper_face', 'lower_face', 'joint'}, optional
        Reference of the height: over one plane fitted to both faces, levelled to the upper or to the lower face, or
        both faces extended to the middle between the regions. Default 'common_plane'.
    conditions : Conditions, optional
        Further known contributions to the uncertainty, standard uncertainties (k = 1). Contributions that are unknown
        are listed as not evaluated. Default: none given; linearity and Abbe error are then those of the calibration,
        where it has them.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    StepHeight
        Height in um, negative when `upper` is below `lower`, with its expanded uncertainty (k = 2); also the height at
        the joint in um, the tilt between the faces in mrad, and the contributions that were not evaluated. The
        uncertainty is not evaluated where the points do not determine the scatter of a face.

    Raises
    ------
    MeasureError
        If a face has no region, or a region is a line or a point, or lies outside the surface.
    MeasureError
        If a region has fewer than 200 measured points or less than half of its area measured.
    MeasureError
        If a region overlaps another.
    MeasureError
        If the points of a face do not determine a plane.

    Notes
    -----
    The result is the distance of two planes, not of two mean heights: relief within a region, such as pads, lines or a
    second level, tilts its plane and changes the height by the tilt times the distance of the regions. Each region
    belongs on ground of one level; regions on both sides of the other face make the height insensitive to tilt.

    Where faces are tilted against each other the definition of the height is part of the result, so the values of the
    other definitions are reported with it, in its notes, and with a common plane U reaches both of them. Uncertainties
    are expressed as in the GUM [1]_.

    References
    ----------
    .. [1] JCGM 100:2008, Evaluation of measurement data - Guide to the expression of uncertainty in measurement (GUM).
    """
    require_choice("definition", definition, StepDefinition, MeasureError)
    uppers, lowers = as_region_tuple(upper, "upper"), as_region_tuple(lower, "lower")
    reading, level = MeasurementContext.of(surface, layer, calibration_valid), level_for(surface, *uppers, *lowers)
    above, below = (
        [_points(reading, region, level, f"{which} region") for region in regions]
        for which, regions in (("upper", uppers), ("lower", lowers))
    )
    _require_apart((*uppers, *lowers), (*above, *below))
    faces = StepFaces(face_of(reading, level, *above), face_of(reading, level, *below))
    h = gradients(faces, definition)
    budget = _budget(reading, level, faces, h, definition, conditions)
    shade = _in_the_shade(faces, h.value(faces), reading.surface.provenance.calibration)
    tilt = _tilt(reading, faces)
    notes = (
        *_other_definitions(faces),
        *_tilted_faces(budget, tilt),
        *shade,
        *dict.fromkeys((*faces.high.notes, *faces.low.notes)),
    )
    return StepHeight(
        **reading.result_fields(name, level, *notes, *reading.not_in_budget(own=True)),
        upper=uppers[0],
        lower=lowers[0],
        also_upper=uppers[1:],
        also_lower=lowers[1:],
        height=reading.length(h.value(faces), budget and budget.lines),
        definition=SENTENCES[definition],
        options=StepOptions(definition=definition, conditions=conditions),
        at_joint=_at_joint(reading, level, faces, conditions),
        tilt=tilt,
        relative_tilt_mrad=_tilt_mrad(faces),
        upper_mean_um=faces.high.mean_um,
        lower_mean_um=faces.low.mean_um,
        upper_sq_um=faces.high.sq_um,
        lower_sq_um=faces.low.sq_um,
        upper_points=len(faces.high.points),
        lower_points=len(faces.low.points),
        not_evaluated=budget.not_evaluated if budget is not None else (),
    )


def _points(reading: MeasurementContext, region: Region, level: int, which: str) -> HeightSamples:
    require_area(region, which.removesuffix(" region"))
    points = enough_points(reading.surface, region, reading.layer, level, which, WHAT)
    require_measured(region, len(points) * (reading.surface.pixel_um * 2**level) ** 2, which, WHAT)
    return points


def _require_apart(regions: Sequence[Region], points: Sequence[HeightSamples]) -> None:
    for k, region in enumerate(regions):
        for others in points[k + 1 :]:
            if shared := int(np.count_nonzero(region.contains(others.x_um, others.y_um))):
                raise MeasureError(
                    f"The two regions share {shared} points: move them apart, each onto one face of the step."
                )


def _budget(
    reading: MeasurementContext,
    level: int,
    faces: StepFaces,
    h: LinearFunctional,
    definition: StepDefinition,
    conditions: Conditions,
) -> Budget | None:
    """Return the budget; None where there is no calibration."""
    if not reading.calibrated:
        return None
    of_points = {
        NOISE: noise_um(h.scatter(faces), 0.0 if level else h.pixel_noise_um(reading, faces)),
        LEVELLING: _levelling_um(faces, h) if definition == "common_plane" else 0.0,
        POSES: poses_u_um(reading.surface, pose_sensitivities(faces, h)),
    }
    if (between_um := _between_frames_um(reading, faces, h)) is not None:
        of_points[INTERPOLATION] = between_um
    return step_budget(h.value(faces), of_points, conditions, reading.surface.provenance)


def _between_frames_um(reading: MeasurementContext, faces: StepFaces, h: LinearFunctional) -> float | None:
    """Return the uncertainty of h due to interpolation between frames; None where heights are not over the frames."""
    if levelling_of(reading.surface).by != "stage":
        return None
    sums = [
        (WeightedHeights.of_fit(face.points, face.design, gradient).weight, face.points.z_um)
        for face, gradient in ((faces.high, h.high), (faces.low, h.low))
    ]
    return between_frames_um(reading.surface.provenance, *sums)


def _levelling_um(faces: StepFaces, h: LinearFunctional) -> float:
    """Return the standard uncertainty of levelling: h may be anywhere between its heights levelled to either face.

    They bound a uniform distribution; its deviation is from h, which lies nearer to the height over the wider face. The
    part of their distance that is noise has its own line.
    """
    over_upper, over_lower = gradients(faces, "upper_face"), gradients(faces, "lower_face")
    from_upper_um, from_lower_um = over_upper.minus(h).value(faces), over_lower.minus(h).value(faces)
    apart = over_lower.minus(over_upper)
    by_noise_um = apart.scatter(faces).expanded
    tilted = 1 - (by_noise_um / max(abs(apart.value(faces)), by_noise_um, 1e-12)) ** 2
    return math.sqrt(tilted * (from_upper_um**2 + from_upper_um * from_lower_um + from_lower_um**2) / 3)


def _at_joint(reading: MeasurementContext, level: int, faces: StepFaces, conditions: Conditions) -> Length:
    at_joint = gradients(faces, "joint")
    budget = _budget(reading, level, faces, at_joint, "joint", conditions)
    return reading.length(at_joint.value(faces), budget and budget.lines)


def _tilt_mrad(faces: StepFaces) -> float:
    return 1e3 * math.hypot(*(slope.value(faces) for slope in tilts(faces)))


def _tilt(reading: MeasurementContext, faces: StepFaces) -> Quantity:
    """Return the tilt between the faces, with the largest uncertainty over directions: near 0 it has no direction."""
    lines: Lines | None = None
    if reading.calibrated:
        poses = [poses_u_um(reading.surface, pose_sensitivities(faces, slope)) for slope in tilts(faces)]
        lines = {
            NOISE: Scatter.largest(slope.scatter(faces) for slope in tilts(faces)).times(1e3),
            "z scale": reading.u_z_scale * _tilt_mrad(faces),
            PIXEL_SCALE: reading.u_pixel_scale * _tilt_mrad(faces),
            **({POSES: 1e3 * max(u for u in poses if u is not None)} if None not in poses else {}),
        }
    return reading.quantity(_tilt_mrad(faces), "mrad", lines)


def _other_definitions(faces: StepFaces) -> tuple[str, ...]:
    over_upper, over_lower, at_joint = (
        gradients(faces, definition).value(faces) for definition in ("upper_face", "lower_face", "joint")
    )
    place = "({}, {}) um".format(*(_tenths(along) for along in faces.joint_um))
    return (
        f"Levelled to the upper face: {over_upper:.3f} um, to the lower: {over_lower:.3f} um.",
        f"Both faces extended to the middle between the regions, {place}: {at_joint:.3f} um.",
    )


def _tilted_faces(budget: Budget | None, tilt: Quantity) -> tuple[str, ...]:
    """Return a note where levelling is most of U: parallel faces look tilted if a region holds several levels."""
    lines = dict(budget.lines) if budget is not None else {}
    levelling_um = combined([lines.pop(LEVELLING, 0.0)])
    if levelling_um <= combined(lines.values()):
        return ()
    return (
        f"Most of U is levelling: the faces are tilted by {tilt.value:.1f} mrad against each other. If they should be "
        "parallel, pads, lines or bow tilt one of them: draw each region on ground of one level, or several regions "
        "round the other face.",
    )


def _in_the_shade(faces: StepFaces, height_um: float, calibration: Calibration | None) -> tuple[str, ...]:
    """Return a note where the wall between the faces hides part of the aperture from the lower region."""
    reach_um, between_um = shaded_um(height_um, calibration), faces.between_um
    if not 0 <= between_um < reach_um:
        return ()
    lower = "lower" if height_um > 0 else "upper"
    return (
        f"The {lower} region begins at most {_tenths(between_um)} um from the wall, which hides part of the aperture "
        f"out to {_tenths(reach_um)} um: heights there may be off by more than U. Move the region further away.",
    )


def _tenths(value: float) -> str:
    """Format with one decimal, without a minus before zero."""
    return f"{round(float(value), 1) + 0.0:.1f}"
