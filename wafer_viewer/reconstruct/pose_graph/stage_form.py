"""Second-degree form terms: those shared by all fields, and those that only the stage determines."""

from __future__ import annotations

import numpy as np

from wafer_viewer.model.surface.field_poses import Numbers

FORM_TERMS = ("height", "tilt along x", "tilt along y", "bow", "twist", "saddle")

_UNKNOWN_UM = 1e4
"""Uncertainties above this are reported as infinite: a single row does not determine its cross tilt."""

_RIDGE = 1e-12
"""Relative ridge on the diagonal; collinear terms would otherwise be separated by rounding errors."""

Arms = tuple[Numbers, Numbers]


def sag_between(first: Arms, second: Arms, field_size_um: tuple[float, float]) -> Numbers:
    """Return the plane (height, slopes) [e, 3, 3] at seam midpoints for each term of a shared sag.

    first, second: from the centres of the two fields to the midpoint. The difference of two equal parabolas side by
    side is exactly a plane.
    """
    half_x, half_y = field_size_um[0] / 2, field_size_um[1] / 2
    (ax, ay), (bx, by) = first, second
    zero = np.zeros_like(ax)
    xx = np.column_stack((bx**2 - ax**2, 2 * (bx - ax), zero)) / half_x**2
    xy = np.column_stack((bx * by - ax * ay, by - ay, bx - ax)) / (half_x * half_y)
    yy = np.column_stack((by**2 - ay**2, zero, 2 * (by - ay))) / half_y**2
    return np.stack((xx, xy, yy), axis=-1)


def uncertainty_of_form(
    x_um: Numbers, y_um: Numbers, z_error_um: float, tilt_error: float, lean: float
) -> tuple[float, ...]:
    """Return expanded uncertainties (k = 2) of `FORM_TERMS` at the rim of fields at (x_um, y_um), by the stage alone.

    z_error_um, tilt_error: independent errors of each field; lean: standard deviation of the tilt that all fields
    share.
    """
    if len(x_um) < 2:
        return (2 * z_error_um, *[float("inf")] * 5)
    x, y = x_um - x_um.mean(), y_um - y_um.mean()
    rim_um = float(np.hypot(x, y).max())
    x, y, one, zero = x / rim_um, y / rim_um, np.ones_like(x_um), np.zeros_like(x_um)
    height = np.column_stack((one, x, y, x**2 + y**2, 2 * x * y, x**2 - y**2, zero, zero))
    along_x = np.column_stack((zero, one, zero, 2 * x, 2 * y, 2 * x, -one, zero)) / rim_um
    along_y = np.column_stack((zero, zero, one, 2 * y, 2 * x, -2 * y, zero, -one)) / rim_um
    told = height.T @ height / z_error_um**2 + (along_x.T @ along_x + along_y.T @ along_y) / tilt_error**2
    before = np.array([10 * _UNKNOWN_UM] * 6 + [lean * rim_um] * 2)
    told += np.diag(before**-2.0)
    scale = 1 / np.sqrt(np.diag(told))
    covariance = scale[:, None] * np.linalg.inv(told * scale[:, None] * scale + _RIDGE * np.eye(8)) * scale
    u_um = 2 * np.sqrt(np.diag(covariance)[:6])
    return tuple(float(u) if u < _UNKNOWN_UM else float("inf") for u in u_um)
