"""Validation of the peaks of a field: the gates in order, then the edges."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.focus_curve import Verdict
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.reconstruct.auto_tuning import GAP_WIDTHS, TunedSearch
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import Search, noise_scores, wide_heights
from wafer_viewer.reconstruct.gates.edge_bleeding import BleedingEdges, EdgeSearch, find_edges, judge_edges
from wafer_viewer.reconstruct.gates.edge_sides import STANDING_GAPS, EdgeSide
from wafer_viewer.reconstruct.gates.gate import LEAST_FRAMES, POWERS, Gate, GateTest, checks, first_failed, gate_of
from wafer_viewer.reconstruct.preprocess.frames import Frames, mark_uncovered

WINDOW_STEPS = 1.5
"""Tolerance between the heights of two windows, in steps of the resolution."""

TOO_WIDE = 2.0
"""Largest plausible focus width, in depths of field; wide-open and apodised pupils reach 1.5."""

LEAST_GAP = 4
"""Minimum rival gap in frames: focus along a wall is smoothed over three frames and placed by three more."""


@dataclass(frozen=True, slots=True, eq=False)
class ValidatedPeaks:
    """Peaks of a field after validation, with bled heights replaced by heights found along walls.

    seen_um: heights as searched, before the edges were processed, float32 [row, col]; origin: codes of `Origin` [row,
    col]; checks: the gates with their scores; edges: None where there are no walls or the recipe does not search for
    them, which edges_asked distinguishes; notes: one sentence for the gates that the recipe requests and that are off.
    """

    peaks: Peaks
    seen_um: NDArray[np.float32]
    origin: NDArray[np.uint8]
    checks: tuple[GateTest, ...]
    edges: BleedingEdges | None
    edges_asked: bool
    notes: tuple[str, ...] = ()

    @property
    def told_apart(self) -> NDArray[np.bool_] | None:
        """Mask of pixels with a known wall side; None where edges were not searched for."""
        if not self.edges_asked:
            return None
        return np.zeros(self.origin.shape, np.bool_) if self.edges is None else self.edges.side != EdgeSide.AWAY

    @property
    def bled_um(self) -> NDArray[np.float32] | None:
        """Searched heights where light bled, NaN elsewhere; None where there are no walls."""
        if self.edges is None:
            return None
        return np.where(self.origin == Origin.BLEEDING_EDGE, self.seen_um, np.float32(np.nan))

    def verdicts(self, row: int, col: int) -> tuple[Verdict, ...]:
        """Return the verdict of every gate on a pixel, the most explanatory first."""
        return (*(_verdict(check, row, col) for check in self.checks), *_edge_verdicts(self, row, col))


def validate_peaks(frames: Frames, settled: TunedSearch, peaks: Peaks, threads: int | None = None) -> ValidatedPeaks:
    """Apply all gates and the edge processing of the recipe to the peaks of a field.

    threads: all cores if omitted.
    """
    gate, enough = gate_for(settled, frames.n_frames), frames.n_frames >= LEAST_FRAMES
    compare = np.isfinite(gate.window_tolerance_um)
    wide_um = wide_heights(peaks, frames.z_um, settled.search) if compare else None
    asked = checks(peaks, gate, frames.n_frames, wide_um)
    origin = mark_uncovered(first_failed(asked), frames, settled.search.margin_px)
    how = edge_search(settled) if enough else None
    edges = None if how is None else find_edges(frames, how, peaks, origin, threads)
    seen_um = z_um = peaks.z_um
    if edges is not None:
        z_um, origin = judge_edges(seen_um, origin, edges)
    notes = (
        _disabled_gates_note(settled, frames.n_frames)
        if not enough
        else _walls_untested(frames, settled)
        if how
        else ()
    )
    return ValidatedPeaks(dataclasses.replace(peaks, z_um=z_um), seen_um, origin, asked, edges, how is not None, notes)


def gate_for(settled: TunedSearch, n_frames: int) -> Gate:
    """Return the gate of a settled recipe; windows are compared only in stacks that are long enough."""
    recipe, compare = settled.recipe, settled.recipe.compare_windows and n_frames >= LEAST_FRAMES
    return gate_of(
        noise_scores(settled.search, n_frames),
        float(recipe.min_confidence),
        recipe.clipped_fraction,
        settled.search.window,
        WINDOW_STEPS * settled.resolution_um if compare else np.inf,
    )


def edge_search(settled: TunedSearch) -> EdgeSearch | None:
    """Return the edge search of the recipe; None if edges or gating are disabled."""
    mode, search = settled.recipe.edges, settled.search
    if mode == "none" or float(settled.recipe.min_confidence) <= 0:
        return None
    gap = max(search.gap, LEAST_GAP)
    return EdgeSearch(mode, window_along(search), gap, search.camera, settled.resolution_um)


def window_along(search: Search) -> int:
    """Return the window of the focus along walls: a box applied twice, as wide as that of the search.

    A box applied n times is as wide as a single box sqrt(n) times its size.
    """
    boxes = focus_measures()[search.measure].passes
    return 2 * round((search.window * np.sqrt(boxes / 2) - 1) / 2) + 1


def _disabled_gates_note(settled: TunedSearch, n_frames: int) -> tuple[str, ...]:
    """Return a note on the requested gates that are disabled in a short stack."""
    recipe = settled.recipe
    wanted = (
        ("windows are not compared", recipe.compare_windows),
        ("edges are not looked for", recipe.edges != "none"),
    )
    off = " and ".join(words for words, asked in wanted if asked)
    return (f"The stack has {n_frames} frames: in fewer than {LEAST_FRAMES} {off}.",) if off else ()


def _walls_untested(frames: Frames, settled: TunedSearch) -> tuple[str, ...]:
    """Return a note where the focus width is too large, against the optics or the sweep, to detect walls."""
    width_um, depth_um = float(settled.recipe.focus_width_um), frames.depth_of_field_um
    sweep_um, least_um = float(np.ptp(frames.z_um)), STANDING_GAPS * GAP_WIDTHS * width_um
    if depth_um > 0 and width_um > TOO_WIDE * max(depth_um, frames.step_um):
        return (
            f"Walls between bright and dark heights could not be tested: the focus width of {width_um:.3g} um is "
            f"{width_um / depth_um:.2g} times the depth of field. Leave focus_width_um to the data.",
        )
    if sweep_um < least_um:
        return (
            f"Walls between bright and dark heights could not be tested: they show in a sweep of {least_um:.3g} um or "
            f"more, and this one is {sweep_um:.3g} um long.",
        )
    return ()


def _verdict(check: GateTest, row: int, col: int) -> Verdict:
    return Verdict(
        gate=check.name,
        question=check.question,
        score=_number(check.score[row, col]),
        limit=_number(check.limit),
        unit=check.unit,
        passed=bool(check.passed[row, col]),
        note="" if np.isfinite(check.limit) else "This gate is off.",
    )


def _edge_verdicts(judged: ValidatedPeaks, row: int, col: int) -> tuple[Verdict, ...]:
    """Return the verdicts near a wall: agreement with the pixel's own side, and focus along the wall."""
    edges = judged.edges
    if edges is None or edges.side[row, col] == EdgeSide.AWAY:
        return ()
    off_um = abs(float(judged.seen_um[row, col]) - float(edges.expected_um[row, col]))
    known = edges.side[row, col] != EdgeSide.OUTLINE
    beside = Verdict(
        gate="edge",
        question="Is the height that of the surface further from the wall?",
        score=_number(off_um),
        limit=edges.tolerance_um,
        unit="um",
        passed=bool(known and off_um < edges.tolerance_um),
        note=_wall_side_note(edges, row, col),
    )
    if edges.side[row, col] != EdgeSide.DARK:
        return (beside,)
    along = Verdict(
        gate="along",
        question="Does the focus along the wall peak at that height?",
        score=_number(edges.fall[row, col]),
        limit=edges.min_fall,
        unit=POWERS,
        passed=bool(edges.along[row, col]),
    )
    return beside, along


def _wall_side_note(edges: BleedingEdges, row: int, col: int) -> str:
    """Return a note with the pixel's side of the wall and any missing reference height."""
    where = {
        EdgeSide.DARK: "On the dark side of a wall",
        EdgeSide.BRIGHT: "On the bright side of a wall",
        EdgeSide.OUTLINE: "On the outline of a wall, neither side's for sure",
    }[EdgeSide(int(edges.side[row, col]))]
    known = np.isfinite(edges.expected_um[row, col]) or edges.side[row, col] == EdgeSide.OUTLINE
    return f"{where}." if known else f"{where}, with nothing measured further from it."


def _number(value: float | np.floating[Any]) -> float | None:
    return float(value) if np.isfinite(value) else None
