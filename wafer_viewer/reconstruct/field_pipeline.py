"""Reconstruction of a height map from the focus stack of a field: a sequence of stages.

field -> peaks -> gated peaks -> corrected peaks -> weighed heights -> cleaned heights -> height map

`reconstruct` runs all stages on the frames of a complete field. `LiveField` searches the peaks while frames arrive and
joins the sequence after them; `focus_curve` runs it on a part of a field.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer._version import __version__
from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.progress import Progress, silent
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.frame_health import FrameHealth, flicker_u_um, interpolation_u_um, jitter_u_um
from wafer_viewer.model.surface.height_map import UNMEASURED_FROM, HeightMap, Origin, Provenance, RefusedHeights
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.numerics.filters.regions import blanked
from wafer_viewer.reconstruct.auto_tuning import TunedRecipe, tune_recipe
from wafer_viewer.reconstruct.cleaning.clean import clean, mark_filled, settle_cleaning
from wafer_viewer.reconstruct.focus.all_in_focus import FrameFit, all_in_focus, membrane
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_interpolation import PEAKS
from wafer_viewer.reconstruct.focus.peak_search import (
    FOCUS_WIDTH_DEPTHS,
    WideLevels,
    noise_scores,
    search_field,
    wide_heights,
)
from wafer_viewer.reconstruct.frame_blocks import Frames
from wafer_viewer.reconstruct.gates.edge_bleeding import BleedingEdges, find_edges, judge_edges
from wafer_viewer.reconstruct.gates.edge_bleeding import warm_up as warm_up_edges
from wafer_viewer.reconstruct.gates.edge_sides import EdgeSide, cell_medians
from wafer_viewer.reconstruct.gates.evidence import alone, trained_trees, weigh
from wafer_viewer.reconstruct.gates.evidence import warm_up as warm_up_evidence
from wafer_viewer.reconstruct.gates.evidence_scores import Scores, Units, scores_of
from wafer_viewer.reconstruct.gates.gate import LEAST_FRAMES, GateTest, checks, first_failed
from wafer_viewer.reconstruct.gates.mirrored_light import Symmetry, mirror_sums
from wafer_viewer.reconstruct.gates.silhouettes import Silhouette
from wafer_viewer.reconstruct.height_uncertainty import jitter_effect_um, uncertainty_um
from wafer_viewer.reconstruct.preprocess.exposure_fusion import without_shading
from wafer_viewer.reconstruct.preprocess.frame_jitter import (
    add_gaps,
    block_means,
    frame_gaps,
    frame_jitter,
    worst_gap_u_um,
)
from wafer_viewer.reconstruct.preprocess.frame_order import order_without_jitter
from wafer_viewer.reconstruct.preprocess.frames import FrameSamples, prepare

SEARCH_SHARE, EDGES_SHARE = 0.6, 0.9
"""Finished fraction after the peak search and after the edges, from 60 frames of 1000 x 1320 pixels."""

PROBABLE_ALONG = 0.9
"""Least probability of a height that the focus along a wall gave: its curve was judged there, the scores are not of it.

