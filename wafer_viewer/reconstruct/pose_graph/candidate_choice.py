"""Joint choice among the offsets at which repeating patterns fit, with the stage as prior.

An overlap of a pattern that repeats fits at many offsets, one pitch apart, and its pictures alone do not tell which is
right. Together with the stage, the overlaps of all fields do: a wrong offset of one contradicts those around it. Fields
are placed one by one, from the middle of the grid outwards, the surest next, each where the candidates of its placed
neighbours and the stage together say; then all of them are placed again in turn, until nothing changes. This is done
from several beginnings, since a part of the grid may lock in one period beside the rest; the most probable end counts.

What the errors of the stage have in common (offset, scale, turn, and the backlash of rows and columns that are scanned
in alternating directions) is estimated along the way, with its uncertainty, as is the scatter about it. Patterns cannot
be told apart by a stage whose scatter reaches a good part of their pitch: then nothing is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from wafer_viewer.model.surface.field_poses import Numbers, RejectionReason, Shifts, selected
from wafer_viewer.reconstruct.pose_graph.candidate_graph import CHOICE, CandidateGraph
from wafer_viewer.reconstruct.pose_graph.candidate_placing import Placing
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags
from wafer_viewer.reconstruct.registration.swap_search import StageDeviations

BEGINNINGS = ((1.0, 0.0), (0.5, 0.0), (1.0, 0.3), (0.5, 0.6), (0.7, 1.0))
"""Beginnings: part of the expected scatter, and where the first field lies, from the middle (0) to the rim (1)."""
MANY_FIELDS = 20_000
"""Number of fields above which only the first beginning is tried."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The chosen offsets.

    shifts: patterns that are open or not measured yet are ambiguous; to_measure: mask of the overlaps to be measured
    at the offsets (x, y) `expected_um`, [e, 2]; scatter_um: of the stage; spacing_px: of the candidates; refused:
    whether patterns were left open because the stage is too coarse for them; odds_nats: log odds of the chosen period
    of each field against any other, [n], infinite for fields without a pattern that repeats; deviations: of the chosen
    places from the stage.
    """

    shifts: Shifts
    to_measure: Flags
    expected_um: Numbers
    scatter_um: float
    spacing_px: float
    refused: bool
    odds_nats: Numbers
    deviations: StageDeviations

    def notes(self, pixel_um: float) -> tuple[str, ...]:
        """Return why patterns were left open, in a sentence, or nothing."""
        if not self.refused:
            return ()
        return (
            f"Overlaps show a pattern that repeats every {self.spacing_px * pixel_um:.3g} um, and the stage is off by "
            f"{self.scatter_um:.3g} um: no period was chosen, as that takes a stage within "
            f"{CHOICE.most_of_pitch:.0%} of the pitch. Calibrate the stage, or scan with more overlap.",
        )

    def with_measured(self, measured: Shifts) -> Shifts:
        """Return the overlaps with the measurements of those that were to be measured, where they fit."""
        rows = np.flatnonzero(self.to_measure)[measured.believed]
        found = selected(measured, measured.believed)
        columns = {}
        for item in fields(Shifts):
            column = getattr(self.shifts, item.name).copy()
            if item.name not in ("first", "second", "candidates"):
                column[rows] = getattr(found, item.name)
            columns[item.name] = column
        return Shifts(**columns)


def choose_candidates(
    stage_x_um: Numbers,
    stage_y_um: Numbers,
    shifts: Shifts,
    pixel_um: float,
    *,
    stage_error_um: float | Literal["auto"] = "auto",
    fixed: Flags | None = None,
    start: tuple[Numbers, Numbers] | None = None,
) -> Choice | None:
    """Choose one offset of each overlap that fits at several, or none where that is unsure.

    stage_x_um, stage_y_um: positions of the fields by the stage, [n]; stage_error_um: its standard deviation along an
    axis, estimated if ``auto``; fixed, start: fields with known positions, and these. None where no pattern repeats.
    """
    if not shifts.repeats.any():
        return None
    stage = np.column_stack((stage_x_um, stage_y_um)) / pixel_um
    graph = CandidateGraph.of(len(stage), shifts, pixel_um)
    begun = None if start is None else np.column_stack(start) / pixel_um
    error_px = None if stage_error_um == "auto" else max(stage_error_um / pixel_um, CHOICE.least_scatter_px)
    chosen = _chosen(_most_probable(graph, stage, fixed, begun, error_px), shifts, pixel_um)
    if not chosen.refused or not graph.pictures_differ:
        return chosen
    by_lattice = _chosen(_most_probable(graph.without_misfits(), stage, fixed, begun, error_px), shifts, pixel_um)
    return chosen if by_lattice.refused else by_lattice


def _most_probable(
    graph: CandidateGraph, stage: Numbers, fixed: Flags | None, begun: Numbers | None, error_px: float | None
) -> Placing:
    """Return the most probable end of all beginnings; error_px: of the stage, estimated if None."""
    ends: list[Placing] = []
    for share, out in BEGINNINGS[:1] if len(stage) > MANY_FIELDS else BEGINNINGS:
        placing = Placing.begin(graph, stage, fixed, begun)
        if error_px is not None:
            placing.scatter[:] = error_px
            placing.knows_scatter = True
        placing.scatter *= share
        placing.grow(out)
        placing.scatter /= share
        placing.sweep()
        ends.append(placing)
    return min(ends, key=Placing.cost_nats)


def _chosen(placing: Placing, shifts: Shifts, pixel_um: float) -> Choice:
    """Return which overlaps are to be measured at the places of sure fields, and doubt the other patterns."""
    odds = np.minimum(placing.odds, placing.lines_nats())
    graph, scatter = placing.graph, float(np.sqrt(np.mean(placing.scatter**2)))
    refused = scatter > CHOICE.most_of_pitch * graph.spacing_px and graph.decided_by_pictures < CHOICE.decides_nats
    sure = placing.placed & (odds > CHOICE.sure_nats) & (not refused)
    moved = placing.place - placing.stage
    expected = moved[shifts.second] - moved[shifts.first]
    between = sure[shifts.first] & sure[shifts.second]
    repeats = shifts.repeats
    at = np.column_stack((shifts.x_um, shifts.y_um)) / pixel_um
    is_measured = repeats & shifts.believed & (np.abs(at - expected).max(axis=1) < CHOICE.near_px)
    looks_open = np.isin(shifts.doubt, (RejectionReason.AMBIGUOUS, RejectionReason.END_OF_SEARCH))
    doubt = np.where(repeats & ~(is_measured & between), np.uint8(RejectionReason.AMBIGUOUS), shifts.doubt)
    return Choice(
        replace(shifts, doubt=doubt.astype(np.uint8)),
        between & (repeats | looks_open) & ~is_measured,
        expected * pixel_um,
        scatter * pixel_um,
        graph.spacing_px,
        bool(refused),
        _of_patterned(np.where(refused, 0.0, odds), placing.placed, shifts),
        StageDeviations(
            moved_um=moved * pixel_um,
            by_stage_um=(placing.shared_by @ placing.shared) * pixel_um,
            scatter_um=placing.scatter * pixel_um,
            placed=placing.placed,
        ),
    )


def _of_patterned(odds: Numbers, placed: Flags, shifts: Shifts) -> Numbers:
    """Return the odds of the fields with a pattern that repeats, infinite for the others.

    The first field of all has no choice: the surest of the others stands for it.
    """
    patterned = np.zeros(len(odds), np.bool_)
    patterned[shifts.first[shifts.repeats]] = patterned[shifts.second[shifts.repeats]] = True
    chosen = patterned & placed & np.isfinite(odds)
    most = float(odds[chosen].max(initial=0.0))
    return np.where(patterned, np.minimum(np.where(placed, odds, 0.0), most), np.inf)
