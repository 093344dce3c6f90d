"""Pairwise registration of overlapping fields, with uncertainty and rejection reason.

The images are compared first: the normalised correlation of the true overlap at every shift within reach, at a quarter
of the resolution. The best candidates are then refined to sub-pixel accuracy. Where the images are blank the heights
are compared instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.progress import Progress
from wafer_viewer.model.surface.field_poses import ObservationSource, RejectionReason, Shifts
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.numerics.correlation import Likeness, contrast, normalised_cross_correlation
from wafer_viewer.numerics.subpixel_registration import Lag, RegisteredImage, SubpixelShift, align
from wafer_viewer.reconstruct.focus.focus_volume import on_threads
from wafer_viewer.reconstruct.registration.overlap_strips import (
    OverlapWindow,
    Read,
    binned_valid,
    height_of,
    picture_of,
)


@dataclass(frozen=True, slots=True)
class MatchSearchParameters:
    """Limits of the search for places at which two images may match; search pixels are binned.

    Parameters
    ----------
    factors : tuple[int, ...]
        Binning factors of the search and of its refinement; the search takes the largest that suits the overlap.
    finer : int
        Binning factor of a second search, for fine patterns.
    least_side : int, search pixels
        Smallest width of an overlap; one of fewer than half as many pixels is not compared.
    around : int, search pixels
        Side of the square whose mean is subtracted before images are correlated.
    least_share : float
        Minimum fraction of the overlap at a shift that is searched.
    sure_sigmas : float
        Significance below which a match may be chance; the highest of several hundred correlations of unrelated images
        is three to four deviations high.
    like : float
        Smallest correlation of a match that may be chance: coarse structures have few independent pixels and may
        correlate by chance.
    nearly : float
        Minimum significance of a candidate relative to the best; fine patterns may lose half of it between search
        pixels.
    patterned : int
        With more candidates than this the pattern may be finer than the search pixels, which are then halved.
    candidates : int
        Largest number of candidates that are refined.
    """

    factors: tuple[int, ...] = (4, 2, 1)
    finer: int = 2
    least_side: int = 12
    around: int = 11
    least_share: float = 0.3
    sure_sigmas: float = 7.0
    like: float = 0.7
    nearly: float = 0.35
    patterned: int = 6
    candidates: int = 60


MATCH_SEARCH = MatchSearchParameters()


@dataclass(frozen=True, slots=True)
class MatchAcceptanceParameters:
    """Limits that a refined match must keep.

    Parameters
    ----------
    surely_like : float
        Smallest correlation of a match that may be chance; below, it is ambiguous rather than unlike.
    clearly : float
        Smallest correlation of a rival, relative to the best.
    unexplained : float
        Largest unexplained variance of a rival, relative to the best.
    least_agreeing : float
        Minimum fraction of the contrast where both images agree; rotated content agrees around one point only.
    most_bent_px : float, px
        Displacement of the ends of an overlap against its middle that indicates rotated content.
    surely_bent : float
        Significance of that displacement, in standard deviations.
    most_u_px : float, px
        Largest accepted uncertainty; along straight lines the position is undetermined, apart from noise.
    least_u_px : float, px
        Contribution of pixel shape and optics to the uncertainty, which no residual shows.
    """

    surely_like: float = 0.9
    clearly: float = 0.8
    unexplained: float = 2.0
    least_agreeing: float = 0.5
    most_bent_px: float = 1.0
    surely_bent: float = 6.0
    most_u_px: float = 0.5
    least_u_px: float = 0.01


MATCH_ACCEPTANCE = MatchAcceptanceParameters()
_BLOCKS, _LEAST_BLOCK, _LARGEST_BLOCK = 24, 8, 32
"""Approximate number of blocks into which a refinement divides an overlap, and limits of their side in pixels."""
_LAGS = (2, 8)
"""Distances at which the pixels of an image are compared, to detect structure, in pixels."""
_BLANK = 0.88
"""In pure noise, pixels two apart differ as much as pixels eight apart."""


@dataclass(frozen=True, slots=True)
class Match:
    """Deviation of the second field from its stage position, (rows, cols) in px, with standard uncertainties."""

    off_px: Lag
    u_px: Lag
    correlation: float
    doubt: RejectionReason


def match(first: HeightMap, second: HeightMap, reach_px: float, read: Read) -> Match:
    """Match the second field to the first, within reach of the stage position."""
    factor = _coarsest(first, second)
    window, reach = _window(first, second, reach_px, factor)
    if min(window.overlap) < MATCH_SEARCH.least_side / 2:
        return _nowhere(RejectionReason.BLANK)
    one, other = read(first, *window.first), read(second, *window.second)
    lags, by_chance = _candidates(one, other, window, factor, reach)
    if len(lags) > MATCH_SEARCH.patterned and factor > MATCH_SEARCH.finer:
        factor = MATCH_SEARCH.finer
        window, reach = _window(first, second, reach_px, factor)
        one, other = read(first, *window.first), read(second, *window.second)
        lags, by_chance = _candidates(one, other, window, factor, reach)
    if not lags:
        both_show = _has_structure(read(first, *window.common[0])) and _has_structure(read(second, *window.common[1]))
        return _nowhere(RejectionReason.UNLIKE if both_show else RejectionReason.BLANK)
    fits = _refined(one, other, lags, factor, _block_side(window))
    return _judged(fits, by_chance, window, reach_px) if fits else _nowhere(RejectionReason.UNLIKE)


def _window(first: HeightMap, second: HeightMap, reach_px: float, factor: int) -> tuple[OverlapWindow, int]:
    """Return the possible overlap, and the search reach in search pixels, including one spare pixel."""
    reach = int(np.ceil(reach_px / factor)) + 1
    return OverlapWindow.of(first, second, reach * factor, factor), reach


def _nowhere(doubt: RejectionReason) -> Match:
    return Match((0.0, 0.0), (float("inf"), float("inf")), 0.0, doubt)


def _coarsest(first: HeightMap, second: HeightMap) -> int:
    """Return the binning factor of the search."""
    side = min(OverlapWindow.of(first, second, 0, 1).overlap)
    return next((f for f in MATCH_SEARCH.factors if side >= f * MATCH_SEARCH.least_side), 1)


def _block_side(window: OverlapWindow) -> int:
    """Return a block size that gives about two dozen blocks."""
    area = max(window.overlap[0], 1) * max(window.overlap[1], 1)
    return int(np.clip((area / _BLOCKS) ** 0.5, _LEAST_BLOCK, _LARGEST_BLOCK))


def _candidates(
    one: RegisteredImage, other: RegisteredImage, window: OverlapWindow, factor: int, reach: int
) -> tuple[list[Lag], bool]:
    """Return candidate lags in full pixels, the most significant first, and whether they may be chance."""
    one, other = binned_valid(one, factor), binned_valid(other, factor)
    valids = one.valid > 0, other.valid > 0
    details = (
        contrast(one.values, valids[0], MATCH_SEARCH.around),
        contrast(other.values, valids[1], MATCH_SEARCH.around),
    )
    middle = window.lag[0] // factor, window.lag[1] // factor
    likeness = normalised_cross_correlation(details[0], valids[0], details[1], valids[1], middle, reach)
    least = MATCH_SEARCH.least_share * window.overlap[0] * window.overlap[1] / factor**2
    peaks, by_chance = _peaks(likeness, least, reach)
    return [((r + middle[0]) * factor, (c + middle[1]) * factor) for r, c in peaks], by_chance


def _peaks(likeness: Likeness, least_pixels: float, reach: int) -> tuple[list[tuple[int, int]], bool]:
    """Return the highest local maxima relative to the middle, none without correlation, and the chance flag."""
    from wafer_viewer.numerics.filters.sliding_filters import highest

    sigmas = np.where(likeness.pixels >= least_pixels, likeness.sigmas, 0.0)
    top = float(sigmas.max())
    by_chance = top < MATCH_SEARCH.sure_sigmas
    if by_chance and float(likeness.correlation[sigmas == top].max()) < MATCH_SEARCH.like:
        return [], by_chance
    rows, cols = np.nonzero((sigmas == highest(sigmas, 3)) & (sigmas >= MATCH_SEARCH.nearly * top))
    order = np.argsort(-sigmas[rows, cols], kind="stable")[: MATCH_SEARCH.candidates]
    return [(int(rows[n]) - reach, int(cols[n]) - reach) for n in order], by_chance


def _refined(
    one: RegisteredImage, other: RegisteredImage, lags: list[Lag], factor: int, side: int
) -> list[SubpixelShift]:
    """Refine all candidates, and the best fit with its rivals again at each finer resolution."""
    fits: list[SubpixelShift] = []
    for f in MATCH_SEARCH.factors[MATCH_SEARCH.factors.index(factor) :]:
        levels = binned_valid(one, f), binned_valid(other, f)
        fits = [_scaled(align(*levels, (r / f, c / f), max(6, side // f), f > 1), f) for r, c in lags]
        near = [fit for fit, lag in zip(fits, lags, strict=True) if _distance(fit.lag, lag) <= 2.0 * f]
        fits = _with_rivals(near, 1.5 * factor)
        lags = [fit.lag for fit in fits]
    return fits


def _scaled(fit: SubpixelShift, factor: int) -> SubpixelShift:
    """Convert a fit to full pixels."""
    lag = fit.lag[0] * factor, fit.lag[1] * factor
    return SubpixelShift(
        lag,
        fit.covariance * factor**2,
        fit.correlation,
        fit.agreeing,
        fit.bent_px * factor,
        fit.bent_sigmas,
        fit.n_pixels * factor**2,
    )


def _distance(a: Lag, b: Lag) -> float:
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]))


def _with_rivals(fits: list[SubpixelShift], apart_px: float) -> list[SubpixelShift]:
    """Return the best fit, and fits elsewhere that are nearly as good."""
    if not fits:
        return []
    best = max(
        fits, key=lambda fit: (fit.agreeing >= MATCH_ACCEPTANCE.least_agreeing, fit.correlation * fit.n_pixels**0.5)
    )
    return [best, *(fit for fit in fits if _distance(fit.lag, best.lag) > apart_px and _nearly(fit, best))]


def _nearly(fit: SubpixelShift, best: SubpixelShift) -> bool:
    unexplained, least = 1 - fit.correlation**2, 1 - best.correlation**2
    agrees = fit.agreeing >= MATCH_ACCEPTANCE.least_agreeing or best.agreeing < MATCH_ACCEPTANCE.least_agreeing
    return (
        agrees
        and fit.correlation > MATCH_ACCEPTANCE.clearly * best.correlation
        and unexplained < MATCH_ACCEPTANCE.unexplained * least
    )


def _judged(fits: list[SubpixelShift], by_chance: bool, window: OverlapWindow, reach_px: float) -> Match:
    best = fits[0]
    off = tuple(at - lag - part for at, lag, part in zip(best.lag, window.lag, window.part, strict=True))
    u = tuple(np.sqrt(np.diag(best.covariance) + MATCH_ACCEPTANCE.least_u_px**2).tolist())
    doubt = _doubt(fits, by_chance, max(map(abs, off)) > reach_px)
    return Match((off[0], off[1]), (u[0], u[1]), best.correlation, doubt)


def _doubt(fits: list[SubpixelShift], by_chance: bool, beyond: bool) -> RejectionReason:
    best = fits[0]
    turned = best.bent_px > MATCH_ACCEPTANCE.most_bent_px and best.bent_sigmas > MATCH_ACCEPTANCE.surely_bent
    if turned or best.agreeing < MATCH_ACCEPTANCE.least_agreeing:
        return RejectionReason.UNLIKE
    held = best.covariance.max() < MATCH_ACCEPTANCE.most_u_px**2
    if not held or len(fits) > 1 or (by_chance and best.correlation < MATCH_ACCEPTANCE.surely_like):
        return RejectionReason.AMBIGUOUS
    return RejectionReason.END_OF_SEARCH if beyond else RejectionReason.NONE


def _has_structure(picture: RegisteredImage) -> bool:
    """Return whether an image has structure beyond noise along both axes.

    In structured images, nearby pixels are more alike than distant ones. A line alone leaves the position along it
    undetermined.
    """
    near, far = _LAGS
    return all(_difference(picture, near, axis) < _BLANK * _difference(picture, far, axis) for axis in (0, 1))


def _difference(picture: RegisteredImage, lag: int, axis: int) -> float:
    """Return the mean squared difference of known pixels that are `lag` apart along an axis."""
    ahead, behind = [slice(None), slice(None)], [slice(None), slice(None)]
    ahead[axis], behind[axis] = slice(lag, None), slice(None, -lag)
    a, b = tuple(ahead), tuple(behind)
    valid = picture.valid[a] * picture.valid[b]
    off = (picture.values[a] - picture.values[b]) * valid
    return float(np.vdot(off, off)) / max(1.0, float(valid.sum()))


REACH_PX, WIDE_REACH_PX, WIDE_FRACTION = 40.0, 120.0, 0.125
"""Search reach: 40 px about the stage position by default, four standard deviations of a good stage.