Of trenches of tests/truth/families.py, seeds 1170, 1172 and 1174, 0.8, 0.9 and 0.97 leave 0.58, 0.28 and 0.01 % false,
and 66.1, 66.1 and 64.6 % of all pixels right, beside 0.97 for the others.
"""

ENOUGH_TO_SETTLE = 0.2
"""Fraction of measured pixels from which the settled recipe of a field may be reused for its neighbours."""

JITTER_TOLD = 0.04
"""z jitter of single frames, in steps, from which a note tells it; less is in the uncertainties only."""

FEW_HEIGHTS = 0.3
"""Measured fraction of the covered pixels below which a note tells why, and what to change."""

ADVICE: dict[Origin, str] = {
    Origin.CLIPPED: "is too bright: shorten the exposure, or take a second, shorter one.",
    Origin.NO_TEXTURE: "has no texture over the noise: give more light, from the side if possible, or another sweep if "
    "the sample is never sharp.",
    Origin.AMBIGUOUS: "has focus curves with several peaks, or wider than the focus width: give the aperture (NA) or "
    "focus_width_um, or more light against noise.",
    Origin.END_OF_RANGE: "is sharpest at an end of the sweep: start it lower or end it higher.",
    Origin.WINDOWS_DISAGREE: "has other heights in a wider window: give more light against noise.",
    Origin.BLEEDING_EDGE: 'lies beside edges over which light may bleed: on a sample without walls set edges = "none".',
    Origin.OUTLIER: 'lies off the heights around it: give more light against noise, or set outliers.mode = "none".',
    Origin.TOO_FEW_FRAMES: "lies outside of too many frames: reduce the drift of the stage, or add frames.",
    Origin.STEP_EDGE: 'lies at edges of steps: on a sample without walls set edges = "none".',
    Origin.NO_REASON: "has no reason: reconstruct its frames again.",
}
"""Reasons why most of a field is not measured, and what to change."""


def reconstruct(
    stack: FieldStack, recipe: Recipe = Recipe(), progress: Progress | None = None, threads: int | None = None
) -> HeightMap:
    """Return the height map of a field, by shape from focus.

    Parameters
    ----------
    stack : FieldStack
        Focus stack: images [k, row, col], uint8 or uint16, with a z in um for each frame. Further exposures of the same
        slots are fused.
    recipe : Recipe, optional
        Settings of the reconstruction; ``auto`` values are chosen from the stack. Default: ``Recipe()``.
    progress : callable, optional
        Receives the finished fraction, 0 to 1; an exception raised by it ends the work.
    threads : int, optional
        Number of threads. Default: all cores.

    Returns
    -------
    HeightMap
        Heights in um, with confidence, all-in-focus image and origin codes, which state why a pixel has no height. The
        provenance holds the recipe with the values chosen for ``auto``.

    Raises
    ------
    ComputeError
        For images that are not 8- or 16-bit grey, for fewer than three frames, for frames that lack a z or share one,
        and for exposures that cannot be compared.

    Notes
    -----
    Absent frames, flashes and dead frames are omitted; defective pixels are replaced, and drift is corrected if the
    recipe says so. `HeightMap.z_um` is smoothed, with small gaps filled, as the recipe says; `HeightMap.z_raw_um` is
    neither smoothed nor filled, and only gates and outlier removal apply.

    References
    ----------
    .. [1] S. K. Nayar, Y. Nakagawa, Shape from focus, IEEE Trans. Pattern Anal. Mach. Intell. 16 (1994) 824.
    """
    progress = progress or silent
    field = prepare_field(stack, recipe)
    peaks = search_peaks(field, threads, lambda share: progress(SEARCH_SHARE * share))
    return reconstruct_from_peaks(field, peaks, threads, progress).height_map


def reconstruct_from_peaks(
    field: PreparedField,
    peaks: Peaks,
    threads: int | None = None,
    progress: Progress = silent,
    silhouette: Silhouette | None = None,
    wide: WideLevels | None = None,
) -> ReconstructedField:
    """Run the stages after the peak search; progress continues from `SEARCH_SHARE` to 1.

    silhouette, wide: those of the frames, where they are known already.
    """
    gated = gate_peaks(field, peaks, wide)
    corrected = correct_edges(field, gated, threads, silhouette)
    progress(EDGES_SHARE)
    weighed = weigh_evidence(field, corrected, threads)
    cleaned = clean_heights(field, weighed)
    height_map = assemble(field, weighed, cleaned, threads)
    progress(1.0)
    return ReconstructedField(weighed, height_map)


@dataclass(frozen=True, slots=True, eq=False)
class ReconstructedField:
    """Height map of a field, or of a part of it, with the peaks and the evidence that explain it."""

    weighed: WeighedHeights
    height_map: HeightMap


# ------------------------------------------------------------------------------------------- frames and tuned recipe


@dataclass(frozen=True, slots=True, eq=False)
class PreparedField:
    """A field, or a part of it: stack, frames in use with their corrections, and the recipe tuned to them."""

    stack: FieldStack
    frames: Frames
    tuned: TunedRecipe

    def part(self, rows: slice, cols: slice) -> PreparedField:
        """Return the pixels [rows, cols], with corrections and recipe of the entire field."""
        return dataclasses.replace(self, frames=self.frames.part(rows, cols))


def prepare_field(stack: FieldStack, recipe: Recipe = Recipe(), samples: FrameSamples | None = None) -> PreparedField:
    """Select the frames, determine their corrections, and replace every `auto` of the recipe.

    samples: measurements of single frames that are known already.
    """
    frames = prepare(stack, recipe, samples)
    return PreparedField(stack, frames, tune_recipe(frames, recipe))


# --------------------------------------------------------------------------------------------------------------- peaks


def search_peaks(field: PreparedField, threads: int | None = None, progress: Progress = silent) -> Peaks:
    """Search the focus peak of every pixel, stripe by stripe."""
    return search_field(field.frames, field.tuned.search, threads, progress)


# --------------------------------------------------------------------------------------------------------------- gates


@dataclass(frozen=True, slots=True, eq=False)
class GatedPeaks:
    """Peaks with the tests of all gates, and the code of `Origin` of the first failed test, uint8 [row, col]."""

    peaks: Peaks
    tests: tuple[GateTest, ...]
    origin: NDArray[np.uint8]


def gate_peaks(field: PreparedField, peaks: Peaks, wide: WideLevels | None = None) -> GatedPeaks:
    """Test the peaks against noise, rivals, the ends of the sweep and a wider window, whose levels may be known."""
    frames, search, gate = field.frames, field.tuned.search, field.tuned.gate
    compared = np.isfinite(gate.window_tolerance_um)
    wide_um = wide_heights(peaks, frames.z_um, search, known=wide) if compared else None
    tests = checks(peaks, gate, frames.n_frames, wide_um)
    origin = first_failed(tests)
    np.copyto(origin, np.uint8(Origin.TOO_FEW_FRAMES), where=~frames.covered(search.margin_px))
    return GatedPeaks(peaks, tests, origin)


# --------------------------------------------------------------------------------------------------------------- edges


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedPeaks:
    """Peaks after the correction at edges: heights in um and codes of `Origin` [row, col].

    edges: None where there are no walls, and where the recipe does not search for them.
    """

    gated: GatedPeaks
    z_um: NDArray[np.float32]
    origin: NDArray[np.uint8]
    edges: BleedingEdges | None

    @property
    def searched_um(self) -> NDArray[np.float32]:
        """Heights as searched, before the correction."""
        return self.gated.peaks.z_um

    @property
    def found_along(self) -> NDArray[np.bool_]:
        """Mask of the heights that were searched again, along a wall."""
        return self.z_um != self.searched_um

    @property
    def measured_um(self) -> NDArray[np.float32]:
        """Heights of the measured pixels, NaN elsewhere."""
        return blanked(self.z_um, self.origin != Origin.MEASURED)


def correct_edges(
    field: PreparedField, gated: GatedPeaks, threads: int | None = None, silhouette: Silhouette | None = None
) -> CorrectedPeaks:
    """Reject heights made by light that bleeds over walls, and search them again along the wall."""
    how, z_um = field.tuned.edges, gated.peaks.z_um
    edges = None if how is None else find_edges(field.frames, how, gated.peaks, gated.origin, threads, silhouette)
    if edges is None:
        return CorrectedPeaks(gated, z_um, gated.origin, None)
    return CorrectedPeaks(gated, *judge_edges(z_um, gated.origin, edges), edges)


# ------------------------------------------------------------------------------------------------------------ evidence


@dataclass(frozen=True, slots=True, eq=False)
class WeighedHeights:
    """Heights with the probability that they are right, float32, and codes of `Origin`, all [row, col].

    probability: 0 where physics forbids a height, whatever speaks for it; origin: measured where it is large enough,
    else the first gate that the height failed or, where it passed all, the reason that speaks most against it;
    is_probability: False where the gates alone decided, and the confidence of the peaks stands for it.
    """

    corrected: CorrectedPeaks
    probability: NDArray[np.float32]
    origin: NDArray[np.uint8]
    is_probability: bool = True

    @property
    def measured_um(self) -> NDArray[np.float32]:
        """Heights of the measured pixels, NaN elsewhere."""
        return np.where(self.origin == Origin.MEASURED, self.corrected.z_um, np.float32(np.nan))


def weigh_evidence(field: PreparedField, corrected: CorrectedPeaks, threads: int | None = None) -> WeighedHeights:
    """Decide which heights count by the probability that they are right; by the gates alone where it may be 0."""
    recipe, least = field.tuned.recipe, float(field.tuned.recipe.least_probability)
    if not recipe.weighs_evidence:
        return WeighedHeights(corrected, corrected.gated.peaks.confidence, corrected.origin, is_probability=False)
    scores = evidence_scores(field, corrected, mirror_of(field, corrected.gated, threads))
    forbidden = vetoed(field, corrected)
    probability, origin = weigh(
        scores, least, trained_trees(), corrected.origin, forbidden, threads, untested(corrected)
    )
    if corrected.edges is not None:
        bled = (origin == Origin.BLEEDING_EDGE) & (corrected.edges.side == EdgeSide.AWAY)
        np.copyto(origin, np.uint8(Origin.AMBIGUOUS), where=bled)  # light from afar widens a curve
    enough = min(PROBABLE_ALONG, least)
    along = corrected.found_along & (corrected.origin == Origin.MEASURED) & (probability >= enough)
    np.copyto(origin, np.uint8(Origin.MEASURED), where=along)
    probable = origin == Origin.MEASURED
    np.copyto(origin, np.uint8(Origin.OUTLIER), where=probable & alone(probable, int(recipe.window)))
    return WeighedHeights(corrected, probability, origin)


def untested(corrected: CorrectedPeaks) -> tuple[Origin, ...]:
    """Return the reasons that nobody looked for: they explain no missing height."""
    compared = any(test.origin == Origin.WINDOWS_DISAGREE for test in corrected.gated.tests)
    off = {Origin.BLEEDING_EDGE: corrected.edges is None, Origin.WINDOWS_DISAGREE: not compared}
    return tuple(reason for reason, is_off in off.items() if is_off)


_NEVER_MEASURED = np.isin(
    np.arange(256), (Origin.BLEEDING_EDGE, Origin.NO_TEXTURE, Origin.TOO_FEW_FRAMES, Origin.NOT_COVERED)
)
"""Codes of `Origin` that no probability overrules."""


def vetoed(field: PreparedField, corrected: CorrectedPeaks) -> NDArray[np.bool_]:
    """Return a mask of what cannot be a measurement: bleeding light, too few frames, an end, one of two tops, noise.

    Where the focus does not rise over noise nothing was seen, and a height that fits its neighbours is theirs. The same
    holds for a peak that leads its rivals by no more than 99 % of the peaks of pure noise do.

    Near a wall only heights that passed the gates were judged by their side, and the others are as those of bleeding
    light. A height that the focus along a wall gave has a peak of its own.
    """
    forbidden = _NEVER_MEASURED[corrected.origin]
    (tops,) = (test for test in corrected.gated.tests if test.name == "tops")
    peaks, least_lead = corrected.gated.peaks, noise_scores(field.tuned.search, field.frames.n_frames).lead
    no_peak = (peaks.at_end | ~tops.passed | (peaks.lead <= least_lead)) & ~corrected.found_along
    if corrected.edges is not None:
        forbidden |= (corrected.edges.side != EdgeSide.AWAY) & (corrected.origin != Origin.MEASURED)
    return forbidden | no_peak | ~np.isfinite(corrected.z_um)


def mirror_of(field: PreparedField, gated: GatedPeaks, threads: int | None = None) -> Symmetry:
    """Return the symmetry of the light about the heights of cells, those that passed the gates where there are any."""
    search, peaks = field.tuned.search, gated.peaks
    every = np.ones(tuple(-(-n // COARSE_PX) for n in gated.origin.shape), np.bool_)
    heights_um = cell_medians(peaks.z_um, gated.origin == Origin.MEASURED, every)
    without = np.isnan(heights_um)
    np.copyto(heights_um, cell_medians(peaks.z_um, ~peaks.at_end, without), where=without)
    return mirror_sums(field.frames, heights_um, search.gap, search.camera, threads)


def evidence_scores(field: PreparedField, corrected: CorrectedPeaks, mirror: Symmetry) -> Scores:
    """Return the scores of every height, from which its probability follows."""
    frames, tuned, edges, gated = field.frames, field.tuned, corrected.edges, corrected.gated
    recipe = tuned.recipe
    units = Units(
        int(recipe.window),
        tuned.resolution_um,
        float(recipe.focus_width_um),
        field.stack.pixel_um,
        frames.step_um,
        frames.z_um,
        frames.clipped_counts,
    )
    accepted, bleeding = (corrected.origin == code for code in (Origin.MEASURED, Origin.BLEEDING_EDGE))
    side = None if edges is None else edges.side
    return scores_of(gated.peaks, gated.tests, corrected.z_um, accepted, bleeding, side, mirror, units)


# ------------------------------------------------------------------------------------------------------------ cleaning


@dataclass(frozen=True, slots=True, eq=False)
class CleanedHeights:
    """Heights after cleaning, float32 [row, col], NaN where there is none.

    z_um: smoothed, with small gaps filled; z_raw_um: measured; origin: codes of `Origin`; refused: heights of the peaks
    that do not count.
    """

    z_um: NDArray[np.float32]
    z_raw_um: NDArray[np.float32]
    origin: NDArray[np.uint8]
    refused: RefusedHeights


def clean_heights(field: PreparedField, weighed: WeighedHeights) -> CleanedHeights:
    """Smooth heights, remove outliers, and fill small gaps."""
    tuned = field.tuned
    found = clean(weighed.measured_um, field.stack.pixel_um, tuned.recipe, tuned.resolution_um)
    origin = np.where(found.outlier, np.uint8(Origin.OUTLIER), weighed.origin)
    refused = _refused_heights(weighed.corrected, origin)
    return CleanedHeights(found.z_um, found.raw_um, mark_filled(origin, found.z_um), refused)


def _refused_heights(corrected: CorrectedPeaks, origin: NDArray[np.uint8]) -> RefusedHeights:
    """Return the heights of every covered pixel that is not measured and has a peak; origin: before gaps are filled."""
    refused = (origin != Origin.MEASURED) & (origin != Origin.NOT_COVERED) & np.isfinite(corrected.z_um)
    return RefusedHeights(np.flatnonzero(refused).astype(np.uint32), corrected.z_um[refused], origin[refused])


# ---------------------------------------------------------------------------------------------------------- height map


def assemble(
    field: PreparedField, weighed: WeighedHeights, cleaned: CleanedHeights, threads: int | None = None
) -> HeightMap:
    """Return the height map with its layers, position and provenance."""
    stack, corrected = field.stack, weighed.corrected
    health, jitter_note = frame_health(field, cleaned.z_raw_um)
    picture = field.frames.as_stored_counts(read_picture(field, corrected, cleaned, threads))
    return HeightMap(
        z_um=cleaned.z_um,
        z_raw_um=cleaned.z_raw_um,
        confidence=weighed.probability,
        all_in_focus=without_shading(picture, field.frames.shading),
        origin=cleaned.origin,
        pixel_um=stack.pixel_um,
        x0_um=stack.x0_um,
        y0_um=stack.y0_um,
        provenance=Provenance(
            recipe=field.tuned.recipe,
            calibration=stack.calibration,
            software_version=__version__,
            input_checksum=stack.checksum,
            simulated=stack.simulated,
            z_step_um=field.frames.step_um,
            even_step_um=field.frames.even_step_um,
            frame_health=health,
            positions_assumed=stack.positions_assumed,
            notes=(*stack.notes, *field.frames.notes, *field.tuned.notes, *jitter_note, *few_heights(cleaned.origin)),
        ),
        u_um=uncertainty(field, corrected, cleaned, health),
        refused=cleaned.refused,
    )


def few_heights(origin: NDArray[np.uint8]) -> tuple[str, ...]:
    """Return a note with the most frequent reason of unmeasured pixels where few are measured; origin: `Origin`."""
    measured, covered = np.count_nonzero(origin == Origin.MEASURED), np.count_nonzero(origin != Origin.NOT_COVERED)
    if measured >= FEW_HEIGHTS * covered:
        return ()
    count = np.bincount(origin.ravel(), minlength=max(Origin) + 1)
    reason = max(ADVICE, key=lambda reason: count[reason])
    return (f"Under {100 * FEW_HEIGHTS:g} % of a field is measured; most of the rest {ADVICE[reason]}",)


def uncertainty(
    field: PreparedField, corrected: CorrectedPeaks, cleaned: CleanedHeights, health: FrameHealth
) -> NDArray[np.float32] | None:
    """Return the standard uncertainty of each measured height; None for peaks whose noise is not propagated.

    A height that was searched again at a wall has another curve than its peak: its uncertainty is not known.
    """
    recipe, search = field.tuned.recipe, field.tuned.search
    if not PEAKS[recipe.peak].centred:
        return None
    noise_um = corrected.gated.peaks.noise_um
    if corrected.edges is not None:
        noise_um = blanked(noise_um, corrected.found_along)
    passes = focus_measures()[search.measure].passes
    u_um = uncertainty_um(noise_um, cleaned.z_raw_um, search.window, passes, health)
    return add_gaps(u_um, cleaned.z_raw_um, frame_gaps(field.frames.z_um, _depth_um(field)))


def read_picture(
    field: PreparedField, corrected: CorrectedPeaks, cleaned: CleanedHeights, threads: int | None = None
) -> Image:
    """Return the all-in-focus image, read at the cleaned heights."""
    fit = FrameFit.of(field.frames, float(field.tuned.recipe.focus_width_um), threads)
    measured = cleaned.origin < UNMEASURED_FROM
    walls, min_contrast = corrected.edges is not None, field.tuned.gate.min_contrast
    return all_in_focus(corrected.gated.peaks, cleaned.z_um, measured, walls, min_contrast, fit)


def frame_health(field: PreparedField, z_raw_um: NDArray[np.float32]) -> tuple[FrameHealth, tuple[str, ...]]:
    """Return the uncertainty of a height from the z and the light of the frames, and a note on jitter or a wrong order.

    The peaks of the paper's estimator are rounded to frames, which hides both.
    """
    frames, step_um = field.frames, field.frames.step_um
    if field.tuned.recipe.peak == "argmax":
        return FrameHealth(), ()
    depth_um = _depth_um(field)
    means = block_means(frames, depth_um)
    flicker_um = flicker_u_um(frames.flicker_rest, step_um, depth_um)
    jitter_um = max(
        jitter_effect_um(z_raw_um, frames.z_um, depth_um),
        jitter_u_um(frame_jitter(means, frames.z_um, step_um).widened_um, step_um, depth_um),
    )
    gap_um = worst_gap_u_um(frame_gaps(frames.z_um, depth_um), z_raw_um)
    between_um = interpolation_u_um(field.tuned.recipe.peak, step_um, field.tuned.peak_width_um)
    health = FrameHealth(u_between_um=between_um, u_jitter_um=jitter_um, u_flicker_um=flicker_um, u_gap_um=gap_um)
    single_um = jitter_um / jitter_u_um(1.0, step_um, depth_um)
    told_um = single_um if single_um >= JITTER_TOLD * step_um else 0.0
    order = order_without_jitter(means, frames.z_um, step_um, told_um)
    if order is not None:
        return health, (_order_note(frames.stored[0].slots[list(order)] + 1),)
    if not told_um:
        return health, ()
    note = (
        f"The z of single frames jitters by about {single_um:.2g} um (standard deviation), which adds "
        f"{jitter_um:.2g} um to the standard uncertainty of heights: check the z axis for vibration."
    )
    return health, (note,)


def _order_note(numbers: NDArray[np.intp]) -> str:
    runs = np.split(numbers, np.flatnonzero(np.abs(np.diff(numbers)) != 1) + 1)
    shown = [str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs[:_SHOWN_RUNS]]
    return (
        "The frames are not in the order of their z, and heights are wrong: their images change evenly in another "
        f"order, {', '.join(shown)}{' ...' if len(runs) > _SHOWN_RUNS else ''} (frames from 1). Give the images in "
        "that order, or each its own z."
    )


_SHOWN_RUNS = 8
"""Runs of frame numbers that a note names."""


def _depth_um(field: PreparedField) -> float:
    """Return the depth of field, by the width of the focus curves where the objective is unknown."""
    return field.frames.depth_of_field_um or float(field.tuned.recipe.focus_width_um) / FOCUS_WIDTH_DEPTHS


# ------------------------------------------------------------------------------------------ recipes of a scan, warm-up


def settled_recipe(stack: FieldStack, recipe: Recipe = Recipe()) -> Recipe:
    """Replace every `auto` of a recipe by values from this stack, for use by all fields of a scan."""
    return prepare_field(stack, recipe).tuned.recipe


def is_representative(surface: HeightMap) -> bool:
    """Return whether enough of a field is measured to reuse its settled recipe for the neighbouring fields."""
    return bool(surface.measured.mean() >= ENOUGH_TO_SETTLE)


def warm_up(dtype: Any = np.uint8, recipe: Recipe = Recipe()) -> None:
    """Compile every kernel, or load the cached compilation, using a tiny stack that is sharp in the middle."""
    stack = _tiny_stack(dtype)
    reconstruct(stack, recipe, threads=1)
    membrane(np.where(np.eye(4, dtype=np.bool_), np.float32(0), np.float32(np.nan)))
    if recipe.edges != "none":
        warm_up_edges(prepare(stack), window=9)


def warm_up_search() -> None:
    """Compile or load the kernels of the first stages, up to the peak search."""
    search_peaks(prepare_field(_tiny_stack(np.uint8)), threads=1)


def warm_up_stages() -> None:
    """Compile or load the kernels of the stages after the peak search; they need no peaks for that."""
    frames = prepare(_tiny_stack(np.uint8))
    z_um = np.random.default_rng(1).normal(0, 0.1, frames.shape).astype(np.float32)
    z_um[::7, ::5], z_um[::9, ::11] = 5.0, np.nan
    uncertainty_um(np.ones_like(z_um), z_um, 9, 2, FrameHealth(u_between_um=0.1))
    peaks = Peaks.empty(frames.shape, frames.dtype)
    for layer in (*peaks.scores, peaks.at_end, peaks.clipped):
        layer[:] = 0
    all_in_focus(peaks, z_um, np.isfinite(z_um), False, 0.0, FrameFit.of(frames, 3.0))
    recipe = settle_cleaning([z_um], replace(Recipe(), window=9, focus_width_um=3.0), 1.0)
    clean(z_um, 1.0, recipe, 1.0)
    warm_up_edges(frames, window=9)
    warm_up_evidence()


def _tiny_stack(dtype: Any) -> FieldStack:
    """Return a stack of a few pixels that is sharp in the middle."""
    n_frames = LEAST_FRAMES  # in fewer the windows are not compared
    sharp = 5 + 40 * np.exp(-((np.arange(n_frames) - n_frames // 2) ** 2.0))[:, None, None]
    grey = (128 + sharp * np.random.default_rng(0).normal(0, 1, (n_frames, 48, 64))).clip(0, 255).astype(dtype)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
    return FieldStack(field, grey, np.arange(float(n_frames)), np.ones(n_frames, bool), 1.0)
