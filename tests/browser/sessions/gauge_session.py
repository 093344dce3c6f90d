"""A session that stands still and checks gauge blocks: two blocks in memory, the true sums, a log of earlier checks."""

from __future__ import annotations

import dataclasses
import datetime
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from tests.browser.recording import Recording, refused
from tests.browser.recording import done as came_to
from tests.browser.sessions.fake_session import RIG
from tests.browser.sessions.gauge_blocks import CALIBRATION, COLS, PIXEL_UM, ROWS, STEP_UM, blocks, certificate
from tests.browser.sessions.surface_session import SurfaceSession
from tests.support.page_stand_in import grid, job_and_plan, snapshot_of
from wafer_viewer.measure.gauge.gauge_studies import run_chart
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import Certificate, GaugeCheck, GaugeRecord, GaugeRepeat, GaugeTerms, ScaleCorrection
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.gauge import gauge_check as work
from wafer_viewer.session.gauge.gauge_controller import GaugeController
from wafer_viewer.session.gauge.repeat_scans import Studies
from wafer_viewer.session.state.inspection_state import GaugeState, Tick

UPPER = Region.rectangle(150, -40, 330, 190)
LOWER = Region.rectangle(-330, -190, -150, 40)
DAY = "2026-11-21T"
ADVICE = "The error is larger than its U: the correction takes away more than it is unsure of."
TERMS = GaugeTerms(limit_um=0.5, temperature_c=20.4, u_temperature_c=0.2, tolerance_um=4.0)


class FakeGauge(Recording):
    """The verbs of a check; each repeat is a scan of its own, a little off the one before."""

    def __init__(self, session: GaugeSession) -> None:
        super().__init__(GaugeController, session._done, "gauge.")
        self._session = session

    def load_certificate(
        self, path: Path, expires: datetime.date | None = None, blocks: tuple[str, ...] = ()
    ) -> Future[Certificate]:
        from wafer_viewer.store.records.calibration_records import read_certificate

        try:
            read = read_certificate(path, expires=expires, blocks=blocks)
        except MeasureError as fault:
            return refused(fault)
        self._put(certificate=read)
        return came_to(read)

    def put_certificate(self, certificate: Certificate | None) -> Future[None]:
        self._put(certificate=certificate)
        return came_to(None)

    def set_terms(self, terms: GaugeTerms) -> Future[None]:
        self._put(terms=terms)
        return came_to(None)

    def tick(self, point: str, done: bool = True) -> Future[None]:
        others = tuple(tick for tick in self._state.ticks if tick.point != point)
        self._put(ticks=(*others, Tick(point, f"{DAY}09:33:00+00:00")) if done else others)
        return came_to(None)

    def add_repeat(
        self, upper: Region | None = None, lower: Region | None = None, show: int = 0
    ) -> Future[GaugeRepeat]:
        n = len(self._state.repeats)
        scanned = blocks(STEP_UM + (0.0, 0.05, -0.04, 0.02)[n % 4], seed=n + 1)
        made = repeat_of(scanned, upper or UPPER, lower or LOWER, n)
        self._put(repeats=(*self._state.repeats, made), signed=None)
        return came_to(made)

    def drop_repeat(self, n: int) -> Future[None]:
        self._put(repeats=tuple(r for k, r in enumerate(self._state.repeats) if k != n))
        return came_to(None)

    def clear(self) -> Future[None]:
        self._put(repeats=(), ticks=(), signed=None)
        return came_to(None)

    def sign(self, operator: str) -> Future[GaugeRecord]:
        check = self._state.check
        if check is None:
            raise MeasureError("There is nothing to sign.")
        record = GaugeRecord(check=replace(check, signed_by=operator, at=f"{DAY}09:41:00.000+00:00"), rig="Virtual rig")
        self._put(signed=record.check, records=(*self._state.records, record))
        return came_to(record)

    def find_faces(self, show: int = 0) -> tuple[Region, Region]:
        return UPPER, LOWER

    @property
    def _state(self) -> GaugeState:
        return self._session.snapshot.gauge

    def _put(self, **changes: Any) -> None:
        self._session.change(gauge=worked_out(dataclasses.replace(self._state, **changes)))


