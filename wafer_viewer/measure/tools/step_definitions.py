"""Definitions of a step height: reference position and levelling of its two face planes.

The distance between tilted faces depends on the place, so the definition of h belongs to the result. Each definition is
a pair of gradients: h is their product with (slope x, slope y, height at the centre) of the upper and of the lower
face.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.plane_faces import Face
from wafer_viewer.measure.base.tile_statistics import Scatter
from wafer_viewer.model.measurement.tool_options import StepDefinition

TILTS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


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
        start, way = np.array([self.low.plane.x_um, self.low.plane.y_um]), self.apart_um
        length = float(np.hypot(*way))
        along = way / length if length > 0 else way
        last_low = float(_along(self.low, start, along).max())
        first_high = float(_along(self.high, start, along).min())
        return start + along * ((last_low + first_high if last_low <= first_high else length) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class LinearFunctional:
    """Linear functional of two faces: gradients [3] times the parameters of the upper and the lower one."""

    high: Floats
    low: Floats

    def value(self, faces: StepFaces) -> float:
        """Return the value of the functional."""
        return float(self.high @ faces.high.parameters + self.low @ faces.low.parameters)

    def scatter(self, faces: StepFaces) -> Scatter | None:
        """Return its uncertainty from the scatter of tiles; None where a face has too few of them."""
        high, low = faces.high.scatter(self.high), faces.low.scatter(self.low)
        return None if high is None or low is None else Scatter.joined(high, low)

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
