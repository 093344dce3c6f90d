"""Commands at the bench: live view, jog, drives, focus, marked places, and their use for the plan."""

from __future__ import annotations

import dataclasses
import math
import re
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from wafer_viewer.acquire.focus.search import FocusFound, GoToFocus
from wafer_viewer.acquire.motion import JogVelocity
from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.plan import Field, ScanPlan
from wafer_viewer.model.acquisition.positioners import PositionerReading
from wafer_viewer.model.acquisition.procedure import FoundExposure
from wafer_viewer.model.errors import PlanError, RigError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.session.acquisition.rig_client import RigClient
from wafer_viewer.session.acquisition.rig_messages import Drive, Jog, MovePositioner
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, observer_command, query
from wafer_viewer.session.planning.plan_editor import PlanEditor
from wafer_viewer.session.state.instrument_state import FocusTrace, LiveFrame, LivePlace
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot
from wafer_viewer.store.dataset.ome_header import StagePicture

if TYPE_CHECKING:
    from wafer_viewer.acquire.auto_exposure import FindExposure


# ------------------------------------------------------------------------------------------------------ exposure search


FIXED = "The job is released, which fixes its exposures: copy it to a new plan first."


def exposure_search(job: Job, plan: ScanPlan, numbers: Sequence[int] = ()) -> FindExposure:
    """Return the search over the fields with these numbers, or over a few spread over the plan.

    Raises PlanError for a released job, and for a number that no field has.
    """
    from wafer_viewer.acquire.auto_exposure import FindExposure, spread_fields

    if job.released:
        raise PlanError(FIXED)
    fields = tuple(_field(plan, number) for number in numbers) or spread_fields(plan.fields)
    return FindExposure(fields, plan.sweep, min(plan.exposures_us))


def write_exposures(path: Path, exposures_us: tuple[float, ...]) -> None:
    """Change the exposures in the file of a plan; its comments and layout are kept."""
    from wafer_viewer.session.planning.job_releases import read_job
    from wafer_viewer.store.io.atomic_files import write_text

    wanted, text = replace(read_job(path), exposures_us=exposures_us), path.read_text(encoding="utf-8")
    line = f"exposures_us = [{', '.join(f'{us:g}' if us % 1 else f'{us:.1f}' for us in exposures_us)}]"
    changed, n = re.subn(r"(?m)^exposures_us\s*=\s*\[[^\]]*\]", line, text, count=1)
    changed = changed if n else re.sub(r"(?m)^(?=\[)", f"{line}\n\n", text, count=1)
    try:
        is_kept = decode(changed, Job, path.name) == wanted
    except PlanError:
        is_kept = False
    write_text(path, changed if is_kept else encode(wanted))


class ExposureController:
    """Controller of the search for the exposure; its result is in the snapshot."""

    def __init__(self, command_queue: CommandQueue, plan_editor: PlanEditor, rig: RigClient) -> None:
        self._command_queue, self._plan_editor, self._rig = command_queue, plan_editor, rig

    @command
    def find(self, fields: tuple[int, ...] = ()) -> Future[FoundExposure]:
        """Find the exposure over the z range of the plan and set it, in one step that can be undone.

        fields: numbers of the fields to look at; by default a few spread over the plan. The exposure suits the
        brightest of them. The future is done when the plan has it, or fails with MotionStopped. Raises PlanError as
        long as the sample is not confirmed, without a plan, and for a released job.
        """
        self._plan_editor.require_confirmed()
        search = exposure_search(*self._plan_editor.ready(), fields)
        self._command_queue.change(exposure=None)
        return self._command_queue.then(self._rig.run_procedure(search), self._found)

    @command
    def take_bracket(self) -> None:
        """Set the exposures of the plan to the proposed bracket. Raises PlanError when there is none."""
        found = self._command_queue.now.exposure
        if found is None or not found.bracket:
            raise PlanError("No bracket is proposed: find the exposure first; where one suffices there is none.")
        self._set(found.bracket_us)

    def _found(self, found: FoundExposure) -> FoundExposure:
        self._command_queue.change(exposure=found)
        self._set(found.single_us)
        return found

    def _set(self, exposures_us: tuple[float, ...]) -> None:
        job, _ = self._plan_editor.ready()
        if job.exposures_us != exposures_us:
            self._plan_editor.edit.run(replace(job, exposures_us=exposures_us))


def _field(plan: ScanPlan, number: int) -> Field:
    field = next((f for f in plan.fields if f.number == number), None)
    if field is None:
        raise PlanError(f"The plan has {len(plan.fields)} fields and no field {number}: choose one of them.")
    return field


# ------------------------------------------------------------------------------------------------------ live controller


