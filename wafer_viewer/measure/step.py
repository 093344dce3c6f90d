"""Step height: how high one region stands over another, with the budget of its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.level import Fit, Values, fit_plane, robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import Contribution, Length, StepHeight
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import Mosaic, Provenance

LEAST_POINTS = 64
TILES = (16, 8, 4)
"""A region is cut into n x n tiles, whose means tell the noise of the whole mean. The coarser the tiles, the further
the noise may be correlated; the largest answer counts."""
LEAST_PER_TILE = 4
PEAK_BIAS_STEPS = 0.03
"""Standard uncertainty of a focus peak within its step, in steps: level faces do not average it out."""
DEFINITION = "h of the common plane z = a x + b y + c + h [upper]: the step half way between the two regions"


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """The measured points of one region: x_um, y_um, z_um [n]; covered: the share of the region that is measured."""

    x_um: Values
    y_um: Values
    z_um: Values
    covered: float


def step_height(
    surface: Mosaic, upper: Region, lower: Region, *, calibration_valid: bool = True, count_filled: bool = False
) -> StepHeight:
    """The height of `upper` over `lower`, from a robust fit of z = a x + b y + c + h [upper] to both together.

    calibration_valid: whether the calibration in the surface's provenance holds today; without one the height reads
    'uncalibrated' and has no uncertainty. count_filled: take filled pixels for measured ones.
    The budget: noise of tile means carried through the fit, focus-peak bias, z scale, relative tilt of the faces.
    Raises MeasureError when the regions share points or hold too few measured ones.
    """
    high, low = _face(surface, upper, "upper", count_filled), _face(surface, lower, "lower", count_filled)
    _refuse_overlap(high, low)
    fit = robust_fit(_design(high, low), np.concatenate([high.z_um, low.z_um]))
    kept_high, kept_low = _split(fit.kept, high), _split(fit.kept, low, after=high)
    tilt = _relative_tilt(high, low)
    height_um = float(fit.coefficients[3])
    budget = _budget(height_um, high, low, fit, tilt, surface.provenance)
    return StepHeight(
        upper=upper,
        lower=lower,
        height=length_of(height_um, budget, surface.provenance, calibration_valid),
        definition=DEFINITION,
        upper_mean_um=float(high.z_um[kept_high].mean()),
        lower_mean_um=float(low.z_um[kept_low].mean()),
        upper_sq_um=float(fit.residuals[: len(high.z_um)][kept_high].std()),
        lower_sq_um=float(fit.residuals[len(high.z_um) :][kept_low].std()),
        upper_points=int(np.count_nonzero(kept_high)),
        lower_points=int(np.count_nonzero(kept_low)),
        relative_tilt_mrad=float(np.hypot(*tilt)) * 1e3,
        surface="filled" if count_filled else surface.provenance.recipe.measure_on,
        simulated=surface.provenance.simulated,
        notes=_notes(high, low),
    )


def length_of(
    value_um: float, budget: tuple[Contribution, ...], provenance: Provenance, calibration_valid: bool
) -> Length:
    """A length with its expanded uncertainty, or 'uncalibrated' where no calibration holds."""
    if provenance.calibration is None or not calibration_valid:
        return Length(value_um=value_um, status="uncalibrated")
    return Length.evaluated(value_um, budget)


def _face(surface: Mosaic, region: Region, name: str, count_filled: bool) -> Face:
    window = surface.window(region)
    x, y = np.meshgrid(window.x_um, window.y_um)
    inside = region.contains(x, y)
    z = window.to_measure(count_filled)
    good = inside & np.isfinite(z)
    n = int(np.count_nonzero(good))
    if n < LEAST_POINTS:
        raise MeasureError(
            f"The {name} region has {n} measured points and needs {LEAST_POINTS}: "
            "make it larger, or move it to where the surface is measured."
        )
    return Face(x[good], y[good], z[good].astype(float), n / max(1, int(np.count_nonzero(inside))))


def _refuse_overlap(high: Face, low: Face) -> None:
    shared = np.intersect1d(high.x_um + 1j * high.y_um, low.x_um + 1j * low.y_um)
    if shared.size:
        raise MeasureError(f"The upper and the lower region share {shared.size} points: move them apart.")


def _design(high: Face, low: Face) -> Values:
    """Columns x, y, 1, [upper]; x and y from the middle of both, so that h does not lean on far-off coordinates."""
    x, y = np.concatenate([high.x_um, low.x_um]), np.concatenate([high.y_um, low.y_um])
    is_upper = np.r_[np.ones(len(high.x_um)), np.zeros(len(low.x_um))]
    return np.column_stack([x - x.mean(), y - y.mean(), np.ones_like(x), is_upper])


def _split(flags: NDArray[np.bool_], face: Face, after: Face | None = None) -> NDArray[np.bool_]:
    start = 0 if after is None else len(after.z_um)
    return flags[start : start + len(face.z_um)]


def _relative_tilt(high: Face, low: Face) -> Values:
    """The difference of the slopes (d/dx, d/dy) of the two faces, each levelled on itself."""
    slopes = [fit_plane(f.x_um - f.x_um.mean(), f.y_um - f.y_um.mean(), f.z_um).coefficients[:2] for f in (high, low)]
    return slopes[0] - slopes[1]


def _budget(
    height_um: float, high: Face, low: Face, fit: Fit, tilt: Values, provenance: Provenance
) -> tuple[Contribution, ...]:
    lever = np.array([high.x_um.mean() - low.x_um.mean(), high.y_um.mean() - low.y_um.mean()]) / 2
    u_scale = 0.0 if provenance.calibration is None else provenance.calibration.u_z_scale
    return (
        Contribution(name="noise and flatness of the regions", u_um=_noise_um(high, low, fit)),
        Contribution(name="bias of the focus peak", u_um=_peak_bias_um(high, low, provenance.z_step_um)),
        Contribution(name="z scale", u_um=abs(height_um) * u_scale),
        Contribution(name="relative tilt of the faces", u_um=abs(float(tilt @ lever)) / math.sqrt(3)),
    )


def _noise_um(high: Face, low: Face, fit: Fit) -> float:
    """Standard deviation of h when the means of tiles, not the pixels, are the independent observations."""
    return max(_noise_of_tiles(high, low, fit, n) for n in TILES)


def _noise_of_tiles(high: Face, low: Face, fit: Fit, n: int) -> float:
    tile = np.concatenate([_tile_numbers(high, n), _tile_numbers(low, n) + n * n])[fit.kept]
    counts = np.bincount(tile, minlength=2 * n * n)
    full = counts >= LEAST_PER_TILE
    columns = [np.bincount(tile, c[fit.kept], len(counts))[full] / counts[full] for c in _design(high, low).T]
    means = np.bincount(tile, fit.residuals[fit.kept], len(counts))[full] / counts[full]
    design = np.column_stack(columns)
    freedom = max(1, len(means) - design.shape[1])
    covariance = np.linalg.pinv(design.T @ design) * float(means @ means) / freedom
    return float(np.sqrt(max(covariance[3, 3], 0.0)))


def _tile_numbers(face: Face, n: int) -> NDArray[np.int64]:
    return _strip(face.x_um, n) * n + _strip(face.y_um, n)


def _strip(places: Values, n: int) -> NDArray[np.int64]:
    low, high = float(places.min()), float(places.max())
    return np.minimum(((places - low) / max(high - low, 1e-9) * n).astype(np.int64), n - 1)


def _peak_bias_um(high: Face, low: Face, z_step_um: float) -> float:
    """A face that spans a whole step meets every phase of it and averages the bias out; a level one does not."""
    level_high, level_low = (max(0.0, 1 - _span_um(f) / max(z_step_um, 1e-9)) for f in (high, low))
    return PEAK_BIAS_STEPS * z_step_um * float(np.hypot(level_high, level_low))


def _span_um(face: Face) -> float:
    low, high = np.percentile(face.z_um, (2, 98))
    return float(high - low)


def _notes(high: Face, low: Face) -> tuple[str, ...]:
    faces = {"upper": high, "lower": low}
    return tuple(f"{f.covered:.0%} of the {name} region is measured" for name, f in faces.items() if f.covered < 0.9)
