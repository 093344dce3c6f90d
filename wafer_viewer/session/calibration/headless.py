"""Calibrations without a browser; Ctrl-C stops the rig, and nothing is recorded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import CalibrationKind, CalibrationResult
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.procedure import Procedure
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import Progress, silent
from wafer_viewer.session.acquisition.headless import run_procedure
from wafer_viewer.session.calibration.frames import CalibrationSite
from wafer_viewer.session.calibration.image_procedures import FlatFieldProcedure, MappingProcedure, ResolutionProcedure
from wafer_viewer.session.calibration.procedures import (
    DelayProcedure,
    FlatnessProcedure,
    NoiseProcedure,
    PixelProcedure,
)
from wafer_viewer.session.core.audit_trail import record
from wafer_viewer.session.core.calibration_acceptance import CalibratedRigFacts, accept
from wafer_viewer.store.records.calibration_records import calibration_in_force

PROCEDURES: dict[CalibrationKind, Callable[..., Procedure[CalibrationResult]]] = {
    "delay": DelayProcedure,
    "pixel": PixelProcedure,
    "flat-field": FlatFieldProcedure,
    "noise": NoiseProcedure,
    "flatness": FlatnessProcedure,
    "mapping": MappingProcedure,
    "resolution": ResolutionProcedure,
}
"""Procedure of each kind of calibration that works on the rig; its fields are the options in `KINDS`."""


def run_calibration(
    rig: Rig,
    kind: CalibrationKind,
    folder: Path,
    site: CalibrationSite = CalibrationSite(),
    progress: Progress | None = None,
    **options: Any,
) -> CalibrationResult:
    """Carry out a calibration on a rig; `accept_calibration` applies its result.

    Parameters
    ----------
    rig : Rig
        Open rig.
    kind : {'delay', 'pixel', 'flat-field', 'noise', 'flatness', 'mapping', 'resolution'}
        Calibration to carry out.
    folder : Path
        Data folder, whose accepted calibrations are in force.
    site : CalibrationSite
        Place in stage um, range of the search for the focus, and exposure. Default: the place of the stage, 100 um, and
        an automatic exposure.
    progress : callable, optional
        Receives the finished fraction, 0 to 1.
    **options
        Fields of the procedure, such as ``n_lines`` and ``length_um`` of 'pixel' or ``repeats`` of 'delay'.

    Returns
    -------
    CalibrationResult
        Characteristics with U (k = 2), and the values for the rig's calibration.

    Raises
    ------
    RigError
        If a device fails, the sample does not allow a result, or the rig has no calibration to start from.
    MotionStopped
        If interrupted by Ctrl-C: the rig is then at rest.
    """
    procedure = PROCEDURES[kind](in_force=require_calibration(rig, folder), site=site, **options)
    return run_procedure(procedure, rig, progress or silent)


def accept_calibration(rig: Rig, folder: Path, result: CalibrationResult, by: str, why: str = "") -> Path:
    """Sign a calibration: write its record, and apply its values to the rig's next scans into a data folder.

    Parameters
    ----------
    rig : Rig
        Rig that was calibrated.
    folder : Path
        Data folder.
    result : CalibrationResult
        Result of `run_calibration`.
    by : str
        Name of the person who signs.
    why : str
        Remark.

    Returns
    -------
    Path
        File of the record.

    Raises
    ------
    RigError
        Without a name.
    DatasetError
        If the record cannot be written.
    """
    facts = CalibratedRigFacts(rig.name, rig.simulated, require_calibration(rig, folder))
    path = accept(folder, facts, result, by, why)
    record(folder, "Calibration accepted", path.name, why, by=by)
    return path


def require_calibration(rig: Rig, folder: Path) -> Calibration:
    """Return the calibration in force for scans into a data folder. Raises RigError if the rig has none."""
    found = calibration_in_force(folder, rig.name, rig.calibration)
    if found is None:
        raise RigError(
            f"{rig.name} has no calibration to start from: give its nominal values with generous uncertainties as "
            "[devices.calibration] in its file."
        )
    return found