FIRST_EXPOSURE_US = 100.0
"""Exposure without a plan."""
POSITION_EVERY_S = 0.1
"""Time between two positions from live frames in the snapshot."""
SAME_PLACE_UM = 1.0
"""Distance in x and y within which scores over z belong to the same place."""
BIN_UM = 0.25
"""Width of the classes of z of the trace; a class holds its latest score."""
MOST_POINTS = 800
Corner = Literal[0, 1]
End = Literal["lowest", "highest"]


@dataclass(frozen=True, slots=True)
class KnownTop:
    """Highest known z of the sample in um, its source in words, and the z at which the objective stops above it."""

    um: float
    source: str
    stop_um: float


def known_top(now: Snapshot) -> KnownTop | None:
    """Return the highest known z of the sample: of the plan's sweep, the surface, found and marked focus.

    Without any of them it is assumed to be the focal plane at which the live view began. None before that, and without
    the limits of the rig.
    """
    limits, live, job = now.rig.limits, now.live, now.draft.job
    known: list[tuple[float, str]] = []
    if job is not None:
        starts = [field.z_start_um for field in job.all_fields()]
        known.append((max(starts) + job.sweep.range_um, "sweep of the plan"))
    if now.surface is not None and now.is_of_this_rig:
        known.append((now.surface.highest_um, "open surface"))
    if live.found_um is not None:
        known.append((live.found_um, "focus found"))
    if live.highest_um is not None:
        known.append((live.highest_um, "mark Highest"))
    if not known and live.began_um is not None:
        known.append((live.began_um, "assumed: z at start"))
    if not known or limits is None:
        return None
    um, source = max(known)
    return KnownTop(um, source, limits.lowest_z_um(um))


@dataclass(frozen=True, slots=True, eq=False)
class LiveLook:
    """Latest frame, scores over z, and frames per second; read without a lock."""

    frame: LiveFrame | None = None
    trace: FocusTrace = FocusTrace()
    rate_hz: float = 0.0


