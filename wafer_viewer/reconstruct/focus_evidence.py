"""Diagnosis of a single pixel: reconstruct a small region around it and report every gate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.focus_curve import FocusCurve, Rival, Verdict
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.auto_tuning import tune_recipe
from wafer_viewer.reconstruct.field_pipeline import build_height_map, settled_recipe
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import Search, ThreadScratch, search_field, search_part
from wafer_viewer.reconstruct.preprocess.frames import Frames, prepare, read_block
from wafer_viewer.reconstruct.validity import validate_peaks

MOST_RIVALS = 3
_LEFT_OUT_BY_CLEANING = {
    Origin.OUTLIER: "Does it agree with its neighbours?",
    Origin.STEP_EDGE: "Are the heights around it of one surface?",
}
REACH_PX = 80
"""Half size of the reconstructed region around the pixel, larger than the reach of any gate."""
COARSE_PX = 4
"""Alignment of the region, so that its coarse maps coincide with those of the field."""


def focus_curve(stack: FieldStack, x_um: float, y_um: float, recipe: Recipe = Recipe()) -> FocusCurve:
    """Return the focus curve of a pixel with its peak, rivals and verdicts.

    Only the surroundings of the pixel, 80 pixels to each side, are reconstructed, and every gate is reported.

    Parameters
    ----------
    stack : FieldStack
        Focus stack of the field that contains the position.
    x_um : float
        Stage x in um; the nearest pixel is used.
    y_um : float
        Stage y in um.
    recipe : Recipe, optional
        Settings of the reconstruction, preferably the recipe in the provenance of the surface. Parameters of the
        heights that are still ``auto`` are settled on the complete stack. Default: ``Recipe()``.

    Returns
    -------
    FocusCurve
        Focus measure (fraction of its maximum) and grey value of the pixel in each frame in use, z rising in um; peak,
        at most three rivals, verdict of every gate, and height in um, None if unmeasured.

    Raises
    ------
    ComputeError
        When the position is outside the field, and for every stack that `reconstruct` rejects.
    """
    row, col = pixel_at(stack, x_um, y_um)
    recipe = settled_recipe(stack, recipe) if recipe.heights_have_auto else recipe
    rows, cols = _around(row), _around(col)
    part, r, c = stack.part(rows, cols), row - rows.start, col - cols.start
    frames = prepare(stack, recipe).part(rows, cols)
    settled = tune_recipe(frames, recipe)
    peaks = search_field(frames, settled.search, threads=1)
    judged = validate_peaks(frames, settled, peaks, threads=1)
    height = build_height_map(part, frames, settled, judged)
    curve, grey = curve_at(frames, settled.search, r, c)
    peak = int(curve.argmax())
    z_um, origin = float(height.z_raw_um[r, c]), Origin(int(height.origin[r, c]))
    return FocusCurve(
        field=stack.field.number,
        row=row,
        col=col,
        x_um=stack.x0_um + col * stack.pixel_um,
        y_um=stack.y0_um - row * stack.pixel_um,
        focus_measure=recipe.focus_measure,
        window=settled.search.window,
        z_um=tuple(frames.z_um.tolist()),
        focus=tuple(curve.tolist()),
        grey=tuple(grey.tolist()),
        peak_z_um=float(peaks.z_um[r, c]),
        height_um=z_um if np.isfinite(z_um) else None,
        origin=ORIGIN_TITLES[origin],
        confidence=float(peaks.confidence[r, c]),
        rivals=rivals_of(frames.z_um, curve, peak, settled.search.gap),
        verdicts=(*judged.verdicts(r, c), *cleaning_verdicts(origin)),
        simulated=stack.simulated,
    )


def curve_at(frames: Frames, search: Search, row: int, col: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the focus measure of a pixel in each frame, as a fraction of its maximum, and its grey values."""
    bench = ThreadScratch.make(frames.n_frames, (1, 1), search, frames.dtype)
    search_part(frames, slice(row, row + 1), slice(col, col + 1), search, bench, Peaks.empty((1, 1), bench.block.dtype))
    levels = bench.curves.levels[:, 0, 0].astype(np.int64)
    bits, table = bench.spots.bits, bench.spots.table
    log2 = (levels >> bits) + table[levels & (table.size - 1)]
    grey = np.empty((frames.n_frames, 1, 1), frames.dtype)
    read_block(frames, slice(row, row + 1), slice(col, col + 1), 0, grey)
    return np.exp2(log2 - log2.max()), grey[:, 0, 0].astype(np.int64)


def cleaning_verdicts(origin: Origin) -> tuple[Verdict, ...]:
    """Return the verdict of the cleaning step for a pixel that passed every gate."""
    question = _LEFT_OUT_BY_CLEANING.get(origin)
    if question is None:
        return ()
    gate = origin.name.lower()
    return (Verdict(gate=gate, question=question, score=None, limit=None, unit="", passed=False),)


def pixel_at(stack: FieldStack, x_um: float, y_um: float) -> tuple[int, int]:
    """Return the row and column of the pixel nearest to a position. Raises ComputeError outside the field."""
    row, col = round((stack.y0_um - y_um) / stack.pixel_um), round((x_um - stack.x0_um) / stack.pixel_um)
    if not (0 <= row < stack.images.shape[1] and 0 <= col < stack.images.shape[2]):
        raise ComputeError(
            f"({x_um:.1f}, {y_um:.1f}) um lies outside of field {stack.field.number}, which is centred on "
            f"({stack.field.x_um:.1f}, {stack.field.y_um:.1f}) um: choose another field or place."
        )
    return row, col


def rivals_of(z_um: NDArray[np.float64], focus: NDArray[np.float64], peak: int, gap: int) -> tuple[Rival, ...]:
    """Return the other local maxima at least `gap` frames from the peak, in descending order."""
    inner = np.r_[True, focus[1:] >= focus[:-1]] & np.r_[focus[:-1] >= focus[1:], True]
    found = [k for k in np.flatnonzero(inner) if abs(k - peak) >= gap]
    found.sort(key=lambda k: -focus[k])
    return tuple(Rival(z_um=float(z_um[k]), share=float(focus[k] / focus[peak])) for k in found[:MOST_RIVALS])


def _around(n: int) -> slice:
    """Return the rows, or columns, around a pixel."""
    return slice(max(0, n - REACH_PX) // COARSE_PX * COARSE_PX, n + REACH_PX + 1)
