"""A session that stands still: it shows the snapshot it was given and remembers what it was asked."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from tests.browser.recording import Recording, done, refused
from tests.browser.sessions.fake_control import fake_control
from tests.browser.sessions.fake_exchange import FakeExchange
from tests.browser.sessions.fake_notebook import FakeNotebook, FakePapers
from tests.browser.sessions.fake_sections import FakeSections
from tests.support.made_up_poses import made_up_poses, stitching_of
from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import DatasetError, MeasureError, PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve, StepHeight
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.quantity import Contribution, Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.roles import AuditEntry
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import Poses, RejectionReason
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Levy, Noise, Outliers, Recipe
from wafer_viewer.rigs.virtual.rig import CALIBRATION, SETUP, virtual_limits
from wafer_viewer.session.acquisition.live_controller import LiveController, LiveLook
from wafer_viewer.session.files.file_browser import Browsing
from wafer_viewer.session.gauge.gauge_controller import GaugeController
from wafer_viewer.session.measurement.dataset_queries import ReadOut
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import (
    DatasetEntry,
    Draft,
    Fault,
    FieldState,
    LatestFrame,
    OpenDataset,
    RigStatus,
    ScanProgress,
    Snapshot,
    SurfaceInfo,
    Typed,
    Work,
)

LIMITS = virtual_limits(540, 720)
DATA = Path("/tmp/wafers")


AUDITED = (
    AuditEntry(
        at="2026-03-02T06:12:40+00:00", by="ann", through="command line", action="Job released",
        subject="Logic-7-3.toml", detail="revision: 3",
    ),
    AuditEntry(
        at="2026-03-03T07:01:00+00:00", by="Bench", through="page", action="Scan started",
        subject="lot42-w07-20260303.wafer", detail="name: lot42-w07-20260303",
    ),
    AuditEntry(
        at="2026-03-03T07:09:12+00:00", by="Bench", through="page", action="Calibration accepted",
        subject="2026-03-03-resolution.json", detail="by: Ann Example, why: after the objective was changed",
    ),
)  # fmt: skip


class FakeSession(Recording):
    """Every verb is remembered in `asked` and done at once; `edit_job` makes a new draft."""

    def __init__(self, snapshot: Snapshot) -> None:
        super().__init__(Session, lambda *asked: self._done(*asked))
        self.snapshot = snapshot
        self.latest_frame: LatestFrame | None = None
        self.asked: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []
        self.fails_with: Exception | None = None
        self._listeners: list[Callable[[Snapshot], None]] = []
        self.control = fake_control(self)
        self.exchange = FakeExchange(self)
        self.sections = FakeSections()
        self.browsing = Browsing(DATA, (Path(tempfile.gettempdir()),), home=None)
        self.live: Any = FakeLive(LiveController, self._done, "live.")
        self.notebook, self.papers = FakeNotebook(self), FakePapers(self)
        self.gauge: Any = NoFaces(GaugeController, self._done, "gauge.")

    def subscribe(self, listener: Callable[[Snapshot], None]) -> Callable[[], None]:
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def change(self, **fields: Any) -> None:
        self.snapshot = dataclasses.replace(self.snapshot, version=self.snapshot.version + 1, **fields)
        for listener in list(self._listeners):
            listener(self.snapshot)

    def edit_job(self, job: Job | None) -> Future[None]:
        self.change(draft=draft_of(job))
        return self._done("edit_job", (job,), {})

    def keep_typed(self, typed: Typed | None) -> Future[None]:
        self.change(draft=dataclasses.replace(self.snapshot.draft, typed=typed))
        return self._done("keep_typed", (typed,), {})

    def stop(self) -> Future[bool]:
        """Halt what moves; a scan is then unfinished."""
        anything = self.snapshot.rig.state in ("moving", "scanning", "paused")
        self.asked.append(("stop", (), {}))
        self.change(rig=dataclasses.replace(self.snapshot.rig, state="ready"))
        return done(anything)

    def profile(
        self, line: Region, show: int = 0, levelling: Levelling | None = None, layer: Any = None
    ) -> tuple[Profile, ProfileCurve]:
        return a_profile(line)

    def recorded_actions(self, subject: str = "") -> tuple[AuditEntry, ...]:
        return AUDITED

    def read_out(self, x_um: float, y_um: float, show: int = 0) -> ReadOut:
        return ReadOut(21.86, 0.94, Origin.MEASURED, 0.12)

    def poses(self) -> Poses | None:
        return THE_POSES if self.snapshot.surface is not None else None

    def paint(self, request: Any) -> Future[bytes]:
        """Nothing is on disk, so nothing can be painted: the scene stays as it is."""
        return Future()

    def _done(self, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Future[Any]:
        self.asked.append((name, args, kwargs))
        return done() if self.fails_with is None else refused(self.fails_with)


class FakeLive(Recording):
    """A live view whose frame a test puts in; listeners are called by `arrive`."""

    def __init__(self, *of: Any) -> None:
        super().__init__(*of)
        self.latest, self.listeners = LiveLook(), []

    def look(self) -> LiveLook:
        return self.latest

    def on_frame(self, listener: Callable[[], None]) -> Callable[[], None]:
        self.listeners.append(listener)
        return lambda: self.listeners.remove(listener)

    def arrive(self, look: LiveLook) -> None:
        self.latest = look
        for listener in list(self.listeners):
            listener()


class NoFaces(Recording):
    """The verbs of a gauge check where there is nothing to find the faces on."""

    def find_faces(self, show: int = 0) -> Any:
        raise MeasureError("Too little of the surface is measured to look for faces: scan it again.")


def a_job() -> Job:
    grid = FieldGrid(rows=3, cols=3, field_width_um=LIMITS.field_width_um, field_height_um=LIMITS.field_height_um)
    return Job(
        sample=Sample(
            name="coupon-07", lot="L2231", wafer_id="W07", operator="K. Adler", width_um=6000, height_um=6000
        ),
        grid=grid.centred_on(200, -100),
        z_start_um=-45.0,
        sweep=FocusSweep(z_step_um=1.5, n_frames=60),
    )


def draft_of(job: Job | None) -> Draft:
    if job is None:
        return Draft(free_bytes=212_000_000_000)
    try:
        plan = plan_scan(job.all_fields(), job.sweep, job.exposures_us, LIMITS, job.strategy)
        marked_um = (None,) * len(job.marks.places if job.marks else ())
        return Draft(job=job, plan=plan, can_undo=True, free_bytes=212_000_000_000, marked_um=marked_um)
    except PlanError as fault:
        return Draft(job=job, problem=str(fault), can_undo=True, free_bytes=212_000_000_000)


RIG = RigStatus(
    state="ready",
    x_um=-312.0,
    y_um=145.0,
    z_um=2043.1,
    limits=LIMITS,
    calibration=CALIBRATION,
    setup=SETUP,
    homed=True,
)


def entries() -> tuple[DatasetEntry, ...]:
    names = (("coupon-06", "2026-03-14T08:41:00", False), ("coupon-04", "2026-03-13T17:02:00", True))
    return tuple(
        DatasetEntry(DATA / f"{n}.wafer", f"{n}.wafer", taken, unfinished, True) for n, taken, unfinished in names
    )


def an_overview() -> Overview:
    """A square sample of 6 mm with dies, drawn coarsely."""
    size_px, pixel_um, die_px = 600, 10.0, 50
    y, x = np.mgrid[:size_px, :size_px]
    streets = (x % die_px < 8) | (y % die_px < 8)
    image = np.where(streets, 190, 60 + (x * 7 + y * 3) % 40).astype(np.uint8)
    first = -pixel_um * (size_px - 1) / 2
    corner = pixel_um * size_px / 2
    outline = ((-corner, -corner), (corner, -corner), (corner, corner), (-corner, corner))
    return Overview(image, pixel_um, first, -first, outline, (), "coupon")


def empty() -> Snapshot:
    return Snapshot(rig=RIG, data_folder=DATA, overview=an_overview(), draft=draft_of(None), compute_ready=True)


def planned() -> Snapshot:
    return dataclasses.replace(empty(), draft=draft_of(a_job()), datasets=entries())


def dataset(states: dict[int, FieldState], finished: bool, problem: str | None = None) -> OpenDataset:
    job = a_job()
    plan = draft_of(job).plan
    if plan is None:
        raise DatasetError("The plan of the fake dataset is not possible.")
    return OpenDataset(
        path=DATA / "coupon-07.wafer",
        name="coupon-07",
        taken="2026-03-14 09:41",
        simulated=True,
        calibration_problem=problem,
        read_only=None,
        finished=finished,
        fields=plan.fields,
        states=states,
        stamps={n: 1 for n, s in states.items() if s is FieldState.MEASURED},
        plan=plan,
        job=job,
        results=("default",),
    )


def scanning() -> Snapshot:
    states = dict.fromkeys(range(1, 10), FieldState.TO_COME)
    states.update(
        {1: FieldState.MEASURED, 2: FieldState.MEASURED, 3: FieldState.TO_REPEAT, 6: FieldState.RECONSTRUCTING}
    )
    states[5] = FieldState.TAKING
    data = dataset(states, finished=False)
    scan = ScanProgress(
        field=data.fields[4],
        k=33,
        z_um=31.5,
        order=5,
        frames_done=274,
        frames_total=540,
        frames_missing=1,
        pulses=275,
        seconds_left=23.0,
        seconds_gone=7.4,
        started="09:41:07",
        strategy="Z passes, up and down",
    )
    fault = Fault(
        id="f1",
        title="Frame 173 did not arrive",
        text="Field 3, z = +31.0 µm: no frame came. It is taken again at the end. Nothing to do.",
        at="09:41:24",
        where="field 3",
        needs_person=False,
        source="scan",
    )
    works = (
        Work("w1", "Surface of field 6", 0.41),
        Work("w2", "Placing field 2", 0.8),
        Work("w3", "Stitching the fields", None),
    )
    return dataclasses.replace(
        planned(), rig=dataclasses.replace(RIG, state="scanning"), dataset=data, scan=scan, works=works, faults=(fault,)
    )


def unfinished() -> Snapshot:
    now = scanning()
    return dataclasses.replace(now, rig=RIG, scan=None, works=(), faults=())


def at_fault() -> Snapshot:
    fault = Fault(
        id="f2",
        title="Import stopped at stack_041.tif",
        text="It is 1440 x 1072 px, the 40 before it are 1440 x 1080 px. Nothing was written. "
        "Take the file out or import it as a stack of its own.",
        at="09:44:12",
        source="import",
    )
    return dataclasses.replace(empty(), faults=(fault,))


def a_frame(snapshot: Snapshot) -> LatestFrame:
    overview = snapshot.overview
    image = overview.image if overview and overview.image is not None else np.zeros((540, 720), np.uint8)
    field = snapshot.scan.field if snapshot.scan else dataset({}, True).fields[0]
    return LatestFrame(np.ascontiguousarray(image), field, 33, 31.5, 231, 0.0002)


SETTLED = Recipe(
    window=9,
    focus_width_um=7.6,
    min_confidence=0.24,
    noise=Noise(gain_counts=0.0213, floor_counts2=1.31),
    levy=Levy(n_sigma=3.5, alpha=1.0, iterations=2),
    outliers=Outliers(floor_um=1.125),
)
NOTES = (
    "3 exposures were fused, the longer ones x3.98, x15.8 as bright as the shortest.",
    "The picture shifts by 3.1 px (1.45 um) through the stack: its frames were put right.",
    "The picture shifts by 2.6 px (1.21 um) through the stack: its frames were put right.",
    "3 exposures were fused, the longer ones x4.01, x15.9 as bright as the shortest.",
    "The picture shifts by 2.9 px (1.36 um) through the stack: its frames were put right.",
    "1 of 60 frames of field 3 are missing",
)


_PLAN = dataset({}, finished=True).plan
THE_POSES = made_up_poses(
    _PLAN.fields,
    _PLAN.cols * _PLAN.pixel_um,
    _PLAN.rows * _PLAN.pixel_um,
    {(4, 5): RejectionReason.AMBIGUOUS, (7, 8): RejectionReason.BLANK},
)


def measured(problem: str | None = None) -> Snapshot:
    data = dataset(dict.fromkeys(range(1, 10), FieldState.MEASURED), finished=True, problem=problem)
    info = SurfaceInfo(
        result="default",
        stamp=1,
        rows=1510,
        cols=2010,
        pixel_um=0.46729,
        x0_um=-300.0,
        y0_um=250.0,
        levels=4,
        n_fields=9,
        highest_um=34.04,
        lowest_um=-18.3,
        measured_fraction=0.992,
        filled_fraction=0.002,
        unmeasured=(("no texture", 0.004), ("light bleeding over an edge", 0.002)),
        overlap_rms_um=0.11,
        low_um=-13.5,
        high_um=16.5,
        recipe_notes=NOTES,
        asked=Recipe(),
        settled=SETTLED,
        stitching=stitching_of(THE_POSES),
    )
    step = a_step(Region.rectangle(0, 0, 80, 60), Region.rectangle(0, -120, 80, -90))
    line = a_profile(Region.line(-200, 0, 500, 0, 3.0))[0]
    kept = (
        replace(step, name="Die to trench", number=1),
        replace(line, name="Across the gel drop <b>&", number=2),
    )
    scan = dataclasses.replace(_scan_of(data), finished=True)
    return dataclasses.replace(planned(), dataset=data, surface=info, findings=kept, findings_undo=True, scan=scan)


def _scan_of(data: OpenDataset) -> ScanProgress:
    return ScanProgress(data.fields[8], 59, 43.5, 9, 540, 540, 0, 540, 0.0, 14.2, "09:41:07", "Z passes, up and down")


def a_step(upper: Region, lower: Region) -> StepHeight:
    budget = (
        Contribution(name="z scale, calibrated 2026-01-12", u_um=0.012),
        Contribution(name="Repeatability of the focus peak", u_um=0.094),
        Contribution(name="Flatness of the regions", u_um=0.108),
        Contribution(name="Level line", u_um=0.058),
    )
    return StepHeight(
        upper=upper,
        lower=lower,
        height=Length.evaluated(11.862, budget),
        definition="distance of two parallel planes fitted together",
        upper_mean_um=0.12,
        lower_mean_um=-11.74,
        upper_sq_um=0.42,
        lower_sq_um=0.51,
        upper_points=6600,
        lower_points=4400,
        relative_tilt_mrad=0.3,
        simulated=True,
    )


def a_profile(line: Region) -> tuple[Profile, ProfileCurve]:
    n = 4000
    distance = np.linspace(0, 2100, n)
    z = 34 * np.exp(-(((distance - 1320) / 110) ** 2)) + 1.2 * np.sin(distance / 20)
    z[(distance % 430) < 55] -= 12
    z[2000:2040] = np.nan
    a, b = line.points
    curve = ProfileCurve(distance, z, np.linspace(a.x_um, b.x_um, n), np.linspace(a.y_um, b.y_um, n))
    profile = Profile(
        line=line,
        length_um=2100.0,
        pt=Length(value_um=47.6),
        rise=Length(value_um=33.91, expanded_um=0.42, status="evaluated"),
        measured_fraction=0.99,
        simulated=True,
    )
    return profile, curve
