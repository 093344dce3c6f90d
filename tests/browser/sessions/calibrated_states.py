"""Calibrations of an instrument over four years, one that runs, and a result that waits: made up."""

from __future__ import annotations

import dataclasses
from typing import Any

from tests.browser.sessions.fake_session import RIG, FakeSession, measured
from wafer_viewer.model.acquisition.characteristics import (
    KINDS,
    CalibrationKind,
    CalibrationRecord,
    CalibrationResult,
    Characteristic,
)
from wafer_viewer.rigs.virtual.rig import CALIBRATION
from wafer_viewer.session.state.instrument_state import (
    CalibrationHistory,
    CalibrationState,
    PendingCalibration,
    RunningCalibration,
)
from wafer_viewer.session.state.snapshot import Snapshot, Work

VALUES: dict[CalibrationKind, tuple[tuple[str, float, str, float], ...]] = {
    "delay": (("trigger delay", 62.6, "us", 4.7), ("play of the z axis", 0.214, "um", 0.012)),
    "pixel": (
        ("pixel size", 0.467398, "um", 0.000032),
        ("pixel size along x", 0.467401, "um", 0.000041),
        ("pixel size along y", 0.467396, "um", 0.000044),
        ("camera rotation", 0.093, "mrad", 0.033),
        ("squareness of camera and stage", -0.012, "mrad", 0.046),
    ),
    "noise": (("measurement noise", 0.1008, "um", 0.0009),),
    "linearity": (("amplification coefficient of z", 1.00021, "1", 0.00038),),
}
"""Name, value, unit and U of every characteristic; a kind that is missing was never measured."""
TITLE = "Calibrate the trigger delay"


def result(kind: CalibrationKind, drift: float = 0.0, before: float | None = None) -> CalibrationResult:
    """A result, its first characteristic off by so many U."""
    lines = [
        Characteristic(
            name=name,
            value=value + (drift * expanded if k == 0 else 0.0),
            unit=unit,
            expanded=expanded,
            before=before if k == 0 else None,
        )
        for k, (name, value, unit, expanded) in enumerate(VALUES[kind])
    ]
    notes = ("Speeds of 41 and 247 um/s.",) if kind == "delay" else ()
    sets = {"trigger_delay_us": lines[0].value} if kind == "delay" else {}
    return CalibrationResult(kind=kind, characteristics=tuple(lines), sets=sets, notes=notes)


def record(kind: CalibrationKind, year: int, drift: float, by: str = "K. Adler") -> CalibrationRecord:
    """A signed calibration of a November, valid for a year."""
    return CalibrationRecord(
        software_version="0.1.0",
        rig=RIG.name,
        simulated=True,
        setup=CALIBRATION.setup,
        at=f"{year}-11-{12 + len(kind)}T09:41:07.000+00:00",
        due=f"{year + 1}-11-{12 + len(kind)}",
        signed_by=by,
        why="yearly, after the change of the camera cable" if year == 2025 else "",
        result=result(kind, drift),
        before=CALIBRATION,
        after=CALIBRATION,
    )


def calibrated(**more: Any) -> CalibrationState:
    """Four years of delays, one record of the others; the noise is due, the flatness was never measured."""
    drifts = (-0.9, -0.5, 0.2, 0.0)
    delays = tuple(record("delay", 2095 + k, drift, "K. Adler" if k else "M. Ott") for k, drift in enumerate(drifts))
    by_kind = {
        "delay": delays,
        "pixel": (record("pixel", 2098, 0.0),),
        "noise": (record("noise", 2024, 0.3), record("noise", 2025, 0.0)),
        "linearity": (record("linearity", 2098, 0.0),),
    }
    histories = tuple(
        CalibrationHistory(kind, by_kind.get(kind, ()), kind in ("noise", "flatness") or kind not in by_kind)
        for kind in KINDS
    )
    return CalibrationState(histories=histories, **more)


def pending(kind: CalibrationKind = "delay", drift: float = 0.0) -> CalibrationState:
    """A result that waits."""
    before = VALUES[kind][0][1] if kind == "delay" else None
    return calibrated(pending=PendingCalibration(result(kind, drift, before), CALIBRATION, simulated=True))


def running() -> Snapshot:
    """A delay under way."""
    now = measured()
    rig = dataclasses.replace(RIG, state="working", message=TITLE)
    state = calibrated(running=RunningCalibration("delay", TITLE, 0.44, "Sweep up and down, 2 of 4"))
    return dataclasses.replace(now, rig=rig, calibration=state, works=(Work("work-1", TITLE, 0.44, seconds_left=74.0),))


def instrument_session(state: CalibrationState | None = None) -> FakeSession:
    """A session with a surface and these calibrations."""
    return FakeSession(dataclasses.replace(measured(), rig=RIG, calibration=state or calibrated()))
