"""Match of two overlapping pictures: the search for shifts at which they fit, and the judgement of these.

The normalised correlation of the true overlap is computed at every shift within reach, at a quarter of the resolution.
The best candidates are then refined to sub-pixel accuracy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wafer_viewer.model.surface.field_poses import RejectionReason
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.numerics.block_gradients import N_BEND_TERMS
from wafer_viewer.numerics.cross_correlation import Likeness, contrast, normalised_cross_correlation
from wafer_viewer.numerics.subpixel_registration import Lag, RegisteredImage, SubpixelShift, align, held_directions
from wafer_viewer.reconstruct.registration.overlap_strips import OverlapWindow, Read, binned_valid

LOOK_PX = 3.0
"""Reach of a look at a shift that is known from the poses of all fields."""


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
        Smallest correlation of a candidate that may be chance, between binned pixels that noise makes less alike.
    nearly : float
        Minimum significance of a candidate relative to the best; fine patterns may lose half of it between search
        pixels.
    patterned : int
        With more candidates than this the pattern may be finer than the search pixels, which are then halved.
    candidates : int
        Largest number of candidates that are refined.
    patterned_factor : int
        Binning factor at which the candidates of a pattern are compared, if more remain than `few`.
    few : int
        Largest number of candidates that are compared at full resolution.
    stored : int
        Largest number of candidates that are stored, those nearest to the stage position.
    least_pitch_px : float, px
        Smallest pitch of a lattice of candidates.
    least_turn : float
        Smallest sine of the angle between its two directions.
    most_steps : int
        Largest number of its steps to either side.
    same_px : float, px
        Distance, in determined directions, below which two candidates are one.
    told_px : float, search pixels
        Uncertainty of a match of binned images above which it stays where the search has it.
    at_stage_px : float, px
        Distance along lines from the stage position below which a match is not measured again there.
    """

    factors: tuple[int, ...] = (4, 2, 1)
    finer: int = 2
    least_side: int = 12
    around: int = 11
    least_share: float = 0.3
    sure_sigmas: float = 7.0
    like: float = 0.5
    nearly: float = 0.35
    patterned: int = 6
    candidates: int = 60
    patterned_factor: int = 2
    few: int = 3
    stored: int = 25
    least_pitch_px: float = 4.0
    least_turn: float = 0.3
    most_steps: int = 8
    same_px: float = 4.0
    at_stage_px: float = 1.5
    told_px: float = 4.0


MATCH_SEARCH = MatchSearchParameters()


@dataclass(frozen=True, slots=True)
class MatchAcceptanceParameters:
    """Limits that a refined match must keep.

    Parameters
    ----------
    surely_like : float
        Smallest correlation of a match that may be chance; below, it is ambiguous.
    like : float
        The same, below which it is unlike: coarse structures have few independent pixels and may correlate by chance.
    clearly : float
        Smallest correlation of a rival, relative to the best.
    unexplained : float
        Largest unexplained variance of a rival, relative to the best.
    never_explained : float
        Fraction of the variance that pixels, optics and light leave unexplained at any shift, at full resolution;
        between binned pixels more is lost, with the fourth power of the factor.
    least_agreeing : float
        Minimum fraction of the contrast where both images agree; rotated content agrees around one point only.
    most_bent_px : float, px
        Displacement of the ends of an overlap against its middle that indicates rotated content.
    bent_sigmas : float
        Smallest significance of that displacement, in standard deviations.
    surely_bent : float, px
        Smallest product of that displacement and its significance: a large one needs less.
    most_u_px : float, px
        Largest accepted uncertainty in a determined direction; more says no more than the stage.
    least_u_px : float, px
        Contribution of pixel shape and optics to the uncertainty, which no residual shows.
    """

    surely_like: float = 0.9
    like: float = 0.7
    clearly: float = 0.8
    unexplained: float = 2.0
    never_explained: float = 0.003
    least_agreeing: float = 0.5
    most_bent_px: float = 0.6
    bent_sigmas: float = 3.0
    surely_bent: float = 3.5
    most_u_px: float = 4.0
    least_u_px: float = 0.004


