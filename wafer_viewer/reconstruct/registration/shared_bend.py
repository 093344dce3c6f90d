"""Bends that all overlaps share, and the distortion of the lens that they show.

The contents of two fields lie at one offset over their overlap, unless they are turned, belong to other samples, or the
lens or the scan distorts. That distorts all overlaps of one direction alike: the median of their bends is taken off
before they are judged.

A distortion of the third order moves a point at p from the middle of a field by k p |p|^2. Two fields d apart that
overlap around the middle between them then differ, at m from there, by k (2 m (m . d) + d (|m|^2 + |d|^2 / 4)): a
curvature along the overlap, which shows k, and an offset on average, by which neighbours seem too far apart or too
close. The curvature needs no stage. Terms of the second order, as of a camera that is tilted, bend overlaps linearly
and have no offset. A lens whose axis is off the middle has both, and another pixel size in the middle, along each
direction: overlaps cannot tell that from the scales of the stage.

Without a calibration, the pixel size is that in the middle of a field. A calibrated one compares borders of fields that
are a fraction of a field apart, so that it holds the offset of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import PIXEL_STEP_FRACTION
from wafer_viewer.model.quantity import coverage_factor
from wafer_viewer.model.surface.field_poses import Numbers, RejectionReason, Shifts
from wafer_viewer.model.surface.height_map import Outline
from wafer_viewer.numerics.block_sums import REACH
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.registration.picture_match import MATCH_ACCEPTANCE, is_bent

LEAST_ALIKE = 6
"""Smallest number of overlaps of one direction from which a shared bend is estimated."""
SIGNIFICANT = 4.0
"""Smallest shared bend or distortion that counts, in standard uncertainties."""
WORTH_PX = 0.02
"""Smallest offset of neighbours by the distortion that is taken off: what registration knows."""
MODEL_SHARE = 0.05
"""Standard uncertainty of a distortion by the model, relative; grids drawn with 0.2 % showed 0.94 to 0.99 of it."""
_MEDIAN_U = 1.25
"""Standard uncertainty of a median, relative to that of a mean."""
_SAME_LENS = 0.2
"""Relative difference of the distortions along rows and along columns up to which they are those of a lens."""
_LINEAR, _CURVED = slice(0, 4), slice(4, 6)
"""Columns of `Shifts.bend`: (down, right) along rows and along columns, and the curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedBend:
    """Common part of the bends of overlaps, and the distortion of the lens.

    centres_px: of the fields by the stage, (down, right), [n, 2]; shape: of a field; usual, scatter: median bend and
    its standard deviation among overlaps beside each other and among those below each other, [2, 6] in px, 0 where it
    is not significant; kappa, u_kappa: k in 1/px^2, 0 without a significant distortion.
    """

    centres_px: Numbers
    shape: tuple[int, int]
    usual: Numbers
    scatter: Numbers
    kappa: float
    u_kappa: float

    @classmethod
    def of(cls, shifts: Shifts, outlines: Sequence[Outline]) -> SharedBend:
        """Estimate the bend that the overlaps of fields share."""
        table = np.array([(-o.y0_um / o.pixel_um, o.x0_um / o.pixel_um, *o.shape) for o in outlines]).reshape(-1, 4)
        rows, cols = outlines[0].shape if len(outlines) else (1, 1)
        none = cls(table[:, :2] + (table[:, 2:] - 1) / 2, (rows, cols), np.zeros((2, 6)), np.zeros((2, 6)), 0.0, np.inf)
        apart, beside, sign = none._apart(shifts)
        unbent = shifts.bend[:, -1] == RejectionReason.NONE
        sound = np.isin(shifts.doubt, (RejectionReason.NONE, RejectionReason.DISAGREES, RejectionReason.UNLIKE))
        known = sound & unbent & np.isfinite(shifts.bend).all(axis=1)
        own, own_u = sign[:, None] * shifts.bend[:, :6], shifts.bend[:, 6:12]
        medians = [_median(own[known & some], own_u[known & some]) for some in (beside, ~beside)]
        usual, scatter, u = (np.stack([m[k] for m in medians]) for k in range(3))
        along = np.arange(len(own)), np.where(beside, 5, 4)
        per_px = none._curvature(apart, beside)
        curved, u_curved = (own[along] / per_px)[:, None], (own_u[along] / per_px)[:, None]
        kappa, u_kappa = _of_lens([_median(curved[known & some], u_curved[known & some]) for some in (beside, ~beside)])
        shown = np.abs(usual) > SIGNIFICANT * u
        return replace(none, usual=np.where(shown, usual, 0.0), scatter=scatter, kappa=kappa, u_kappa=u_kappa)

    def _apart(self, shifts: Shifts) -> tuple[Numbers, NDArray[np.bool_], Numbers]:
        """Return the distance (down, right) of the second from the first, whether beside it, and on which side."""
        apart = self.centres_px[shifts.second] - self.centres_px[shifts.first]
        beside = np.abs(apart[:, 1]) * self.shape[0] > np.abs(apart[:, 0]) * self.shape[1]
        return apart, beside, np.where(np.where(beside, apart[:, 1], apart[:, 0]) < 0, -1.0, 1.0)

    def _overlap(self, apart: Numbers) -> Numbers:
        """Return the compared (rows, cols) of overlaps, [e, 2]."""
        return np.maximum(np.array(self.shape) - np.abs(apart) - 2 * REACH, 1.0)

    def _curvature(self, apart: Numbers, beside: NDArray[np.bool_]) -> Numbers:
        """Return the curvature along an overlap for k = 1, [e]; see `bend_terms` for its unit."""
        overlap = self._overlap(apart)
        across, along = np.where(beside, np.abs(apart[:, ::-1].T), np.abs(apart.T))[0], np.where(beside, *overlap.T)
        return across * along**2 / 6

    def offset_px(self, shifts: Shifts, is_calibrated: bool) -> Numbers:
        """Return the offset (down, right) of overlaps by the distortion, [e, 2]; 0 where it is not taken off."""
        apart, _, _ = self._apart(shifts)
        stretch = self._stretch(apart)
        if is_calibrated:
            stretch = stretch - np.diag(self._stretch(PIXEL_STEP_FRACTION * np.diag(self.shape))).mean()
        off = apart * stretch
        return off if np.abs(off).max(initial=0.0) > WORTH_PX else np.zeros_like(off)

    def _stretch(self, apart: Numbers) -> Numbers:
        """Return by which fraction neighbours seem too far apart, (down, right) [e, 2]."""
        area = self._overlap(apart) ** 2 / 12
        return self.kappa * (2 * area + (area.sum(axis=1) + np.sum(apart**2, axis=1) / 4)[:, None])

    def judged(self, shifts: Shifts) -> Shifts:
        """Return the shifts, those accepted that are bent only as all of them are."""
        _, beside, sign = self._apart(shifts)
        which = np.where(beside, 0, 1)
        if np.abs(self.usual[:, _LINEAR]).max() <= MATCH_ACCEPTANCE.most_bent_px / 2:
            return shifts
        rest = np.abs(sign[:, None] * shifts.bend[:, :6] - self.usual[which])[:, _LINEAR]
        sigma = np.hypot(shifts.bend[:, 6:12], self.scatter[which])[:, _LINEAR]
        most = np.arange(len(rest)), np.nan_to_num(rest, nan=np.inf).argmax(axis=1)
        bent = is_bent(rest[most], rest[most] / sigma[most])
        mended = (shifts.doubt == RejectionReason.UNLIKE) & ~bent & np.isfinite(shifts.bend).all(axis=1)
        doubt = np.where(mended, np.nan_to_num(shifts.bend[:, -1]), shifts.doubt).astype(np.uint8)
        return replace(shifts, doubt=doubt, weight=(doubt == RejectionReason.NONE).astype(np.float32))

    def notes(self, shifts: Shifts, is_calibrated: bool) -> tuple[str, ...]:
        """Return a sentence on the distortion, if there is any."""
        corner_px = float(np.hypot(*self.shape)) / 2
        share, u = 100 * self.kappa * corner_px**2, 200 * self.u_kappa * corner_px**2
        bent_px = np.abs(self.usual[:, _LINEAR]).max()
        parts: list[str] = []
        if self.offset_px(shifts, is_calibrated).any():
            seam_px = np.abs(self.offset_px(shifts, False)).max()
            parts.append(
                f"corners of a field lie {abs(share):.2g} % ({abs(share) / 100 * corner_px:.2g} px) too far "
                f"{'out' if share > 0 else 'in'} (U = {u:.1g} %, k = 2); places of fields are corrected for it, "
                f"images are not, and differ by {seam_px:.2g} px in overlaps"
            )
        if bent_px > MATCH_ACCEPTANCE.most_bent_px / 2:
            parts.append(f"overlaps are bent alike, by {bent_px:.2g} px at their ends, and are accepted all the same")
        return (f"The lens or the scan distorts: {'; '.join(parts)}.",) if parts else ()