class GaugeSession(SurfaceSession):
    """`state`: where the check stands; `with_surface`: whether the blocks were scanned."""

    def __init__(self, state: GaugeState | None = None, with_surface: bool = True) -> None:
        surfaces = {0: blocks(), 1: blocks()}
        job, plan = job_and_plan(grid(1, 1))
        plan = replace(plan, rows=ROWS, cols=COLS, pixel_um=PIXEL_UM)
        whole = snapshot_of(surfaces[0], plan, job)
        path, taken = Path("step-400-check.wafer"), f"{DAY}09:36:00"
        data = dataclasses.replace(whole.dataset, name=path.stem, path=path, taken=taken)
        now = dataclasses.replace(whole, rig=RIG, dataset=data, compute_ready=True)
        if not with_surface:
            now = dataclasses.replace(now, dataset=None, surface=None)
        super().__init__(dataclasses.replace(now, gauge=worked_out(state or GaugeState())), surfaces)
        self.gauge, self.studies = FakeGauge(self), Studies()


def repeat_of(surface: HeightMap, upper: Region = UPPER, lower: Region = LOWER, n: int = 0) -> GaugeRepeat:
    from wafer_viewer.measure.gauge.gauge_check import gauge_repeat

    taken = f"{DAY}09:{20 + 8 * n:02d}:00"
    return gauge_repeat(surface, upper, lower, dataset=f"step-400-check-{n + 1}.wafer", taken=taken)


def worked_out(state: GaugeState) -> GaugeState:
    """The state with what follows from it."""
    records = state.records if state.certificate is not None else ()
    check = None
    if state.certificate is not None and state.repeats:
        check = state.signed or work.check_of(state.repeats, state.certificate, state.terms, records)
    return dataclasses.replace(
        state,
        check=check,
        chart=run_chart(records),
        capability=work.capability_of(records, state.terms.tolerance_um),
    )


def checked(off_um: float = 0.0, n_earlier: int = 29, expires: str = "2099-03-14") -> GaugeState:
    """A check of three scans, all points done but the signature; earlier ones over a month."""
    paper = certificate(expires)
    taken = [repeat_of(blocks(STEP_UM + off_um + d, seed=k + 1), n=k) for k, d in enumerate((0.0, 0.05, -0.04))]
    ticks = (Tick("clean", f"{DAY}09:12:00+00:00"), Tick("warm", f"{DAY}09:33:00+00:00"))
    one = work.check_of(taken, paper, TERMS, ())
    return GaugeState(
        certificate=paper, terms=TERMS, ticks=ticks, repeats=tuple(taken), records=tuple(earlier(one, n_earlier))
    )


def correctable() -> GaugeState:
    """A signed check that offers another z scale."""
    state = worked_out(checked(off_um=0.4))
    if state.check is None:
        raise MeasureError("The check of this screen is not there.")
    signed = replace(state.check, signed_by="K. Adler", at=f"{DAY}09:41:00.000+00:00")
    factor = state.check.reference.value_um / state.check.height.value_um
    against = "gauge blocks 21-0447 / 21-0448"
    offered = ScaleCorrection(
        calibration=replace(CALIBRATION, z_scale=factor, against=against), factor=factor, advice=ADVICE,
        changes_um=state.check.reference.value_um - state.check.height.value_um,
    )  # fmt: skip
    return dataclasses.replace(state, signed=signed, correction=offered)


def earlier(like: GaugeCheck, n: int) -> list[GaugeRecord]:
    """Checks over a month, a little scattered, slowly drifting, one of them failed."""
    rng = np.random.default_rng(3)
    start = datetime.datetime(2026, 10, 22, 8, 50, tzinfo=datetime.UTC)
    records: list[GaugeRecord] = []
    for k in range(n):
        at = start + datetime.timedelta(days=k, minutes=int(rng.integers(0, 90)))
        error = float(rng.normal(0.03, 0.07)) + 0.002 * k + (0.9 if k == n - 4 else 0.0)
        deviation = replace(like.deviation, value_um=round(error, 4))
        verdict = "fail" if error > 0.6 else "inconclusive" if k == 6 else "pass"
        check = replace(like, deviation=deviation, verdict=verdict, signed_by="K. Adler", at=at.isoformat())
        records.append(GaugeRecord(check=check, rig="Virtual rig"))
    return records


def a_study() -> str:
    """Ten parts, three people, three trials each, as CSV: um, made up."""
    rng = np.random.default_rng(7)
    lines = ["part,appraiser,value"]
    for part in range(10):
        for appraiser, bias in (("A", 0.0), ("B", 0.03), ("C", -0.02)):
            lines += [f"{part + 1},{appraiser},{12 + 0.35 * part + bias + rng.normal(0, 0.06):.3f}" for _ in range(3)]
    return "\n".join(lines) + "\n"
