"""Diagnosis of a single pixel: reconstruct a small region around it and report every test."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.focus_curve import FocusCurve, Rival, Verdict
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import (
    CorrectedPeaks,
    PreparedField,
    ReconstructedField,
    WeighedHeights,
    prepare_field,
    reconstruct_from_peaks,
    search_peaks,
)
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import ThreadScratch, search_block
from wafer_viewer.reconstruct.frame_blocks import StackWindow, developed, read_part
from wafer_viewer.reconstruct.gates.edge_bleeding import BleedingEdges
from wafer_viewer.reconstruct.gates.edge_sides import EdgeSide
from wafer_viewer.reconstruct.gates.gate import POWERS, GateTest

MOST_RIVALS = 3
"""Largest number of rivals that a focus curve lists."""
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
    rows, cols = _around(row), _around(col)
    field, r, c = prepare_field(stack, recipe).part(rows, cols), row - rows.start, col - cols.start
    search, z_um = field.tuned.search, field.frames.z_um
    peaks = search_peaks(field, threads=1)
    found = reconstruct_from_peaks(field, peaks, threads=1)
    height_um, origin = float(found.height_map.z_raw_um[r, c]), Origin(int(found.height_map.origin[r, c]))
    curve, grey = curve_at(field, r, c)
    least = float(field.tuned.recipe.least_probability)
    return FocusCurve(
        field=stack.field.number,
        row=row,
        col=col,
        x_um=stack.x0_um + col * stack.pixel_um,
        y_um=stack.y0_um - row * stack.pixel_um,
        focus_measure=recipe.focus_measure,
        window=search.window,
        z_um=tuple(z_um.tolist()),
        focus=tuple(curve.tolist()),
        grey=tuple(grey.tolist()),
        peak_z_um=float(peaks.z_um[r, c]),
        height_um=_finite(height_um),
        origin=ORIGIN_TITLES[origin],
        confidence=float(found.height_map.confidence[r, c]),
        rivals=rivals_of(z_um, curve, int(curve.argmax()), search.gap),
        verdicts=(*verdicts_of(found.weighed, r, c, least), *cleaning_verdicts(found, r, c)),
        simulated=stack.simulated,
        u_um=None if found.height_map.u_um is None else _finite(float(found.height_map.u_um[r, c])),
    )


def curve_at(field: PreparedField, row: int, col: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the focus measure of a pixel in each frame, as a fraction of its maximum, and its grey values."""
    frames, search, pixel = field.frames, field.tuned.search, StackWindow(slice(row, row + 1), slice(col, col + 1))
    bench = ThreadScratch.make(frames.n_frames, (1, 1), search, frames.dtype)
    for _, block in developed(frames, [pixel], search.margin_px):
        search_block(block, frames.z_um, search, bench, Peaks.empty((1, 1), frames.dtype))
    log2 = bench.spots.table.logarithms(bench.curves.levels[:, 0, 0])
    grey = read_part(frames, pixel)[:, 0, 0]
    return np.exp2(log2 - log2.max()), frames.as_stored_counts(grey).astype(np.int64)


def verdicts_of(weighed: WeighedHeights, row: int, col: int, least_probability: float) -> tuple[Verdict, ...]:
    """Return the verdict of every gate on a pixel, of the tests at edges, and of the probability of its height."""
    corrected = weighed.corrected
    gates = (_gate_verdict(test, row, col) for test in corrected.gated.tests)
    probable = Verdict(
        gate="evidence",
        question="Is the height probable by all its evidence?",
        score=float(weighed.probability[row, col]),
        limit=least_probability,
        unit="probability",
        passed=bool(weighed.origin[row, col] == Origin.MEASURED),
        note="Whatever speaks for it, no height counts there." if weighed.probability[row, col] == 0 else "",
    )
    return (*gates, *_edge_verdicts(corrected, row, col), *((probable,) if weighed.is_probability else ()))


def cleaning_verdicts(found: ReconstructedField, row: int, col: int) -> tuple[Verdict, ...]:
    """Return the verdict of the cleaning step for a pixel that counted before."""
    before, height_map = found.weighed.origin[row, col], found.height_map
    if before != Origin.MEASURED or np.isfinite(height_map.z_raw_um[row, col]):
        return ()
    question = "Does it agree with its neighbours?"
    return (Verdict(gate="outlier", question=question, score=None, limit=None, unit="", passed=False),)


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


def _gate_verdict(test: GateTest, row: int, col: int) -> Verdict:
    return Verdict(
        gate=test.name,
        question=test.question,
        score=_finite(test.score[row, col]),
        limit=_finite(test.limit),
        unit=test.unit,
        passed=bool(test.passed[row, col]),
        note="" if np.isfinite(test.limit) else "This gate is off.",
    )


def _edge_verdicts(corrected: CorrectedPeaks, row: int, col: int) -> tuple[Verdict, ...]:
    """Return the verdicts near a wall: agreement with the pixel's own side, and focus along the wall."""
    edges = corrected.edges
    if edges is None or edges.side[row, col] == EdgeSide.AWAY:
        return ()
    off_um = abs(float(corrected.searched_um[row, col]) - float(edges.expected_um[row, col]))
    side_is_known = edges.side[row, col] != EdgeSide.OUTLINE
    outline_verdict = Verdict(
        gate="edge",
        question="Is the height that of the surface further from the wall?",
        score=_finite(off_um),
        limit=edges.tolerance_um,
        unit="um",
        passed=bool(side_is_known and off_um < edges.tolerance_um),
        note=_wall_side_note(edges, row, col),
    )
    if edges.side[row, col] != EdgeSide.DARK:
        return (outline_verdict,)
    along = Verdict(
        gate="along",
        question="Does the focus along the wall peak at that height?",
        score=_finite(edges.fall[row, col]),
        limit=edges.min_fall,
        unit=POWERS,
        passed=bool(edges.along[row, col]),
        note=_along_note(edges, row, col),
    )
    return outline_verdict, along


def _along_note(edges: BleedingEdges, row: int, col: int) -> str:
    """Return what follows where the focus along the wall does not peak, or is not looked at."""
    if edges.below_line[row, col]:
        return "Below a bright line, as of a polished rim, no height counts: the focus is that of the ground beyond."
    if edges.unconfirmed[row, col]:
        return "Where it does not, the focus may be that of the outline of the wall."
    return ""


def _wall_side_note(edges: BleedingEdges, row: int, col: int) -> str:
    """Return a note with the pixel's side of the wall and any missing reference height."""
    labels = {
        EdgeSide.DARK: "On the dark side of a wall",
        EdgeSide.BRIGHT: "On the bright side of a wall",
        EdgeSide.OUTLINE: "On the outline of a wall, neither side's for sure",
    }[EdgeSide(int(edges.side[row, col]))]
    side_is_known = np.isfinite(edges.expected_um[row, col]) or edges.side[row, col] == EdgeSide.OUTLINE
    return f"{labels}." if side_is_known else f"{labels}, with nothing measured further from it."


def _finite(value: float | np.floating[Any]) -> float | None:
    return float(value) if np.isfinite(value) else None
