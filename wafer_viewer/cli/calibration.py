"""Commands that calibrate the instrument; one is made of a descriptor for each procedure on the rig."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import msgspec
from rich.console import Console
from rich.table import Table
from tyro.conf import Positional, arg

from wafer_viewer.cli.arguments import File, Flag, Text, Um, with_flags
from wafer_viewer.cli.output import audit, compile_for_frames, print_json, progress
from wafer_viewer.model.acquisition.characteristics import (
    FOCUS_RANGE_UM,
    KINDS,
    CalibrationKind,
    CalibrationOption,
    CalibrationResult,
)
from wafer_viewer.model.errors import MotionStopped, RigError

DATA_FOLDER = Path("~/wafer-viewer")
INTERRUPTED = 130
DataFolder = Annotated[Positional[Path], arg(metavar="FOLDER")]
Length = Annotated[float, arg(metavar="UM")]

COMMON = (
    Flag("rig", File, "RIG.toml of the instrument; the virtual rig without it.", None),
    Flag("data", Path, "Folder of the datasets, whose next scans get the calibration.", DATA_FOLDER),
    Flag("by", Text, "Who signs: the calibration is recorded and applied. Without it nothing is written.", None),
    Flag("why", str, "A remark.", ""),
    Flag("x_um", Um, "Place on the stage; where it stands by default.", None),
    Flag("y_um", Um, "Place on the stage; where it stands by default.", None),
    Flag("z_um", Um, "Middle of the search for the focus; where the stage stands by default.", None),
    Flag("z_range_um", Length, "Range in which the focus is searched.", FOCUS_RANGE_UM),
    Flag("exposure_us", Annotated[float | None, arg(metavar="US")], "Exposure; found by itself by default.", None),
)


def _command(kind: CalibrationKind) -> Callable[..., int]:
    """Return the command of a procedure on the rig."""
    own = tuple(_flag(option) for option in KINDS[kind].options)

    def run(
        *,
        rig: Path | None,
        data: Path,
        by: str | None,
        why: str,
        x_um: float | None,
        y_um: float | None,
        z_um: float | None,
        z_range_um: float,
        exposure_us: float | None,
        **options: Any,
    ) -> int:
        from wafer_viewer.rigs.rig_config import RigConfig, open_rig, read_config
        from wafer_viewer.session.calibration.frames import CalibrationSite
        from wafer_viewer.session.calibration.headless import accept_calibration, run_calibration

        folder = data.expanduser()
        by = _required_name(by, why, folder)
        site = CalibrationSite(x_um=x_um, y_um=y_um, z_um=z_um, z_range_um=z_range_um, exposure_us=exposure_us)
        device = open_rig(RigConfig() if rig is None else read_config(rig))
        try:
            compile_for_frames(device)
            with progress(KINDS[kind].title) as tell:
                result = run_calibration(device, kind, folder, site, tell, **options)
            path = None if by is None else accept_calibration(device, folder, result, by, why)
            if path is not None:
                audit(folder, "Calibration accepted", path.name, why, by=by or "", wrote=path)
        except MotionStopped as stop:
            print(f"{stop} Nothing is recorded.")
            return INTERRUPTED
        finally:
            device.close()
        _print(result, path)
        return 0

    return with_flags(run, KINDS[kind].about, [*own, *COMMON])  # type: ignore[return-value]


def _flag(option: CalibrationOption) -> Flag:
    """Return the flag of an option: an int for a count, else a number, which may be left out where it is None."""
    if isinstance(option.default, int):
        kind = Annotated[int, arg(metavar="N")]
    else:
        number = float if option.default is not None else float | None
        kind = Annotated[number, arg(metavar=option.unit.upper() if option.unit == "um" else "NUMBER")]
    return Flag(option.name, kind, option.about, option.default)


calibrate_delay = _command("delay")
calibrate_pixel = _command("pixel")
calibrate_flat_field = _command("flat-field")
calibrate_noise = _command("noise")
calibrate_flatness = _command("flatness")
calibrate_mapping = _command("mapping")
calibrate_resolution = _command("resolution")


def calibrate_linearity(folder: DataFolder, rig: File = None, by: Text = None, why: str = "") -> None:
    """Evaluate amplification and linearity of z from the signed checks against gauge blocks. Nothing moves.

    Args:
        folder: A data folder with gauge-checks.jsonl.
        rig: RIG.toml of the instrument; that of the newest check without it.
        by: Who signs: the result is recorded and applied. Without it nothing is written.
        why: A remark.
    """
    from wafer_viewer.session.calibration.records import linearity_result
    from wafer_viewer.session.core.calibration_acceptance import CalibratedRigFacts, accept
    from wafer_viewer.session.gauge.gauge_check import trusted_checks
    from wafer_viewer.session.gauge.z_scale_correction import in_force, last_check

    by = _required_name(by, why, folder)
    newest = last_check(folder, ())
    name = newest.rig if rig is None else _name_of(rig)
    checks = [check for check in trusted_checks(folder) if check.rig == name]
    result = linearity_result(checks)
    facts = CalibratedRigFacts(name, checks[-1].check.simulated, in_force(folder, checks[-1]))
    path = None if by is None else accept(folder, facts, result, by, why)
    if path is not None:
        audit(folder, "Calibration accepted", path.name, why, by=by or "", wrote=path)
    _print(result, path)


def calibrate_list(folder: DataFolder, rig: File = None, json: bool = False) -> int:
    """List the calibrations of a data folder: each characteristic with U, date, due day and who signed.

    Status 1 when one is missing or due.

    Args:
        folder: A data folder.
        rig: RIG.toml of an instrument, for its calibrations alone.
        json: Print all records as JSON, oldest first.
    """
    from wafer_viewer.session.calibration.records import calibration_rows, not_measured
    from wafer_viewer.store.records.calibration_records import calibration_records

    name = None if rig is None else _name_of(rig)
    rows = calibration_rows(folder.expanduser(), name)
    if json:
        print_json(msgspec.to_builtins(calibration_records(folder.expanduser(), name)))
        return int(any(row.is_due for row in rows))
    table = Table("Characteristic", "Value", "U (k = 2)", "Made", "Due", "By", "Standard", box=None, pad_edge=False)
    for row in rows:
        if row.record is None:
            table.add_row(row.title, "not measured", "", "", f"needs {row.needs}", "", "")
            continue
        due = f"{row.record.due}{', overdue' if row.is_due else ''}"
        for one in row.record.result.characteristics:
            made, by = row.record.at[:10], row.record.signed_by
            table.add_row(one.name, f"{one.value:.6g} {one.unit}", f"{one.expanded:.2g}", made, due, by, one.standard)
    for what, needs in not_measured():
        table.add_row(what, "not measured", "", "", needs, "", "")
    Console(soft_wrap=True).print(table)
    return int(any(row.is_due for row in rows))


def _required_name(by: str | None, why: str, folder: Path) -> str | None:
    """Return who signs, None if nobody does; where people are listed, an engineer who gives a reason.

    Raises RigError for an empty signature, and errors of `acting_person`, before anything moves.
    """
    from wafer_viewer.session.core.signing_in import acting_person, require_reason

    if by is None:
        return None
    if not by.strip():
        raise RigError("A calibration is accepted under a name: say who signs it with --by NAME.")
    person = acting_person(folder, "Calibration accepted", by)
    require_reason(person, why, "--why")
    return by if person is None else person.name


def _name_of(rig: Path) -> str:
    from wafer_viewer.rigs.rig_config import read_config

    return read_config(rig).name


def _print(result: CalibrationResult, path: Path | None) -> None:
    found = msgspec.to_builtins(result)
    del found["flat_field"]
    print_json({"recorded": None if path is None else str(path), **found})
