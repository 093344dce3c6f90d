"""Reconstruction of a height map from the focus stack of a field."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer._version import __version__
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance, RefusedHeights
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.auto_tuning import TunedSearch, tune_recipe
from wafer_viewer.reconstruct.cleaning.clean import clean, mark_filled
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import Progress, coarse_step, search_field
from wafer_viewer.reconstruct.gates import edge_bleeding
from wafer_viewer.reconstruct.gates.gate import LEAST_FRAMES
from wafer_viewer.reconstruct.preprocess.frames import Frames, prepare
from wafer_viewer.reconstruct.validity import ValidatedPeaks, validate_peaks

ENOUGH_TO_SETTLE = 0.2
"""Fraction of measured pixels from which the settled recipe of a field may be reused for its neighbours."""


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
    frames = prepare(stack, recipe)
    settled = tune_recipe(frames, recipe)
    peaks = search_field(frames, settled.search, threads, progress)
    return surface_of(stack, frames, settled, peaks, threads)


def surface_of(
    stack: FieldStack, frames: Frames, settled: TunedSearch, peaks: Peaks, threads: int | None = None
) -> HeightMap:
    """Return the height map of frames whose peaks have been searched."""
    return build_height_map(stack, frames, settled, validate_peaks(frames, settled, peaks, threads))


def settled_recipe(stack: FieldStack, recipe: Recipe = Recipe()) -> Recipe:
    """Replace every `auto` of a recipe by values from this stack, for use by all fields of a scan."""
    return tune_recipe(prepare(stack, recipe), recipe).recipe


def is_representative(surface: HeightMap) -> bool:
    """Return whether enough of a field is measured to reuse its settled recipe for the neighbouring fields."""
    return bool(surface.measured.mean() >= ENOUGH_TO_SETTLE)


def build_height_map(stack: FieldStack, frames: Frames, settled: TunedSearch, judged: ValidatedPeaks) -> HeightMap:
    """Smooth heights, remove outliers and fill small gaps; z_raw_um only has the outliers removed."""
    peaks, origin = judged.peaks, judged.origin
    recipe, resolution_um = settled.recipe, settled.resolution_um
    raw = np.where(origin == Origin.MEASURED, peaks.z_um, np.float32(np.nan))
    clear = clean(raw, stack.pixel_um, recipe, resolution_um, judged.told_apart, judged.bled_um)
    origin = np.where(clear.outlier, np.uint8(Origin.OUTLIER), origin)
    origin = np.where(clear.step_edge, np.uint8(Origin.STEP_EDGE), origin)
    return HeightMap(
        z_um=clear.z_um,
        z_raw_um=clear.raw_um,
        confidence=peaks.confidence,
        all_in_focus=peaks.all_in_focus,
        origin=mark_filled(origin, clear.z_um),
        pixel_um=stack.pixel_um,
        x0_um=stack.x0_um,
        y0_um=stack.y0_um,
        provenance=_provenance(stack, frames, recipe, (*settled.notes, *judged.notes)),
        refused=refused_heights(judged, origin),
    )


def refused_heights(judged: ValidatedPeaks, origin: NDArray[np.uint8]) -> RefusedHeights:
    """Return the heights that gates, outlier removal and the edges of steps refused.

    Parameters
    ----------
    judged
        Peaks of a field. A peak that a gate refused has the height that the search saw; one refused later has its
        height after the edges were judged.
    origin
        Codes of `Origin` before gaps were filled; uint8 [row, col].

    Returns
    -------
    RefusedHeights
        Every covered pixel that is not measured and has a peak.
    """
    z_um = np.where(judged.origin == Origin.MEASURED, judged.peaks.z_um, judged.seen_um)
    refused = (origin != Origin.MEASURED) & (origin != Origin.NOT_COVERED) & np.isfinite(z_um)
    at = np.flatnonzero(refused)
    return RefusedHeights(at.astype(np.uint32), z_um.ravel()[at], origin.ravel()[at].astype(np.uint8))


def warm_up(dtype: Any = np.uint8, recipe: Recipe = Recipe()) -> None:
    """Compile every kernel, or load the cached compilation, using a tiny stack that is sharp in the middle."""
    n_frames = LEAST_FRAMES  # in fewer the windows are not compared
    sharp = 5 + 40 * np.exp(-((np.arange(n_frames) - n_frames // 2) ** 2.0))[:, None, None]
    grey = (128 + sharp * np.random.default_rng(0).normal(0, 1, (n_frames, 48, 64))).clip(0, 255).astype(dtype)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
    stack = FieldStack(field, grey, np.arange(float(n_frames)), np.ones(n_frames, bool), 1.0)
    reconstruct(stack, recipe, threads=1)
    if recipe.edges != "none":
        edge_bleeding.warm_up(prepare(stack), window=9)


def _provenance(stack: FieldStack, frames: Frames, recipe: Recipe, notes: tuple[str, ...]) -> Provenance:
    coarse = coarse_step(frames.step_um, frames.depth_of_field_um, _number(recipe.focus_width_um))
    return Provenance(
        recipe=recipe,
        calibration=stack.calibration,
        software_version=__version__,
        input_checksum=stack.checksum,
        simulated=stack.simulated,
        z_step_um=frames.step_um,
        notes=(*frames.notes, *coarse, *notes),
    )


def _number(value: float | str) -> float:
    """Return a settled parameter, which is no longer `auto`, as a number."""
    return float(value)
