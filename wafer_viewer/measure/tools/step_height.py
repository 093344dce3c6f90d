"""Step height between two faces, with its uncertainty budget.

Each face is one plane through one or several regions, fitted with rejection beyond 3 robust deviations. Where faces are
tilted against each other the definition of h is part of the result, so the values of other definitions are reported
with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wafer_viewer.measure.base.height_samples import HeightSamples, Layer, level_for, require_area
from wafer_viewer.measure.base.measurement_context import Lines, MeasurementContext
from wafer_viewer.measure.base.plane_faces import enough_points, face_of
from wafer_viewer.measure.base.region_samples import Regions, as_region_tuple, require_measured
from wafer_viewer.measure.base.uncertainty_budget import LEVELLING, NOISE, POSES, Budget, step_budget
from wafer_viewer.measure.tools.pose_uncertainty import pose_sensitivities, poses_u_um
from wafer_viewer.measure.tools.step_definitions import SENTENCES, LinearFunctional, StepFaces, gradients, tilts
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.step import StepHeight
from wafer_viewer.model.measurement.tool_options import StepDefinition, StepOptions
from wafer_viewer.model.measurement.uncertainty_conditions import Conditions
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

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
    Where faces are tilted against each other the definition of the height is part of the result, so the values of the
    other definitions are reported with it, in its notes. Uncertainties are expressed as in the GUM [1]_.

    References
    ----------
    .. [1] JCGM 100:2008, Evaluation of measurement data - Guide to the expression of uncertainty in measurement (GUM).
    """
    uppers, lowers = as_region_tuple(upper, "upper"), as_region_tuple(lower, "lower")
    reading, level = MeasurementContext.of(surface, layer, calibration_valid), level_for(surface, *uppers, *lowers)
    above, below = (
        [_points(reading, region, level, f"{which} region") for region in regions]
        for which, regions in (("upper", uppers), ("lower", lowers))
    )
    _require_apart((*uppers, *lowers), (*above, *below))
    faces = StepFaces(face_of(*above), face_of(*below))
    h = gradients(faces, definition)
    budget = _budget(reading, faces, h, definition, conditions)
    return StepHeight(
        **reading.told(name, level, *_other_definitions(faces), *reading.not_in_budget(own=True)),
        upper=uppers[0],
        lower=lowers[0],
        also_upper=uppers[1:],
        also_lower=lowers[1:],
        height=reading.length(h.value(faces), budget and budget.lines),
        definition=SENTENCES[definition],
        options=StepOptions(definition=definition, conditions=conditions),
        at_joint=_at_joint(reading, faces, conditions),
        tilt=_tilt(reading, faces),
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
    faces: StepFaces,
    h: LinearFunctional,
    definition: StepDefinition,
    conditions: Conditions,
) -> Budget | None:
    """Return the budget; None where there is no calibration, or the scatter is unknown."""
    noise = h.scatter(faces) if reading.calibrated else None
    if noise is None:
        return None
    of_points = {
        NOISE: noise.widened,
        LEVELLING: _levelling_um(faces) if definition == "common_plane" else 0.0,
        POSES: poses_u_um(reading.surface, pose_sensitivities(faces, h)),
    }
    return step_budget(h.value(faces), of_points, conditions, reading.surface.provenance)


def _levelling_um(faces: StepFaces) -> float:
    """Return the standard uncertainty of levelling: the change of h between the two faces, less its noise.

    The change is taken as the full width of a uniform distribution. The noise of the two is in its own line.
    """
    differ = gradients(faces, "lower_face").minus(gradients(faces, "upper_face"))
    scatter = differ.scatter(faces)
    by_noise_um = 2 * scatter.widened if scatter is not None else 0.0
    return math.sqrt(max(0.0, differ.value(faces) ** 2 - by_noise_um**2) / 12)


def _at_joint(reading: MeasurementContext, faces: StepFaces, conditions: Conditions) -> Length:
    at_joint = gradients(faces, "joint")
    budget = _budget(reading, faces, at_joint, "joint", conditions)
    return reading.length(at_joint.value(faces), budget and budget.lines)


def _tilt_mrad(faces: StepFaces) -> float:
    return 1e3 * math.hypot(*(slope.value(faces) for slope in tilts(faces)))


def _tilt(reading: MeasurementContext, faces: StepFaces) -> Quantity:
    """Return the tilt between the faces, with the largest uncertainty over directions: near 0 it has no direction."""
    lines: Lines | None = None
    found = [slope.scatter(faces) for slope in tilts(faces)] if reading.calibrated else [None]
    if None not in found:
        poses = [poses_u_um(reading.surface, pose_sensitivities(faces, slope)) for slope in tilts(faces)]
        lines = {
            NOISE: 1e3 * max(scatter.widened for scatter in found if scatter is not None),
            "z scale": reading.u_z_scale * _tilt_mrad(faces),
            "pixel scale": reading.u_pixel_scale * _tilt_mrad(faces),
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


def _tenths(value: float) -> str:
    """Format with one decimal, without a minus before zero."""
    return f"{round(float(value), 1) + 0.0:.1f}"
