"""A session that stands still but measures: a wafer in memory, the true measuring, a list of results with undo."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.browser.recording import Recording, done
from tests.browser.sessions.surface_session import SurfaceSession
from tests.support.page_stand_in import COLS, PIXEL_UM, ROWS, grid, height_map, job_and_plan, snapshot_of
from wafer_viewer.measure.gauge.find_faces import find_faces
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance
from wafer_viewer.session.core.command_queue import UndoHistory
from wafer_viewer.session.gauge.gauge_controller import GaugeController
from wafer_viewer.session.measurement.dataset_queries import ReadOut, Sections

DIE_UM, DOME_UM, DOME_RADIUS_UM, TILT = 12.0, 14.0, 60.0, 0.02
DOME_AT = (-60.0, 40.0)
GROOVE_UM = 9.0
CALIBRATION = Calibration(
    pixel_um=PIXEL_UM, u_pixel_um=0.0004, u_z_scale=0.002, made="2026-01-12", due="2027-01-12", against="a step block"
)


class MeasuringSession(SurfaceSession):
    """A die over streets with a dome and a groove in it and a bevel at the right, all of it tilted; one field."""

    def __init__(self, made: Callable[[], HeightMap] | None = None) -> None:
        job, plan = job_and_plan(grid(1, 1))
        whole = (made or a_die)()
        super().__init__(snapshot_of(whole, plan, job), {0: whole, 1: whole})
        self.datum = self.measuring.datum
        questions = SimpleNamespace(surface_source=self.surface_source, measuring=self.measuring)
        self.sections = Sections(questions, lambda: self.snapshot)
        self.gauge = _Faces(self)
        self._kept: UndoHistory[tuple[AnyResult, ...]] = UndoHistory(())

    def profile(self, line: Region, show: int = 0, levelling: Levelling | None = None, layer: Any = None) -> Any:
        return self.measuring.profile(line, show, levelling)

    def read_out(self, x_um: float, y_um: float, show: int = 0) -> Any:
        at = self.shelf.surfaces[show].window(Region.rectangle(x_um, y_um, x_um, y_um))
        z_um = float(at.z_um[0, 0])
        return ReadOut(z_um if np.isfinite(z_um) else None, 0.9, Origin(int(at.origin[0, 0])))

    def keep(self, finding: AnyResult, thumbnail: bytes | None = None) -> Future[AnyResult]:
        number = 1 + max((f.number for f in self._kept.value), default=0)
        kept = replace(finding, number=number, name=finding.name or f"Result {number}")
        self._put((*self._kept.value, kept))
        self.asked.append(("keep", (kept,), {}))
        return done(kept)

    def rename(self, number: int, name: str) -> Future[None]:
        self._put(tuple(replace(f, name=name) if f.number == number else f for f in self._kept.value))
        return done(None)

    def delete(self, number: int) -> Future[None]:
        self._put(tuple(f for f in self._kept.value if f.number != number))
        return done(None)

    def undo_findings(self) -> Future[None]:
        self._kept.undo()
        self._tell()
        return done(None)

    def redo_findings(self) -> Future[None]:
        self._kept.redo()
        self._tell()
        return done(None)

    def _put(self, findings: tuple[AnyResult, ...]) -> None:
        self._kept.put(findings)
        self._tell()

    def _tell(self) -> None:
        self.change(findings=self._kept.value, findings_undo=self._kept.can_undo, findings_redo=self._kept.can_redo)


class _Faces(Recording):
    """Finds the faces of what lies in memory."""

    def __init__(self, session: MeasuringSession) -> None:
        super().__init__(GaugeController, session._done, "gauge.")
        self._surfaces = session.shelf.surfaces

    def find_faces(self, show: int = 0) -> tuple[Region, Region]:
        return find_faces(self._surfaces[show], size_px=60)[:2]


def a_die() -> HeightMap:
    """Heights with x, y from the middle of the field; 0.15 um of noise, something in the die not measured."""
    x = (np.arange(COLS) - (COLS - 1) / 2)[None, :] * PIXEL_UM
    y = ((ROWS - 1) / 2 - np.arange(ROWS))[:, None] * PIXEL_UM
    die = (np.abs(x) < 130) & (np.abs(y) < 95)
    bevel = np.clip((x - 60) / 70, 0, 1) * 10
    z = np.where(die, DIE_UM - bevel, 0.0)
    z = z + np.maximum(0, DOME_UM * (1 - ((x - DOME_AT[0]) ** 2 + (y - DOME_AT[1]) ** 2) / DOME_RADIUS_UM**2)) * die
    z = z - GROOVE_UM * ((np.abs(x + 102) < 8) & (np.abs(y + 65) < 25))
    z = z + TILT * x + np.random.default_rng(1).normal(0, 0.15, z.shape)
    z[(np.abs(x + 40) < 12) & (np.abs(y + 60) < 8)] = np.nan
    made = height_map(z, PIXEL_UM, float(x[0, 0]), float(y[0, 0]))
    return dataclasses.replace(made, provenance=Provenance(calibration=CALIBRATION, simulated=True))
