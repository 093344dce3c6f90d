"""Acceptance of calibrations: a signed record, and values for the rig's next scans."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wafer_viewer._version import __version__
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import CalibrationRecord, CalibrationResult, due_day
from wafer_viewer.model.errors import RigError
from wafer_viewer.session.core.dataset_library import now, today
from wafer_viewer.store.records.calibration_records import write_calibration


@dataclass(frozen=True, slots=True)
class CalibratedRigFacts:
    """Rig of a calibration: its name, whether it is simulated, and the calibration before."""

    name: str
    simulated: bool
    before: Calibration


def accept(folder: Path, rig: CalibratedRigFacts, result: CalibrationResult, by: str, why: str = "") -> Path:
    """Sign a calibration, write its record, and apply it to the rig's next scans into a data folder.

    Return the file of the record. Raises RigError without a name.
    """
    if not by.strip():
        raise RigError("A calibration is accepted under a name: say who signs it.")
    day = today()
    due = due_day(result, day)
    record = CalibrationRecord(
        software_version=__version__,
        rig=rig.name,
        simulated=rig.simulated,
        setup=rig.before.setup,
        at=now(),
        due=due,
        signed_by=by.strip(),
        why=why.strip(),
        result=result,
        before=rig.before,
        after=result.applied_to(rig.before, day, min(due, rig.before.due)),
    )
    return write_calibration(folder, record)
