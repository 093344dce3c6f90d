"""Drift within overlaps, pooled over a scan.

Parts of a picture that come from different frames are displaced against each other. A single overlap holds few such
parts: the variance that it shows has as few degrees of freedom as two, and is often far too small by chance. How far
parts are displaced is a property of the scan, which its overlaps share.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wafer_viewer.model.surface.field_poses import Numbers, RejectionReason, Shifts
from wafer_viewer.numerics.block_gradients import variance_per_drift

ALIKE_FREEDOM = 6.0
"""Weight of the drift of the scan in that of an overlap, in degrees of freedom; overlaps differ beyond chance."""


def with_own_drift(shifts: Shifts) -> Shifts:
    """Return shifts with the uncertainties that each overlap shows by itself."""
    return _with_drift(shifts, np.maximum(shifts.drift[:, 2:4], 0.0))


def with_pooled_drift(shifts: Shifts) -> Shifts:
    """Return shifts with uncertainties in which the drift of an overlap is shrunk towards that of all of them.

    That of the scan comes from the median of those not rejected, since a wrong overlap may show any drift; that of few
    is widened, as it may be too small by chance. An overlap that shows less than none, by chance, counts so. It
    replaces that of an earlier pooling. Where the drift is unknown, as along lines, the uncertainty stays as it is.
    """
    sound = np.isin(shifts.doubt, (RejectionReason.NONE, RejectionReason.DISAGREES))
    told = shifts.drift[sound & np.isfinite(shifts.drift).all(axis=1)]
    if not len(told):
        return shifts
    usual_um2 = np.maximum(np.median(told[:, 2:4] / _median_of_chi2(told[:, 4:]), axis=0), 0.0)
    of_scan_um2 = usual_um2 * (1 + 2 / told[:, 4].sum())
    own_um2, freedom = shifts.drift[:, 2:4], shifts.drift[:, 4:]
    shrunk_um2 = (freedom * own_um2 + ALIKE_FREEDOM * of_scan_um2) / (freedom + ALIKE_FREEDOM)
    return _with_drift(shifts, np.maximum(shrunk_um2, 0.0))


def _median_of_chi2(freedom: Numbers) -> Numbers:
    """Return the median of a variance with some degrees of freedom, relative to its mean.

    By E. B. Wilson, M. M. Hilferty, Proc. Natl. Acad. Sci. 17 (1931) 684.
    """
    return (1 - 2 / (9 * freedom)) ** 3


def _with_drift(shifts: Shifts, drift_um2: Numbers) -> Shifts:
    """Return shifts with uncertainties for a variance of the shifts of parts along x and y, [n, 2]."""
    known = np.isfinite(shifts.drift).all(axis=1)
    variance_um2 = shifts.drift[:, :2] + variance_per_drift(shifts.drift[:, 4:]) * drift_um2
    u_um = np.sqrt(np.maximum(variance_um2, 0.0))
    return replace(
        shifts, u_x_um=np.where(known, u_um[:, 0], shifts.u_x_um), u_y_um=np.where(known, u_um[:, 1], shifts.u_y_um)
    )