Where both fields have structure but do not match there, the reach is 120 px or an eighth of the shorter side of a
field.
"""
LEAST_MEASURED = 0.1
"""Minimum measured fraction; with fewer heights nothing was in focus, and the images are noise and may differ."""
_LOST = (RejectionReason.UNLIKE, RejectionReason.END_OF_SEARCH)


@dataclass(frozen=True, slots=True)
class PairShift:
    """Lateral shift measured in one overlap; the fields have the meaning of those of `Shifts`."""

    x_um: float
    y_um: float
    u_x_um: float
    u_y_um: float
    correlation: float
    by: ObservationSource
    doubt: RejectionReason


def register(
    heights: Sequence[HeightMap],
    pairs: NDArray[np.int32],
    reach_um: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Shifts:
    """Register each pair of fields (indices, int32 [n, 2]) relative to their stage positions.

    reach_um: largest deviation from the stage position that is searched; by default as `REACH_PX` states. Only the
    possible overlap is read. progress receives the finished fraction (0 ... 1); an exception raised by it ends the
    work. threads: all cores if omitted.
    """
    found: list[PairShift] = [_by_stage(RejectionReason.BLANK)] * len(pairs)
    done = 0

    def one(n: int) -> None:
        nonlocal done
        first, second = heights[pairs[n, 0]], heights[pairs[n, 1]]
        found[n] = register_pair(first, second, None if reach_um is None else reach_um / first.pixel_um)
        done += 1
        if progress is not None:
            progress(done / len(pairs))

    on_threads(one, range(len(pairs)), threads)
    return _table(pairs, found)


def register_pair(first: HeightMap, second: HeightMap, reach_px: float | None = None) -> PairShift:
    """Return the shift of the second field against the first, relative to their stage positions.

    reach_px: largest deviation along x and along y; by default as `REACH_PX` states. A rejected match retains its best
    shift and correlation, with a doubt; it must not be used.
    """
    found = _within(first, second, REACH_PX if reach_px is None else reach_px)
    wide_px = min(WIDE_REACH_PX, WIDE_FRACTION * min(*first.shape, *second.shape))
    if reach_px is not None or found.doubt not in _LOST or wide_px <= REACH_PX:
        return found
    wider = _within(first, second, wide_px)
    return wider if wider.doubt is RejectionReason.NONE else found


def _within(first: HeightMap, second: HeightMap, reach_px: float) -> PairShift:
    """Register by images, by heights where the images are blank, or else by the stage."""
    match_window = match(first, second, reach_px, picture_of)
    if match_window.doubt in _LOST and _measured_share(first, second) < LEAST_MEASURED:
        return _by_stage(RejectionReason.BLANK)
    if match_window.doubt is not RejectionReason.BLANK:
        return _pair_shift(match_window, first.pixel_um, ObservationSource.PICTURE)
    felt = match(first, second, reach_px, height_of)
    if felt.doubt is RejectionReason.NONE:
        return _pair_shift(felt, first.pixel_um, ObservationSource.HEIGHT)
    return _by_stage(RejectionReason.BLANK)


def _measured_share(first: HeightMap, second: HeightMap) -> float:
    """Return the measured fraction of an overlap, in the field that has less."""
    common = OverlapWindow.of(first, second, 0, 1).common
    shares = (np.isfinite(h.z_raw_um[part]).mean() for h, part in zip((first, second), common, strict=True))
    return min(map(float, shares))


def _pair_shift(found: Match, pixel_um: float, by: ObservationSource) -> PairShift:
    down, right = found.off_px
    u_down, u_right = found.u_px
    return PairShift(
        right * pixel_um, -down * pixel_um, u_right * pixel_um, u_down * pixel_um, found.correlation, by, found.doubt
    )


def _by_stage(doubt: RejectionReason) -> PairShift:
    return PairShift(0.0, 0.0, float("inf"), float("inf"), 0.0, ObservationSource.STAGE, doubt)


def _table(pairs: NDArray[np.int32], found: Sequence[PairShift]) -> Shifts:
    table = np.array([(f.x_um, f.y_um, f.u_x_um, f.u_y_um) for f in found], np.float64).reshape(-1, 4)
    doubt = np.array([f.doubt for f in found], np.uint8)
    return Shifts(
        first=np.array(pairs[:, 0], np.int32),
        second=np.array(pairs[:, 1], np.int32),
        x_um=table[:, 0].copy(),
        y_um=table[:, 1].copy(),
        u_x_um=table[:, 2].copy(),
        u_y_um=table[:, 3].copy(),
        correlation=np.array([f.correlation for f in found], np.float32),
        by=np.array([f.by for f in found], np.uint8),
        doubt=doubt,
        weight=(doubt == RejectionReason.NONE).astype(np.float32),
        residual_x_um=np.zeros(len(pairs)),
        residual_y_um=np.zeros(len(pairs)),
    )