def _median(values: Numbers, u: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Return the median of columns [n, k], their scatter, and the uncertainty of the median; infinite for few.

    u: uncertainties of the values. A few of them may be alike by chance: the scatter is not trusted below these.
    """
    n, k = values.shape
    if n < LEAST_ALIKE:
        return np.zeros(k), np.zeros(k), np.full(k, np.inf)
    middle = np.median(values, axis=0)
    scatter = MAD_TO_SIGMA * np.median(np.abs(values - middle), axis=0)
    widened = _MEDIAN_U * coverage_factor(n - 1) / 2 / np.sqrt(n)
    return middle, scatter, widened * np.maximum(scatter, np.median(u, axis=0))


def _of_lens(found: Sequence[tuple[Numbers, Numbers, Numbers]]) -> tuple[float, float]:
    """Return k and its uncertainty from both directions; 0 where it is not significant, or they contradict."""
    values, u = np.array([f[0][0] for f in found]), np.array([max(f[2][0], 1e-30) for f in found])
    weight = u**-2.0
    if not weight.any():
        return 0.0, np.inf
    mean = float(weight @ values / weight.sum())
    u_mean = float(np.hypot(weight.sum() ** -0.5, MODEL_SHARE * mean))
    known = np.isfinite(u)
    same = not known.all() or abs(values[1] - values[0]) < SIGNIFICANT * np.hypot(*u) + _SAME_LENS * abs(mean)
    return (mean, u_mean) if same and abs(mean) > SIGNIFICANT * u_mean else (0.0, u_mean)
