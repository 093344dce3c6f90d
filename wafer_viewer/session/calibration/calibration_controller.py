"""Calibrations of the rig in the snapshot, and their commands for the page and the prompt, ``session.calibration``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import (
    FOCUS_RANGE_UM,
    KINDS,
    NOT_MEASURED,
    CalibrationKind,
    CalibrationRecord,
    CalibrationResult,
    Characteristic,
    KindOfCalibration,
)
from wafer_viewer.model.acquisition.procedure import ProcedureStep
from wafer_viewer.model.errors import DatasetError, RigError
from wafer_viewer.model.gauge import GaugeRecord
from wafer_viewer.session.acquisition.rig_client import RigClient
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, observer_command
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.gauge.gauge_check import z_scale_result
from wafer_viewer.session.planning.plan_editor import PlanEditor
from wafer_viewer.session.state.instrument_state import (
    CalibrationHistory,
    CalibrationState,
    PendingCalibration,
    RunningCalibration,
)
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.store.records.calibration_records import calibration_records

# -------------------------------------------------------------------------------------------------------------- records


@dataclass(frozen=True, slots=True)
class CalibrationRow:
    """Row of the list of calibrations: a kind and its newest record; None if there is none."""

    kind: CalibrationKind
    title: str
    needs: str
    record: CalibrationRecord | None
    is_due: bool


def calibration_rows(folder: Path, rig: str | None = None) -> tuple[CalibrationRow, ...]:
    """Return a row for each kind of calibration with its newest record in a data folder.

    Raises DatasetError when a record is damaged.
    """
    newest = {record.result.kind: record for record in calibration_records(folder, rig)}
    day = today()
    return tuple(
        CalibrationRow(kind, one.title, one.needs, newest.get(kind), kind not in newest or newest[kind].is_due(day))
        for kind, one in KINDS.items()
    )


def linearity_result(records: Iterable[GaugeRecord]) -> CalibrationResult:
    """Return amplification and linearity of z from signed checks against gauge blocks.

    Each pair of blocks counts by its newest check with an uncertainty. Raises MeasureError without one.
    """
    from wafer_viewer.calibrate.image_geometry import Estimate
    from wafer_viewer.calibrate.topography import StepPair, scale_response

    newest = {r.check.certificate.serials: r.check for r in records if r.check.deviation.expanded_um is not None}
    steps = [
        StepPair(
            Estimate(check.height.value_um, (check.deviation.expanded_um or 0.0) / 2),
            Estimate(check.reference.value_um, 0.0),
        )
        for check in newest.values()
    ]
    found = scale_response(steps)
    standard = "ISO 25178-600:2019"
    lines = [
        Characteristic(
            name="amplification coefficient of z",
            value=found.amplification.value,
            unit="1",
            expanded=2 * found.amplification.u,
            standard=standard,
        )
    ]
    notes = [f"From {len(steps)} certified step{'' if len(steps) == 1 else 's'}; U is that of the checks."]
    sets: dict[str, float | str | tuple[str, ...]] = {}
    if found.linearity_um is None:
        notes.append("The linearity deviation is not measured: it takes certified steps of two heights at least.")
    else:
        deviation, u = found.linearity_um.value, found.linearity_um.u
        lines.append(
            Characteristic(
                name="linearity deviation of z", value=deviation, unit="um", expanded=2 * u, standard=standard
            )
        )
        sets["u_z_linearity_um"] = (deviation**2 / 3 + u**2) ** 0.5
    return CalibrationResult(kind="linearity", characteristics=tuple(lines), sets=sets, notes=tuple(notes))


FROM_CHECKS: dict[CalibrationKind, Callable[[Sequence[GaugeRecord], Calibration], CalibrationResult]] = {
    "z": z_scale_result,
    "linearity": lambda checks, _: linearity_result(checks),
}
"""Evaluation of the signed checks of a rig, oldest first, under its calibration in force, by kind."""


def not_measured() -> tuple[tuple[str, str], ...]:
    """Return the characteristics that no calibration here measures, and what they need."""
    return tuple(NOT_MEASURED.items())


# ----------------------------------------------------------------------------------------------- calibration controller


class CalibrationController:
    """Controller of the calibrations of the rig, ``session.calibration``; its commands return futures.

    A result waits in the snapshot until a person keeps or discards it.
    """

    def __init__(self, command_queue: CommandQueue, plan_editor: PlanEditor, rig: RigClient, folder: Path) -> None:
        self._command_queue, self._plan_editor, self._rig, self._folder = command_queue, plan_editor, rig, folder
        self._source: object = None
        command_queue.subscribe(self._look)

    @property
    def state(self) -> CalibrationState:
        """State as seen by the running command."""
        return self._command_queue.now.calibration

    @command
    def run(
        self,
        kind: CalibrationKind,
        z_range_um: float = FOCUS_RANGE_UM,
        exposure_us: float | None = None,
        **options: float | None,
    ) -> Future[CalibrationResult]:
        """Carry out a calibration at the present position of the stage; `keep` applies its result.

        A kind that is evaluated from signed checks against gauge blocks moves nothing.

        Parameters
        ----------
        kind : str
            Kind of calibration, a key of ``characteristics.KINDS``.
        z_range_um : float
            Range about the present z in which the focus is searched, in um.
        exposure_us : float, optional
            Exposure in us; an automatic exposure by default.
        **options
            Options of the kind by name, as in its descriptor.

        Returns
        -------
        Future of CalibrationResult
            Characteristics with U (k = 2), and the values for the rig's calibration.

        Raises
        ------
        RigError
            During a scan, while another result waits, for an unknown option, and if a device fails or the sample does
            not allow a result.
        MotionStopped
            If it is cancelled or the rig is stopped.
        MeasureError
            If the signed checks do not suffice.
        """
        one = _kind(kind)
        self._require_nothing_pending()
        base = self._in_force()
        if one.source == "gauge checks":
            return self._command_queue.do(self._found, self._evaluated(kind, one, base))
        self._plan_editor.require_confirmed()
        procedure = _procedure(kind, base, z_range_um, exposure_us, _checked(one, options))
        running = self._rig.run_procedure(procedure, self._step)
        self._show(running=RunningCalibration(kind, procedure.title))
        over = self._command_queue.afterwards(running, lambda: self._show(running=None))
        simulated = self._command_queue.now.rig.simulated
        return self._command_queue.then(over, lambda result: self._found(PendingCalibration(result, base, simulated)))

    @command.audited("Calibration accepted")
    def keep(self, by: str, why: str = "") -> Path:
        """Sign the result: write its record, and apply its values to the rig's next scans.

        Parameters
        ----------
        by : str
            Name of the person who signs; where people are listed, the one who is signed in signs instead.
        why : str
            Reason, or a remark; needed where people are listed.

        Returns
        -------
        Future of Path
            File of the record.

        Raises
        ------
        PlanError
            Without a reason where people are listed.
        RigError
            Without a name or a result, during a scan, and if a value it sets has changed since it was measured.
        DatasetError
            If the record cannot be written.
        """
        from wafer_viewer.session.core.calibration_acceptance import CalibratedRigFacts, accept

        now, pending = self._command_queue.now, self.state.pending
        if pending is None:
            raise RigError("There is no result to keep: run a calibration first.")
        if now.scanning:
            raise RigError("A scan is running: keep the calibration when it has ended.")
        now.control.require_reason(why)
        by = now.control.author(by)
        before = self._in_force()
        if any(getattr(pending.base, name) != getattr(before, name) for name in pending.result.sets):
            raise RigError(
                "The calibration in force has changed since this was measured: discard the result and run it again."
            )
        path = accept(
            self._folder, CalibratedRigFacts(now.rig.name, pending.simulated, before), pending.result, by, why
        )
        self._command_queue.change(rig=replace(now.rig, calibration=self._in_force()))
        self._show(pending=None)
        self.refresh.run()
        return path

    @command
    def discard(self) -> None:
        """Discard the result; nothing is recorded."""
        self._show(pending=None)

    @observer_command
    def refresh(self) -> None:
        """Read the signed calibrations of the rig again, as after the command line has added one."""
        from wafer_viewer.store.records.calibration_records import calibration_records

        problem, day = "", today()
        try:
            records = calibration_records(self._folder, self._command_queue.now.rig.name)
        except DatasetError as fault:
            records, problem = (), str(fault)
        histories: list[CalibrationHistory] = []
        for kind in KINDS:
            own = tuple(record for record in records if record.result.kind == kind)
            histories.append(CalibrationHistory(kind, own, not own or own[-1].is_due(day)))
        self._show(histories=tuple(histories), problem=problem)

    def _evaluated(self, kind: CalibrationKind, one: KindOfCalibration, base: Calibration) -> PendingCalibration:
        """Evaluate the signed checks of this rig."""
        from wafer_viewer.session.gauge.gauge_check import trusted_checks

        name = self._command_queue.now.rig.name
        checks = [record for record in trusted_checks(self._folder) if record.rig == name]
        if not checks:
            raise RigError(f"{one.title}: {name} has no signed check against gauge blocks. Sign one first.")
        return PendingCalibration(FROM_CHECKS[kind](checks, base), base, checks[-1].check.simulated)

    def _step(self, step: ProcedureStep) -> None:
        if (running := self.state.running) is not None:
            words = step.words or running.words
            self._show(running=replace(running, fraction=step.fraction, words=words))

    def _found(self, pending: PendingCalibration) -> CalibrationResult:
        self._show(pending=pending)
        return pending.result

    def _require_nothing_pending(self) -> None:
        if (pending := self.state.pending) is not None:
            title = KINDS[pending.result.kind].title
            raise RigError(f"{title}: its result waits. Keep or discard it first.")

    def _in_force(self) -> Calibration:
        """Return the calibration in force for the next scan. Raises RigError if the rig has none."""
        from wafer_viewer.store.records.calibration_records import calibration_in_force

        rig = self._command_queue.now.rig
        found = calibration_in_force(self._folder, rig.name, rig.calibration)
        if found is None:
            raise RigError(
                f"{rig.name} has no calibration to start from: give its nominal values with generous uncertainties as "
                "[devices.calibration] in its file."
            )
        return found

    def _look(self, now: Snapshot) -> None:
        """Read the records again for another rig or calibration, and on another day; called after every change."""
        source = now.rig.name, now.rig.calibration, today()
        if source != self._source:
            self._source = source
            self._command_queue.note(self.refresh.run)

    def _show(self, **changes: Any) -> None:
        self._command_queue.change(calibration=replace(self.state, **changes))


def _kind(kind: CalibrationKind) -> KindOfCalibration:
    if kind not in KINDS:
        raise RigError(f"There is no calibration {kind!r}: choose one of {', '.join(KINDS)}.")
    return KINDS[kind]


def _checked(one: KindOfCalibration, options: dict[str, float | None]) -> dict[str, float]:
    """Return the given options as their procedure takes them. Raises RigError for an unknown or impossible one."""
    known = {option.name: option for option in one.options}
    checked: dict[str, float] = {}
    for name, value in options.items():
        if name not in known:
            raise RigError(f"{one.title} has no option {name}: it has {', '.join(known) or 'none'}.")
        if value is None:
            continue
        counts = isinstance(known[name].default, int)
        if not math.isfinite(value) or value < (1 if counts else 0) or (counts and value != int(value)):
            allowed = "a whole number from 1" if counts else "at least 0"
            raise RigError(f"{one.title}: {known[name].title} is {value:g}, it must be {allowed}.")
        checked[name] = int(value) if counts else float(value)
    return checked


def _procedure(
    kind: CalibrationKind, base: Calibration, z_range_um: float, exposure_us: float | None, options: dict[str, float]
) -> Any:
    """Return the procedure of a kind at the present position of the stage. Raises RigError for a range of 0."""
    from wafer_viewer.session.calibration.frames import CalibrationSite
    from wafer_viewer.session.calibration.headless import PROCEDURES

    if not z_range_um > 0:
        raise RigError(f"The range of the search for the focus is {z_range_um:g} um: it must be over 0.")
    site = CalibrationSite(z_range_um=z_range_um, exposure_us=exposure_us)
    return PROCEDURES[kind](in_force=base, site=site, **options)
