"""A stitched surface with defects on it, found and listed: what a reviewer has before the first judgement."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from tests.browser.recording import Recording
from tests.browser.sessions.fake_defect_files import FakeDefectFiles, a_shelf
from tests.browser.sessions.fake_sections import FakeSections
from tests.browser.sessions.stitched_session import PITCH_UM, STREET_UM, StitchedSession
from tests.support.datasets.inspections import defect, inspection
from wafer_viewer.model.inspection.defect import Defect, DefectLimits, FalseCounts, Inspection
from wafer_viewer.model.inspection.defect_classes import DefectClass
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.measurement.sections import Section, SectionRequest
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.inspection.inspection_commands import DefectController
from wafer_viewer.session.inspection.reference_views import DefectViews, Earlier
from wafer_viewer.session.measurement.dataset_queries import cut
from wafer_viewer.session.rendering.render_request import SurfaceKey

GRID = DieGrid(
    pitch_x_um=PITCH_UM,
    pitch_y_um=PITCH_UM,
    width_um=PITCH_UM - STREET_UM,
    height_um=PITCH_UM - STREET_UM,
    x0_um=STREET_UM,
    y0_um=STREET_UM,
    first_col=-3,
    first_row=-2,
    cols=6,
    rows=4,
    by="found",
)
PLANTED: tuple[tuple[DefectClass, int, int, float, float, float, float], ...] = (
    ("particle", -1, 0, 60.0, 60.0, 12.0, 14.0),
    ("residue", 1, 0, 50.0, 70.0, 30.0, 3.0),
    ("pit", 0, -1, 80.0, 40.0, 10.0, -7.0),
    ("particle", -2, -1, 30.0, 80.0, 9.0, 8.0),
    ("scratch", 0, 0, 60.0, 60.0, 45.0, -2.5),
    ("edge chip", 1, -1, 116.0, 60.0, 14.0, -9.0),
    ("pattern", -1, -1, 61.0, 61.0, 11.0, 4.0),
    ("unmeasured", -2, 0, 90.0, 30.0, 16.0, 0.0),
)
"""Class, column, row, place on the die, half its length and its height, um."""


EARLIER = Earlier(SurfaceKey(Path("coupon-06.wafer"), "default", -99, 1), "coupon-06", lambda x_um, y_um: (x_um, y_um))
"""The last scan of the wafer."""


def inspected_session(n_defects: int = len(PLANTED)) -> InspectedSession:
    """A surface with its first so many defects."""
    return InspectedSession(n_defects)


def repeating_session() -> InspectedSession:
    """The same with a mark that the mask printed on most dies, and another that three of them have."""
    session = InspectedSession(len(PLANTED))
    now = session.snapshot.inspection.inspection
    whole = [die for die in now.dies if die.state == "whole"]
    most = whole[3:]
    off = np.random.default_rng(4).normal(0.0, 1.0, (len(most), 2))
    places = [(die, 92.0 + dx, 84.0 + dy) for die, (dx, dy) in zip(most, off.tolist(), strict=True)]
    places += [(die, 24.0 + dx, 30.0 + dy) for die, (dx, dy) in zip(whole[2:11:4], off.tolist(), strict=False)]
    first = len(now.defects) + 1
    more = tuple(
        _defect(first + k, "pattern" if v_um > 50 else "pit", die.col, die.row, u_um, v_um, 8.0, 3.0)
        for k, (die, u_um, v_um) in enumerate(places)
    )
    session.change(
        inspection=dataclasses.replace(
            session.snapshot.inspection, inspection=replace(now, defects=(*now.defects, *more))
        )
    )
    return session


class InspectedSession(StitchedSession):
    """Its sections are cut through the surface on show."""

    def __init__(self, n_defects: int) -> None:
        super().__init__(3, 3)
        planted = PLANTED[:n_defects]
        self.shelf.surfaces[EARLIER.source.show] = earlier(self.shelf.surfaces[0])
        self.shelf.surfaces[0] = _with(self.shelf.surfaces[0], planted)
        self.defects = FakeDefects(self)
        self.defects.views = DefectViews(self.paint, lambda: self.snapshot, lambda *_: EARLIER)
        self.change(defect_files=a_shelf())
        self.sections = CutSections(self.shelf.surfaces)
        self.change(inspection=dataclasses.replace(self.snapshot.inspection, inspection=found(planted)))


class CutSections(FakeSections):
    """Sections of a surface in memory."""

    def __init__(self, surfaces: dict[int, HeightMap]) -> None:
        self._surfaces = surfaces

    def section(self, request: SectionRequest) -> Section:
        return cut(request, self._surfaces[request.show], True, "coupon-07")


class FakeDefects(Recording):
    """Judges at once, with undo."""

    def __init__(self, session: Any) -> None:
        super().__init__(DefectController, session._done, "defects.")
        self._session = session
        self.files = FakeDefectFiles(session)
        self._before: list[Inspection] = []

    def judge(
        self, number: int | tuple[int, ...], judgement: Any = None, kind: Any = None, note: Any = None
    ) -> Future[Any]:
        asked = {"judgement": judgement, "judged_kind": kind, "note": note}
        given = {name: value for name, value in asked.items() if value is not None}
        numbers = (number,) if isinstance(number, int) else number
        return self._put("judge", (number,), lambda d: replace(d, **given) if d.number in numbers else d)

    def limit(self, limits: DefectLimits) -> Future[Any]:
        now = self._session.snapshot.inspection.inspection
        self._before.append(now)
        self._show(replace(now, recipe=replace(now.recipe, limits=limits)))
        return self._session._done("defects.limit", (limits,), {})

    def undo(self) -> Future[Any]:
        if self._before:
            self._show(self._before.pop())
        return self._session._done("defects.undo", (), {})

    def _put(self, verb: str, asked: tuple[Any, ...], change: Callable[[Defect], Defect]) -> Future[Any]:
        now = self._session.snapshot.inspection.inspection
        self._before.append(now)
        self._show(replace(now, defects=tuple(change(d) for d in now.defects)))
        return self._session._done(f"defects.{verb}", asked, {})

    def _show(self, now: Inspection) -> None:
        state = dataclasses.replace(self._session.snapshot.inspection, inspection=now, can_undo=bool(self._before))
        self._session.change(inspection=state)


def found(planted: tuple[Any, ...]) -> Inspection:
    """What a search would have found of what was planted."""
    defects = tuple(_defect(n, *made) for n, made in enumerate(planted, 1))
    states = {"2,1": "not scanned", "-3,1": "partly scanned", "-3,-2": "cut", "2,-2": "cut"}
    dies = tuple(_die(col, row, states.get(GRID.name(col, row), "whole"), defects) for col, row in GRID.places)
    counts = FalseCounts(threshold_sigma=(2.0, 3.0, 4.0, 5.0, 6.0, 8.0), per_mm2=(40.0, 3.0, 0.3, 0.04, 0.006, 1e-4))
    return inspection(
        *defects,
        grid=GRID,
        dies=dies,
        inspected_mm2=0.61,
        unmeasured_mm2=0.01,
        false_counts=counts,
        expected_false_per_mm2=0.04,
    )


def _defect(
    number: int, kind: DefectClass, col: int, row: int, u_um: float, v_um: float, half_um: float, high_um: float
) -> Defect:
    x, y = (float(um) for um in GRID.to_stage(col, row, u_um, v_um))
    across_um = half_um * (0.12 if kind == "scratch" else 0.9)
    return replace(
        defect(1, "0,0", 0.0, 0.0),
        number=number,
        name=f"Defect {number}",
        kind=kind,
        center=Point(x_um=x, y_um=y),
        die=GRID.name(col, row),
        in_die=Point(x_um=u_um, y_um=v_um),
        outline=Region.rectangle(x - half_um, y - across_um, x + half_um, y + across_um),
        major=Length(value_um=2 * half_um, expanded_um=0.9, status="evaluated"),
        minor=Length(value_um=2 * across_um, expanded_um=0.9, status="evaluated"),
        height=Length(value_um=high_um, expanded_um=0.4, status="evaluated"),
        repeats=kind == "pattern",
        simulated=True,
    )


def _die(col: int, row: int, state: Any, defects: tuple[Defect, ...]) -> DieStatus:
    name = GRID.name(col, row)
    on_it = sum(d.die == name for d in defects) if state != "not scanned" else None
    return DieStatus(name=name, col=col, row=row, state=state, measured_fraction=0.97, defects=on_it)


def earlier(surface: HeightMap) -> HeightMap:
    """The surface before there were defects on it, laid down a little off."""
    clean = _with(surface, ())
    return dataclasses.replace(clean, x0_um=clean.x0_um + 3.0, y0_um=clean.y0_um - 1.5)


def _printed(surface: HeightMap) -> np.ndarray:
    """The picture of the dies: pads in rows, and a block at the right."""
    _, _, u_um, v_um = GRID.to_die(*np.meshgrid(surface.x_um, surface.y_um))
    pads = (u_um % 24 < 13) & (v_um % 20 < 9) & (u_um > 8) & (u_um < 80) & (v_um > 12) & (v_um < 112)
    block = (u_um > 92) & (u_um < 112) & (v_um > 20) & (v_um < 104)
    die = np.where(np.nan_to_num(surface.z_um) > 5, 140, 90)
    return np.where(pads, 205, np.where(block, 175, die)).astype(np.uint8)


def _with(surface: HeightMap, planted: tuple[Any, ...]) -> HeightMap:
    """The surface with what is planted on it, which the picture shows too."""
    z, grey = surface.z_um.copy(), _printed(surface)
    for kind, col, row, u_um, v_um, half_um, high_um in planted:
        x_um, y_um = (float(um) for um in GRID.to_stage(col, row, u_um, v_um))
        across_um = half_um * (0.12 if kind == "scratch" else 0.9)
        away = ((surface.x_um - x_um) / half_um)[None, :] ** 2 + ((surface.y_um - y_um) / across_um)[:, None] ** 2
        z += np.where(away < 1, high_um * np.sqrt(np.clip(1 - away, 0, 1)), 0.0).astype(np.float32)
        grey[away < 1] = 30 if high_um > 0 else 215
        if kind == "unmeasured":
            z[away < 1] = np.nan
    return dataclasses.replace(surface, z_um=z, z_raw_um=z, all_in_focus=grey)
