"""Inspections in other states than found and open: under way, stale, failed, held elsewhere, of a whole wafer."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tests.browser.sessions.inspected_session import PLANTED, InspectedSession, inspected_session
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.inspection.die_grid import DieGrid, DieState, DieStatus
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.inspection_state import InspectionState

SHARES = (0.46, 0.08, 0.2, 0.01, 0.03, 0.15, 0.05, 0.01, 0.01)
"""Of the classes, in the order of their keys."""


def inspected_as(n_defects: int = len(PLANTED), **state: Any) -> InspectedSession:
    """An inspection of which something else is to be said."""
    session = inspected_session(n_defects)
    session.change(inspection=dataclasses.replace(session.snapshot.inspection, **state))
    return session


def failed() -> InspectedSession:
    """The first inspection failed."""
    session = inspected_session()
    why = "The surface has no period between 50 um and 400 um: give the dies, or inspect against the fitted form."
    session.change(inspection=InspectionState(problem=why))
    return session


def held_elsewhere() -> InspectedSession:
    """Another program has the dataset open."""
    session = inspected_session()
    held = dataclasses.replace(session.snapshot.dataset, read_only="another Wafer Viewer holds it.")
    session.change(dataset=held)
    return session


def whole_wafer(across: int = 17, n_defects: int = 150) -> InspectedSession:
    """Many dies of which some were not scanned, and many defects, a third of them judged."""
    session = inspected_session()
    session.change(inspection=InspectionState(wafer_of(across, n_defects)))
    return session


def wafer_of(across: int, n_defects: int, seed: int = 4) -> Inspection:
    """A round wafer so many dies across."""
    first = inspected_session().snapshot.inspection.inspection
    half, rng = across // 2, np.random.default_rng(seed)
    grid = replace(first.grid, first_col=-half, first_row=-half, cols=across, rows=across)
    places = [at for at in grid.places if np.hypot(*at) <= half + 0.3]
    defects = tuple(_defect(first.defects[0], grid, number, rng) for number in range(1, n_defects + 1))
    on = {name: sum(d.die == name for d in defects) for name in {d.die for d in defects}}
    dies = tuple(_die(grid, col, row, half, on) for col, row in places)
    there = {die.name for die in dies if die.state == "whole"}
    return replace(first, grid=grid, dies=dies, defects=tuple(d for d in defects if d.die in there))


def _defect(like: Defect, grid: DieGrid, number: int, rng: np.random.Generator) -> Defect:
    kind = list(DEFECT_CLASSES)[int(rng.choice(len(SHARES), p=SHARES))]
    col, row = (int(k) for k in np.round(rng.normal(0, grid.cols / 4, 2)))
    u, v, half = rng.uniform(20, 100), rng.uniform(20, 100), float(rng.uniform(2, 15))
    x, y = (float(um) for um in grid.to_stage(col, row, u, v))
    return replace(
        like,
        number=number,
        name=f"Defect {number}",
        kind=kind,
        die=grid.name(col, row),
        center=Point(x_um=x, y_um=y),
        in_die=Point(x_um=u, y_um=v),
        outline=Region.rectangle(x - half, y - half, x + half, y + half),
        major=replace(like.major, value_um=2 * half),
        judgement=("open", "open", "real", "nuisance")[number % 4],
    )


def _die(grid: DieGrid, col: int, row: int, half: int, on: dict[str, int]) -> DieStatus:
    name, state = grid.name(col, row), _state(col, row, half)
    defects = None if state == "not scanned" else on.get(name, 0) if state == "whole" else 0
    return DieStatus(name=name, col=col, row=row, state=state, measured_fraction=0.97, defects=defects)


def _state(col: int, row: int, half: int) -> DieState:
    if row <= -half + 1:
        return "partly scanned" if row == -half + 1 else "not scanned"
    if (col, row) in ((3, 5), (-4, 2)):
        return "missing"
    return "cut" if np.hypot(col, row) > half - 0.3 else "whole"
