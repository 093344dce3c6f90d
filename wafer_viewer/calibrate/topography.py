"""Metrological characteristics of measured heights: noise, flatness deviation, amplification and linearity.

The characteristics are those of ISO 25178-600 and the procedures follow ISO 25178-700: noise from the differences of
repeated measurements of one place, flatness deviation from the mean over several places of a flat, and amplification
and linearity from steps of certified height.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.calibrate.pixel_scale import Estimate
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.numerics.normal_statistics import student, u_of_mean

Heights = NDArray[np.float32]
LEAST_REPEATS = 3
"""Fewest repeats for the noise: two differences."""
LEAST_PLACES = 4
"""Fewest places for the flatness deviation."""
LEAST_MEASURED = 0.5
"""Smallest fraction of a field that must be measured."""
LEAST_SHARE = 0.75
"""Smallest fraction of the places at which a block must be measured to count."""
BLOCKS = 16
"""Blocks along the longer side of a field over which heights are averaged before the flatness deviation: an S-filter
that leaves the form of the field and removes texture and noise."""


@dataclass(frozen=True, slots=True)
class StepPair:
    """Measured and certified height of one step in um, with standard uncertainties (k = 1)."""

    measured_um: Estimate
    certified_um: Estimate


@dataclass(frozen=True, slots=True)
class ScaleResponse:
    """Amplification coefficient of z; deviation from linearity in um, None with steps of a single height."""

    amplification: Estimate
    linearity_um: Estimate | None


def measurement_noise_um(maps: Sequence[Heights]) -> Estimate:
    """Return the measurement noise N_M by the difference method.

    Parameters
    ----------
    maps : sequence of float32 [row, col]
        Heights in um of repeated scans of one place, NaN where not measured; at least three.

    Returns
    -------
    Estimate
        Root mean square noise of a single map in um.

    Raises
    ------
    MeasureError
        With too few maps, or where less than half of the field is measured.

    Notes
    -----
    Each difference of two successive maps is levelled; its root mean square height is sqrt(2) times the noise.

    References
    ----------
    .. [1] ISO 25178-700:2022, Geometrical product specifications (GPS) - Surface texture: Areal - Calibration,
       adjustment and verification of areal topography measuring instruments.
    """
    if len(maps) < LEAST_REPEATS:
        raise MeasureError(f"The noise takes {LEAST_REPEATS} repeats; there are {len(maps)}.")
    variances = np.array([float(np.nanmean(_levelled(b - a) ** 2)) / 2 for a, b in pairwise(maps)])
    value = math.sqrt(float(variances.mean()))
    u_variance = float(u_of_mean(variances))
    return Estimate(value, u_variance / (2 * value) if value > 0 else 0.0)


def flatness_deviation_um(maps: Sequence[Heights]) -> Estimate:
    """Return the flatness deviation z_FLT: the height range of the mean over several places of a flat.

    Parameters
    ----------
    maps : sequence of float32 [row, col]
        Heights in um at different places of a flat, NaN where not measured; at least four.

    Returns
    -------
    Estimate
        Flatness deviation in um; its uncertainty is the scatter of the maps at the highest and the lowest place.

    Raises
    ------
    MeasureError
        With too few maps, or where less than half of the field is measured.

    Notes
    -----
    Each map is averaged over blocks and levelled by a plane, so that the form of the instrument remains and the texture
    of the flat averages out.

    References
    ----------
    .. [1] ISO 25178-700:2022.
    """
    if len(maps) < LEAST_PLACES:
        raise MeasureError(f"The flatness deviation takes {LEAST_PLACES} places; there are {len(maps)}.")
    stack = np.stack([_levelled(_block_means(one)) for one in maps])
    count = np.isfinite(stack).sum(axis=0)
    known = count >= LEAST_SHARE * len(maps)
    if known.mean() < LEAST_MEASURED:
        raise _unmeasured()
    of_block = stack[:, known]
    mean = np.nanmean(of_block, axis=0)
    scatter = np.nanstd(of_block, axis=0, ddof=1) / np.sqrt(count[known])
    high, low = int(mean.argmax()), int(mean.argmin())
    wide = student(LEAST_SHARE * len(maps) - 1) / 2
    return Estimate(float(mean[high] - mean[low]), wide * float(math.hypot(scatter[high], scatter[low])))


def scale_response(steps: Sequence[StepPair]) -> ScaleResponse:
    """Return the amplification coefficient and the linearity deviation from certified steps.

    Parameters
    ----------
    steps : sequence of StepPair
        Measured steps; a step of zero is measured as zero.

    Returns
    -------
    ScaleResponse
        Slope of the line through zero, weighted by the uncertainties, and the largest deviation from it.

    Raises
    ------
    MeasureError
        Without a step.

    References
    ----------
    .. [1] ISO 25178-600:2019, Geometrical product specifications (GPS) - Surface texture: Areal - Metrological
       characteristics for areal topography measuring methods.
    """
    if not steps:
        raise MeasureError("Amplification and linearity take signed checks against gauge blocks; there is none.")
    measured = np.array([step.measured_um.value for step in steps])
    certified = np.array([step.certified_um.value for step in steps])
    u = np.array([math.hypot(step.measured_um.u, step.certified_um.u) for step in steps])
    weight = 1 / np.maximum(u, 1e-6) ** 2
    energy = float((weight * certified**2).sum())
    amplification = Estimate(float((weight * certified * measured).sum()) / energy, math.sqrt(1 / energy))
    if len(np.unique(certified)) == 1:
        return ScaleResponse(amplification, None)
    residual = measured - amplification.value * certified
    farthest = int(np.argmax(np.abs(residual)))
    return ScaleResponse(amplification, Estimate(abs(float(residual[farthest])), float(u[farthest])))


def _levelled(z_um: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return heights minus their least-squares plane."""
    known = np.isfinite(z_um)
    if known.mean() < LEAST_MEASURED:
        raise _unmeasured()
    row, col = np.nonzero(known)
    design = np.stack([np.ones(len(row)), row - row.mean(), col - col.mean()], axis=1)
    values = z_um[known].astype(np.float64)
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    out = np.full(z_um.shape, np.nan)
    out[known] = values - design @ solution
    return out


def _block_means(z_um: Heights) -> NDArray[np.float64]:
    """Return means over square blocks, NaN for a block of which less than half is measured."""
    side = max(1, max(z_um.shape) // BLOCKS)
    rows, cols = (n // side for n in z_um.shape)
    blocks = z_um[: rows * side, : cols * side].reshape(rows, side, cols, side).swapaxes(1, 2).reshape(rows, cols, -1)
    known = np.isfinite(blocks)
    total = np.where(known, blocks, 0.0).sum(axis=2, dtype=np.float64)
    count = known.sum(axis=2)
    return np.where(count >= LEAST_MEASURED * side**2, total / np.maximum(count, 1), np.nan)


def _unmeasured() -> MeasureError:
    return MeasureError(
        "Less than half of the field is measured: choose a place with texture all over, and a range about its focus."
    )