class LiveController:
    """Controller of the live view; frames arrive on another thread than the session's."""

    def __init__(self, command_queue: CommandQueue, rig: RigClient, plan_editor: PlanEditor) -> None:
        self._command_queue, self._rig, self._plan_editor = command_queue, rig, plan_editor
        self._lock = threading.Lock()
        self._listeners: tuple[Callable[[], None], ...] = ()
        self._shown_s = 0.0
        self._drives = 0
        self._look = LiveLook()

    # --- the view

    @query
    def look(self) -> LiveLook:
        """Return the latest frame with the scores over z, from any thread."""
        return self._look

    @query
    def on_frame(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` for every frame, on the thread that receives it; return the unsubscribe function."""
        self._listeners = (*self._listeners, listener)

        def leave() -> None:
            self._listeners = tuple(other for other in self._listeners if other is not listener)

        return leave

    def watch(self) -> Future[None]:
        """Show the view for some more seconds, from any thread."""
        done: Future[None] = Future()
        now = self._command_queue.snapshot
        if not now.live.problem:
            if now.live.began_um is None:
                self._command_queue.note(self._begin)
            self._rig.watch_live(exposure_us(now))
        done.set_result(None)
        return done

    @command
    def set_exposure(self, us: float) -> None:
        """Set the exposure of the live view, and try again if it has failed."""
        limits = self._command_queue.now.rig.limits
        if limits is not None:
            us = min(max(us, limits.camera.exposure_min_us), limits.camera.exposure_max_us)
        self._show(exposure_us=us, problem="")

    @observer_command
    def keep_picture(self) -> Path:
        """Store the latest frame in the data folder, as ``live-picture-3.ome.tif``; the future's result is its path.

        The file has all bits of the camera, with place, exposure, pixel size and time in its OME-XML; none is ever
        overwritten. Raises RigError before the first frame, DatasetError if the folder cannot be written to.
        """
        from wafer_viewer.store.dataset.ome_header import write_stage_picture

        frame, now = self._look.frame, self._command_queue.now
        if frame is None:
            raise RigError("There is no live picture yet: open Live, and wait for the first one.")
        return write_stage_picture(now.data_folder, stage_picture(frame, now.rig))

    def frame_arrived(self, frame: LiveFrame) -> None:
        """Add a frame to the scores; call the listeners."""
        with self._lock:
            before = self._look.frame
            gap_s = frame.taken_s - before.taken_s if before is not None else math.inf
            fresh_hz = 1 / gap_s if 0 < gap_s < 1 else 0.0
            rate_hz = 0.8 * self._look.rate_hz + 0.2 * fresh_hz if self._look.rate_hz else fresh_hz
            self._look = LiveLook(frame, with_score(self._look.trace, frame.position, frame.score), rate_hz)
            if due := time.monotonic() - self._shown_s > POSITION_EVERY_S:
                self._shown_s = time.monotonic()
        if due:
            self._command_queue.note(self._show_position, frame.position)
        for listener in self._listeners:
            listener()

    def failed(self, why: str) -> None:
        """Show why the view ended; called on the session's thread."""
        self._show(problem=why)

    # --- motions

    def jog(self, hold: int, x_um_s: float, y_um_s: float, z_um_s: float) -> Future[None]:
        """Move at a velocity for the next moment, from any thread; without the next word the rig stops by itself.

        hold: number of this press of a key. Zero on all axes stops at once.
        """
        now = self._command_queue.snapshot
        word = Jog(hold, JogVelocity(x_um_s, y_um_s, z_um_s), _highest_um(now))
        try:
            if not word.velocity.at_rest:
                self._plan_editor.require_confirmed()
            return self._rig.jog(word)
        except (PlanError, RigError) as fault:
            refused: Future[None] = Future()
            refused.set_exception(fault)
            return refused

    def step(self, x_um: float, y_um: float, z_um: float) -> Future[None]:
        """Move by a distance; the future is done on arrival. A step queued when motion is stopped is dropped."""
        axes = [um or None for um in (x_um, y_um, z_um)]
        return self._command_queue.do(self._drive, Drive(*axes, by=True), self._rig.n_stops)

    def drive(self, x_um: float | None = None, y_um: float | None = None, z_um: float | None = None) -> Future[None]:
        """Move to a position; farther than a field over the safe z. The future is done on arrival."""
        return self._command_queue.do(self._drive, Drive(x_um, y_um, z_um), self._rig.n_stops)

    @command
    def up_to_safe_z(self) -> Future[None]:
        """Move z up to where long ways go over the sample."""
        limits = self._command_queue.now.rig.limits
        if limits is None:
            raise RigError("The rig has not reported its limits yet: wait until it is ready.")
        return self._drive(Drive(z_um=min(limits.objective.safe_z_um, limits.z.high_um)), self._rig.n_stops)

    @command
    def go_to_focus(self) -> Future[FocusFound]:
        """Find the focus at this place and move there; the result has its z with a standard uncertainty."""
        self._plan_editor.require_confirmed()
        now = self._command_queue.now
        found = self._rig.run_procedure(GoToFocus(exposure_us(now), _highest_um(now)))
        return self._command_queue.then(found, self._found)

    def set_positioner(self, name: str, to: float | str) -> Future[PositionerReading]:
        """Move light, objective, zoom, a tilt or the rotation by its name; the future has its reading on arrival.

        to: a position in the unit of its role, or the name of one. z goes to the safe z before anything turns.
        """
        return self._command_queue.do(self._set_positioner, MovePositioner(name, to), self._rig.n_stops)

    def _set_positioner(self, goal: MovePositioner, n_stops: int) -> Future[PositionerReading]:
        limits = {one.reading.name: one.limits for one in self._command_queue.now.rig.positioners}
        if goal.name not in limits:
            raise RigError(f"The rig has no positioner '{goal.name}': it has {', '.join(limits) or 'none'}.")
        limits[goal.name].goal(goal.name, goal.to)
        if limits[goal.name].descriptor.lifts_z:
            self._plan_editor.require_confirmed()
        return self._rig.move_to(goal, n_stops)

    def _drive(self, way: Drive, n_stops: int) -> Future[None]:
        self._plan_editor.require_confirmed()
        now = self._command_queue.now
        running = self._rig.move_to(dataclasses.replace(way, highest_um=_highest_um(now)), n_stops)
        self._drives += 1
        if not way.by and way.x_um is not None and way.y_um is not None and now.rig.limits is not None:
            ways_um = way.x_um - now.rig.x_um, way.y_um - now.rig.y_um
            limits = now.rig.limits
            lasts_s = max(limits.x.move_s(ways_um[0]), limits.y.move_s(ways_um[1]))
            self._show(goal_um=(way.x_um, way.y_um), goal_s=lasts_s)
        return self._command_queue.afterwards(running, self._arrived)

    def _arrived(self) -> None:
        self._drives -= 1
        if self._drives == 0:
            self._show(goal_um=None)

    def _found(self, found: FocusFound) -> FocusFound:
        live, rig = self._command_queue.now.live, self._command_queue.now.rig
        with self._lock:
            trace = FocusTrace(rig.x_um, rig.y_um, found.curve, found.z_um, found.u_um)
            self._look = dataclasses.replace(self._look, trace=trace)
        self._show(found_um=max(found.z_um, live.found_um if live.found_um is not None else found.z_um))
        return found

    # --- marks

    @command
    def mark_corner(self, n: Corner) -> None:
        """Mark the present position as one of two opposite corners of the area to scan."""
        first, second = self._command_queue.now.live.corners
        here = self._here(f"Corner {n + 1}")
        self._show(corners=(here, second) if n == 0 else (first, here))

    @command
    def mark_end(self, end: End, z_um: float | None = None) -> None:
        """Mark the lowest or the highest z to scan; None for the present one."""
        z_um = self._command_queue.now.rig.z_um if z_um is None else z_um
        self._show(**{"lowest_um" if end == "lowest" else "highest_um": z_um})

    @command
    def keep_place(self, name: str = "") -> None:
        """Keep the present position in the list of places."""
        places = self._command_queue.now.live.places
        taken = {place.name for place in places}
        free = next(f"Place {n}" for n in range(1, len(places) + 2) if f"Place {n}" not in taken)
        name = name.strip() or free
        others = tuple(place for place in places if place.name != name)
        self._show(places=(*others, self._here(name)))

    @command
    def forget_place(self, name: str) -> None:
        """Remove a place from the list."""
        self._show(places=tuple(place for place in self._command_queue.now.live.places if place.name != name))

    @command
    def clear_marks(self) -> None:
        """Remove corners and z range, as for another sample."""
        self._show(corners=(None, None), lowest_um=None, highest_um=None, found_um=None)

    @command
    def use_for_plan(self) -> None:
        """Set the grid of the plan from the corners and its sweep from the z range, in one edit that can be undone.

        Raises PlanError when neither both corners nor both ends of z are marked.
        """
        live = self._command_queue.now.live
        if live.area_um is None and live.range_um is None:
            raise PlanError("Nothing is marked for the plan: mark two corners, or the lowest and the highest point.")
        self._plan_editor.lay_out.run(live.area_um, live.range_um)

    def _here(self, name: str) -> LivePlace:
        rig = self._command_queue.now.rig
        return LivePlace(name, rig.x_um, rig.y_um, rig.z_um)

    def _begin(self) -> None:
        now = self._command_queue.now
        if now.live.began_um is None:
            self._show(began_um=now.rig.z_um)

    def _show_position(self, at: Position) -> None:
        rig = self._command_queue.now.rig
        if (rig.x_um, rig.y_um, rig.z_um) != (at.x_um, at.y_um, at.z_um):
            self._command_queue.change(rig=dataclasses.replace(rig, x_um=at.x_um, y_um=at.y_um, z_um=at.z_um))

    def _show(self, **changes: Any) -> None:
        self._command_queue.change(live=dataclasses.replace(self._command_queue.now.live, **changes))


def exposure_us(now: Snapshot) -> float:
    """Return the exposure of the live view: the chosen one, else that of the plan."""
    if now.live.exposure_us is not None:
        return now.live.exposure_us
    return now.draft.job.exposures_us[0] if now.draft.job is not None else FIRST_EXPOSURE_US


def stage_picture(frame: LiveFrame, rig: RigStatus) -> StagePicture:
    """Return a live frame with what its file tells about it; the pixel size is the calibrated one, if there is one."""
    from wafer_viewer.store.dataset.ome_header import StagePicture

    nominal_um = None if rig.limits is None else rig.limits.pixel_um
    return StagePicture(
        image=frame.image,
        position=frame.position,
        exposure_us=frame.exposure_us,
        taken=datetime.fromtimestamp(frame.taken_s).astimezone().isoformat(timespec="milliseconds"),
        pixel_um=nominal_um if rig.calibration is None else rig.calibration.pixel_um,
        bits=8 * frame.image.itemsize if rig.limits is None else rig.limits.camera.bits,
        rig=rig.name,
        setup=rig.setup or OpticalSetup(),
        simulated=rig.simulated,
    )


def with_score(trace: FocusTrace, at: Position, score: float) -> FocusTrace:
    """Return the scores over z with another one; only the new one after a change of place."""
    if math.hypot(at.x_um - trace.x_um, at.y_um - trace.y_um) > SAME_PLACE_UM or not trace.points:
        return FocusTrace(at.x_um, at.y_um, ((at.z_um, score),))
    others = tuple(p for p in trace.points if round(p[0] / BIN_UM) != round(at.z_um / BIN_UM))
    return dataclasses.replace(trace, points=tuple(sorted((*others[-MOST_POINTS:], (at.z_um, score)))))


def _highest_um(now: Snapshot) -> float | None:
    top = known_top(now)
    return top.um if top is not None else None