MATCH_ACCEPTANCE = MatchAcceptanceParameters()
_BLOCKS, _LEAST_BLOCK, _LARGEST_BLOCK = 24, 8, 32
"""Approximate number of blocks into which a refinement divides an overlap, and limits of their side in pixels."""
_LAGS = (2, 8)
"""Distances at which the pixels of an image are compared, to detect structure, in pixels."""
_BLANK = 0.88
"""In pure noise, pixels two apart differ as much as pixels eight apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A possible deviation, (rows, cols) in px, with its covariance [2, 2] and its misfit above the best, in nats."""

    off_px: Lag
    covariance: NDArray[np.float64]
    misfit_nats: float


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Deviation of the second field from its stage position, (rows, cols) in px, with its covariance [2, 2].

    candidates: all deviations at which a repeating pattern fits, none where only one fits; drift, drift_freedom: as in
    `LagErrors`; bend: as in `SubpixelShift`; unbent: the doubt if the bend did not count.
    """

    off_px: Lag
    covariance: NDArray[np.float64]
    correlation: float
    doubt: RejectionReason
    candidates: tuple[Candidate, ...] = ()
    drift: NDArray[np.float64] = field(default_factory=lambda: np.full(2, np.nan))
    drift_freedom: float = 0.0
    bend: NDArray[np.float64] = field(default_factory=lambda: np.full((2, N_BEND_TERMS), np.nan))
    unbent: RejectionReason = RejectionReason.UNLIKE

    @property
    def u_px(self) -> Lag:
        """Standard uncertainties."""
        u = np.sqrt(np.diag(self.covariance)).tolist()
        return u[0], u[1]


def match(first: HeightMap, second: HeightMap, reach_px: float, read: Read) -> Match:
    """Match the second field to the first, within reach of the stage position."""
    factor = _coarsest(first, second)
    window, reach = _window(first, second, reach_px, factor)
    if min(window.overlap) < MATCH_SEARCH.least_side / 2:
        return _nowhere(RejectionReason.BLANK)
    strips = _Strips.of(first, second, window, read)
    lags, by_chance = _candidates(strips, window, factor, reach)
    if len(lags) > MATCH_SEARCH.patterned and factor > MATCH_SEARCH.finer:
        factor = MATCH_SEARCH.finer
        window, reach = _window(first, second, reach_px, factor)
        strips = _Strips.of(first, second, window, read)
        lags, by_chance = _candidates(strips, window, factor, reach)
    fits, unseen = _refined(strips, lags, factor, window, reach_px)
    if by_chance and not (fits and fits[0].correlation > MATCH_ACCEPTANCE.like):
        both_show = _has_structure(read(first, *window.common[0])) and _has_structure(read(second, *window.common[1]))
        return _nowhere(RejectionReason.UNLIKE if both_show else RejectionReason.BLANK)
    return _judged(fits, unseen, by_chance, window, reach_px) if fits else _nowhere(RejectionReason.UNLIKE)


def match_near(first: HeightMap, second: HeightMap, read: Read) -> Match:
    """Match the second field to the first next to its stage position, within about two pixels, without a search."""
    factor = min(_coarsest(first, second), MATCH_SEARCH.patterned_factor)
    window, _ = _window(first, second, LOOK_PX, factor)
    if min(window.overlap) < MATCH_SEARCH.least_side / 2:
        return _nowhere(RejectionReason.BLANK)
    strips = _Strips.of(first, second, window, read)
    fits, unseen = _refined(strips, [window.nominal], factor, window, LOOK_PX)
    return _judged(fits, unseen, False, window, LOOK_PX) if fits else _nowhere(RejectionReason.UNLIKE)


Pair = tuple[RegisteredImage, RegisteredImage]


class _Unseen(NamedTuple):
    """A lag at which a pattern may fit, but cannot be compared, and its standard uncertainty in pixels."""

    lag: Lag
    u_px: float


@dataclass(frozen=True, slots=True, eq=False)
class _Strips:
    """Compared parts of two fields, by binning factor."""

    binned: dict[int, Pair]

    @classmethod
    def of(cls, first: HeightMap, second: HeightMap, window: OverlapWindow, read: Read) -> _Strips:
        return cls({1: (read(first, *window.first), read(second, *window.second))})

    def by(self, factor: int) -> Pair:
        """Return both parts, binned once for all that compare them."""
        if factor not in self.binned:
            one, other = self.binned[1]
            self.binned[factor] = binned_valid(one, factor), binned_valid(other, factor)
        return self.binned[factor]


def _window(first: HeightMap, second: HeightMap, reach_px: float, factor: int) -> tuple[OverlapWindow, int]:
    """Return the possible overlap, and the search reach in search pixels, including one spare pixel."""
    reach = int(np.ceil(reach_px / factor)) + 1
    return OverlapWindow.of(first, second, reach * factor, factor), reach


def _nowhere(doubt: RejectionReason) -> Match:
    return Match((0.0, 0.0), np.full((2, 2), np.inf), 0.0, doubt)


def _coarsest(first: HeightMap, second: HeightMap) -> int:
    """Return the binning factor of the search."""
    side = min(OverlapWindow.of(first, second, 0, 1).overlap)
    return next((f for f in MATCH_SEARCH.factors if side >= f * MATCH_SEARCH.least_side), 1)


def _block_side(window: OverlapWindow) -> int:
    """Return a block size that gives about two dozen blocks."""
    area = max(window.overlap[0], 1) * max(window.overlap[1], 1)
    return int(np.clip((area / _BLOCKS) ** 0.5, _LEAST_BLOCK, _LARGEST_BLOCK))


def _candidates(strips: _Strips, window: OverlapWindow, factor: int, reach: int) -> tuple[list[Lag], bool]:
    """Return candidate lags in full pixels, the most significant first, and whether they may be chance."""
    one, other = strips.by(factor)
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
    strips: _Strips, lags: list[Lag], factor: int, window: OverlapWindow, reach_px: float
) -> tuple[list[SubpixelShift], list[_Unseen]]:
    """Refine all candidates, and the best fit with its rivals again at each finer resolution.

    The many rivals of a pattern are not compared at full resolution: which one is right is not for them to decide.
    Between binned pixels a candidate may be missed; where others lie on a lattice, its other points are compared too.
    Returned beside the fits are the points, and the lags of the search, at which too little of the overlap is left to
    be compared.
    """
    fits: list[SubpixelShift] = []
    unseen: list[_Unseen] = []
    for f in MATCH_SEARCH.factors[MATCH_SEARCH.factors.index(factor) :]:
        if f < MATCH_SEARCH.patterned_factor and len(fits) > MATCH_SEARCH.few:
            break
        levels, side = strips.by(f), max(6, _block_side(window) // f)
        searched = _near(levels, lags, side, f, window.nominal)
        fits = _with_rivals(searched)
        if f == factor and len(fits) > 1:
            missing = _missing(fits, window.nominal, reach_px)
            enough = MATCH_SEARCH.least_share * max(fit.n_pixels for fit in fits)
            there = [_aligned(levels, lag, side, f, window.nominal) for lag in missing]
            fits = _with_rivals([*fits, *_staying(there, missing, f)])
            unseen = [_Unseen(fit.lag, float(f)) for fit in searched if fit.n_pixels < enough]
            unseen += [_Unseen(lag, 0.0) for lag, fit in zip(missing, there, strict=True) if fit.n_pixels < enough]
            unseen = _elsewhere(unseen, fits)
        lags = [fit.lag for fit in fits]
    return fits, unseen


def _elsewhere(unseen: list[_Unseen], fits: list[SubpixelShift]) -> list[_Unseen]:
    """Return the lags that are neither those of fits nor of each other."""
    kept: list[_Unseen] = []
    for one in unseen:
        apart = [_apart(fit, one.lag) for fit in fits] + [math.dist(other.lag, one.lag) for other in kept]
        if min(apart) > MATCH_SEARCH.same_px:
            kept.append(one)
    return kept


def _near(levels: Pair, lags: Sequence[Lag], side: int, factor: int, nominal: Lag) -> list[SubpixelShift]:
    """Refine lags on binned images, and return the fits that stay near them."""
    return _staying([_aligned(levels, lag, side, factor, nominal) for lag in lags], lags, factor)


def _staying(fits: list[SubpixelShift], lags: Sequence[Lag], factor: int) -> list[SubpixelShift]:
    return [fit for fit, lag in zip(fits, lags, strict=True) if _apart(fit, lag) <= 2.0 * factor]


def _missing(fits: list[SubpixelShift], nominal: Lag, reach_px: float) -> list[Lag]:
    """Return the points within reach, of the lattice that fits span, at which there is none yet."""
    at = np.array([fit.lag for fit in fits])
    steps = (at[:, None] - at[None]).reshape(-1, 2)
    length = np.hypot(*steps.T)
    steps = steps[np.argsort(length, kind="stable")][np.count_nonzero(length < MATCH_SEARCH.least_pitch_px) :]
    if not len(steps):
        return []
    first = steps[0]
    turned = np.abs(first[0] * steps[:, 1] - first[1] * steps[:, 0]) / np.hypot(*first) / np.hypot(*steps.T)
    others = steps[turned > MATCH_SEARCH.least_turn]
    n = int(min(2 * reach_px / np.hypot(*first), MATCH_SEARCH.most_steps)) + 1
    counts = np.stack(np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1) if len(others) else 0), -1).reshape(-1, 2)
    points = at[0] + counts[:, :1] * first + counts[:, 1:] * (others[0] if len(others) else 0)
    within = np.abs(points - nominal).max(axis=1) <= reach_px
    known = np.hypot(*(points[:, None] - at[None]).transpose(2, 0, 1)).min(axis=1) < MATCH_SEARCH.least_pitch_px
    return [(float(r), float(c)) for r, c in points[within & ~known]]


def _aligned(levels: Pair, lag: Lag, side: int, factor: int, nominal: Lag) -> SubpixelShift:
    """Refine a lag on binned images; along lines it stays where the stage has it.

    Far from there, an error of the direction of the lines would displace them.
    """
    fit = _scaled(align(*levels, (lag[0] / factor, lag[1] / factor), side, factor > 1), factor)
    if fit.held.shape[1] != 1:
        is_told = factor == 1 or fit.covariance.trace() < (MATCH_SEARCH.told_px * factor) ** 2
        return fit if is_told else replace(fit, lag=lag)
    across = fit.held @ fit.held.T
    at = nominal + across @ np.subtract(fit.lag, nominal)
    if np.hypot(*(at - fit.lag)) < MATCH_SEARCH.at_stage_px:
        return fit
    again = align(*levels, (float(at[0]) / factor, float(at[1]) / factor), side, factor > 1)
    return _scaled(again, factor)


def _scaled(fit: SubpixelShift, factor: int) -> SubpixelShift:
    """Convert a fit to full pixels."""
    known = fit.covariance * factor**2
    return replace(
        fit,
        lag=(fit.lag[0] * factor, fit.lag[1] * factor),
        covariance=known,
        held=held_directions(known),
        bent_px=fit.bent_px * factor,
        drift=fit.drift * factor**2,
        bend=fit.bend * factor,
        n_pixels=fit.n_pixels * factor**2,
        unexplained=fit.unexplained + MATCH_ACCEPTANCE.never_explained * factor**4,
    )


def _apart(fit: SubpixelShift, lag: Lag) -> float:
    """Return the distance of a fit from a lag in its determined directions, in pixels."""
    down, right = fit.lag[0] - lag[0], fit.lag[1] - lag[1]
    held = fit.held
    if held.shape[1] == 1:
        return abs(float(held[0, 0]) * down + float(held[1, 0]) * right)
    return math.hypot(down, right)


def _with_rivals(fits: list[SubpixelShift]) -> list[SubpixelShift]:
    """Return the best fit, and fits elsewhere that are nearly as good, the best first."""
    kept: list[SubpixelShift] = []
    for fit in sorted(
        fits, key=lambda fit: (fit.agreeing < MATCH_ACCEPTANCE.least_agreeing, fit.n_blocks * math.log(fit.unexplained))
    ):
        if not kept or (_nearly(fit, kept[0]) and min(_apart(other, fit.lag) for other in kept) > MATCH_SEARCH.same_px):
            kept.append(fit)
    return kept


def _nearly(fit: SubpixelShift, best: SubpixelShift) -> bool:
    agrees = fit.agreeing >= MATCH_ACCEPTANCE.least_agreeing or best.agreeing < MATCH_ACCEPTANCE.least_agreeing
    return (
        agrees
        and fit.correlation > MATCH_ACCEPTANCE.clearly * best.correlation
        and fit.unexplained < MATCH_ACCEPTANCE.unexplained * best.unexplained
    )


def _judged(
    fits: list[SubpixelShift], unseen: list[_Unseen], by_chance: bool, window: OverlapWindow, reach_px: float
) -> Match:
    """Return the best fit with the doubt about it; a pattern may also fit where it could not be compared.

    There it is as likely as at most of its fits: that one of these is better tells against all others alike.
    """
    best = fits[0]
    found = [_candidate(fit, best, window) for fit in fits]
    unbent = _doubt(fits, by_chance, max(map(abs, found[0].off_px)) > reach_px)
    doubt = RejectionReason.UNLIKE if is_bent(best.bent_px, best.bent_sigmas) else unbent
    told = [one for one in found if np.isfinite(one.covariance).all()]
    if told:
        usual_nats = float(np.median([one.misfit_nats for one in told]))
        for one in unseen:
            covariance = best.covariance + one.u_px**2 * np.eye(2)
            place = _candidate(replace(best, lag=one.lag, covariance=covariance), best, window)
            told.append(replace(place, misfit_nats=usual_nats))
    rivals = tuple(sorted(told, key=lambda one: float(np.hypot(*one.off_px)))[: MATCH_SEARCH.stored])
    is_open = doubt is RejectionReason.AMBIGUOUS and len(rivals) > 1
    candidates = rivals if is_open else ()
    off_px, covariance = found[0].off_px, found[0].covariance
    spread = best.drift, best.drift_freedom, best.bend
    return Match(off_px, covariance, best.correlation, doubt, candidates, *spread, unbent)


def _candidate(fit: SubpixelShift, best: SubpixelShift, window: OverlapWindow) -> Candidate:
    """Return the deviation of a fit from the stage, which alone counts along lines."""
    off = np.subtract(np.subtract(fit.lag, window.lag), window.part)
    if fit.held.shape[1] != 2 and np.isfinite(fit.covariance).all():
        off = fit.held @ fit.held.T @ off
    covariance = fit.covariance + MATCH_ACCEPTANCE.least_u_px**2 * np.eye(2)
    misfit_nats = max(0.0, 0.5 * fit.n_blocks * math.log(fit.unexplained / best.unexplained))
    return Candidate((float(off[0]), float(off[1])), covariance, misfit_nats)


def is_bent(bent_px: ArrayLike, sigmas: ArrayLike) -> NDArray[np.bool_]:
    """Return whether bends indicate rotated content."""
    px, significance = np.asarray(bent_px), np.asarray(sigmas)
    far, sure = px > MATCH_ACCEPTANCE.most_bent_px, significance > MATCH_ACCEPTANCE.bent_sigmas
    return far & sure & (px * significance > MATCH_ACCEPTANCE.surely_bent)


def _doubt(fits: list[SubpixelShift], by_chance: bool, beyond: bool) -> RejectionReason:
    """Return the doubt about the best fit, apart from its bend."""
    best = fits[0]
    if best.agreeing < MATCH_ACCEPTANCE.least_agreeing:
        return RejectionReason.UNLIKE
    is_held = _largest_variance(best) < MATCH_ACCEPTANCE.most_u_px**2
    if not is_held or len(fits) > 1 or (by_chance and best.correlation < MATCH_ACCEPTANCE.surely_like):
        return RejectionReason.AMBIGUOUS
    return RejectionReason.END_OF_SEARCH if beyond else RejectionReason.NONE


def _largest_variance(fit: SubpixelShift) -> float:
    """Return the largest variance in the determined directions, infinite without any."""
    held = fit.held
    if held.shape[1] < 2:
        return float((held.T @ fit.covariance @ held).max(initial=0)) if held.size else math.inf
    (a, b), (_, c) = fit.covariance.tolist()
    return (a + c) / 2 + math.hypot((a - c) / 2, b)


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
