"""Commands that calibrate and verify the instrument; calibrations on the rig are made of descriptors."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import msgspec
from rich.console import Console
from rich.table import Table
from tyro.conf import Positional, arg

from wafer_viewer.cli.arguments import File, Flag, Rectangle, Source, Sources, Text, Um, with_flags
from wafer_viewer.cli.output import (
    audit,
    compile_for_frames,
    print_capability,
    print_json,
    print_study,
    progress,
    to_program,
)
from wafer_viewer.model.acquisition.characteristics import (
    FOCUS_RANGE_UM,
    KINDS,
    CalibrationKind,
    CalibrationOption,
    CalibrationResult,
)
from wafer_viewer.model.errors import MeasureError, MotionStopped, RigError
from wafer_viewer.model.gauge import GaugeRR, GaugeTerms, Method
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

# ---------------------------------------------------------------------------------------------------------------- gauge


Studies = Annotated[Positional[tuple[Path, ...]], arg(metavar="STUDY.csv|DATASET ...")]
Serials = Annotated[tuple[str, ...], arg(metavar="NUMBER ...")]
Day = Annotated[datetime.date | None, arg(metavar="YYYY-MM-DD")]
Value = Annotated[float | None, arg(metavar="X")]


def measure_gauge(
    src: Sources = (),
    certificate: File = None,
    expires: Day = None,
    blocks: Serials = (),
    limit_um: Value = None,
    upper: Rectangle | None = None,
    lower: Rectangle | None = None,
    temperature_c: Value = None,
    tolerance_um: Value = None,
    interval_days: int = 30,
    least_repeats: int = 1,
    sign: Text = None,
    log: Annotated[Path | None, arg(metavar="FOLDER")] = None,
    serial: Serials = (),
    rig: Text = None,
    field: int = 0,
    result: str = "default",
) -> int:
    """Check the instrument against certified gauge blocks: error with U, En, verdict, as JSON. Stage um.

    Status 0 for PASS, 1 for any other verdict. Each SRC is a repeat, a scan of its own. Without SRC: the signed checks
    of --log with their run chart and capability; status 1 where the chart warns, or the last did not pass its limit.

    Args:
        src: Datasets NAME.wafer or surface files, .npz.
        certificate: The blocks' certificate: .toml, or .xml of the laboratory (DCC).
        expires: Last day of a DCC that does not state one.
        blocks: Serial numbers of the two blocks of a DCC with more.
        limit_um: The largest error allowed.
        upper: Two opposite corners of the upper face; both faces are found by default.
        lower: The same of the lower face.
        temperature_c: Of the blocks, known to 0.5 (k = 1).
        tolerance_um: The product's, upper limit less lower: Cg and Cgk are evaluated over all scans so far.
        interval_days: Days until the next check is due.
        least_repeats: Scans that a verdict takes; fewer get none.
        sign: Who signs: the check goes to the log and into the results of the last SRC.
        log: The folder of gauge-checks.jsonl; that of the first SRC by default.
        serial: Of the history, the checks with these blocks alone.
        rig: Of the history, those of this rig alone.
        field: A field of the datasets; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.session.gauge.headless import check_sources, history, sign_sources
    from wafer_viewer.store.records.calibration_records import read_certificate

    terms = GaugeTerms(
        limit_um=limit_um,
        temperature_c=temperature_c,
        tolerance_um=tolerance_um,
        interval_days=interval_days,
        least_repeats=least_repeats,
    )
    if not src:
        if log is None:
            raise MeasureError("There is nothing to check: give scans and --certificate, or --log for the history.")
        summary = history(log, serial, rig, terms.tolerance_um)
        print_json(msgspec.to_builtins(summary))
        limited = summary.chart.limit_um is not None
        return 1 if summary.chart.warnings or (limited and summary.chart.points[-1].verdict != "pass") else 0
    if certificate is None:
        raise MeasureError("There is no check without a certificate: give --certificate FILE, .toml or .xml.")
    paper = read_certificate(certificate, expires=expires, blocks=blocks)
    faces = _faces(upper, lower)
    found, capable = check_sources(src, paper, terms, faces, log, field, result)
    if sign is not None:
        found = sign_sources(found, src, sign, log, result)
    print_json({**msgspec.to_builtins(found), "capability": msgspec.to_builtins(capable)})
    return 0 if found.verdict == "pass" else 1


def calibrate_z(folder: DataFolder, by: Text = None, why: str = "", serial: Serials = ()) -> None:
    """Set the z scale by the newest signed check of a data folder; prints what changes, as JSON.

    Without --by nothing is written. With it the next scans into the folder have the new scale; what it was before, who
    changed it and why go into calibrations.jsonl. Scans that were taken stay as they are.

    Args:
        folder: A data folder with gauge-checks.jsonl.
        by: Who does it.
        why: A remark.
        serial: The newest check with these blocks.
    """
    from wafer_viewer.session.core.people import acting_person, require_reason
    from wafer_viewer.session.gauge.gauge_check import correct, in_force, last_check, offered

    person = None if by is None else acting_person(folder, "Scale of z corrected", by)
    require_reason(person, why, "--why")
    by = by if person is None else person.name
    check = last_check(folder, serial)
    before = in_force(folder, check)
    found = offered(check, before) if by is None else correct(folder, check, before, by, why)
    if by is not None:
        audit(folder, "Scale of z corrected", check.rig, why, by=by)
    facts = {"recorded": by is not None, "rig": check.rig, "before": msgspec.to_builtins(before)}
    print_json({**facts, **msgspec.to_builtins(found)})


def measure_rr(
    src: Studies,
    job: Annotated[Path | None, arg(metavar="JOB.toml")] = None,
    method: Method = "anova",
    tolerance: float | None = None,
    result: str = "default",
    json: bool = False,
) -> None:
    """Gauge R&R: how much of the spread of repeated measurements is the instrument's (AIAG's MSA).

    Of a table, or of repeat scans: a wafer is a part, the operator its appraiser, a scan a trial; for every feature of
    the job. Deviations are standard deviations in the unit of the values; six of them are told as a share of the
    tolerance.

    Args:
        src: A table with the columns part, appraiser or operator, and value or measurement, a line for each trial; or
            datasets, or folders.
        job: The job whose features are studied; of datasets, that of the first by default.
        method: By analysis of variance, or by average and range.
        tolerance: Upper limit less lower, in the unit of the values; of a feature, that of its limits by default.
        result: Name of the reconstruction, of datasets.
        json: JSON on a terminal too, as into pipes and files.
    """
    from wafer_viewer.measure.gauge.gauge_studies import gauge_rr, study_rr
    from wafer_viewer.session.gauge.repeat_scans import studies_of
    from wafer_viewer.store.tables.csv_tables import read_study

    if len(src) == 1 and src[0].suffix.lower() == ".csv":
        found = gauge_rr(read_study(src[0]), method=method, tolerance=tolerance)
        if to_program(json):
            print_json(_rr_facts(found))
        else:
            print_study(src[0].name, found)
        return
    studies = studies_of(src, job, result)
    with_tolerance = [study if tolerance is None else replace(study, tolerance=tolerance) for study in studies]
    each = [(study, study_rr(study, method)) for study in with_tolerance]
    if to_program(json):
        print_json([{**msgspec.to_builtins(study), "found": _rr_facts(rr)} for study, rr in each])
        return
    for study, rr in each:
        print_study(f"{study.feature}, {study.unit}{', SIMULATED' if study.simulated else ''}", rr)


def measure_capability(
    src: Source,
    column: Annotated[str, arg(metavar="NAME")],
    lower: float | None = None,
    upper: float | None = None,
    json: bool = False,
) -> int:
    """Process capability: Cp and Cpk of a column of values against its limits, with 95 % limits of both.

    Status 0 where the lower confidence limit of Cpk is at least 1.33, else 1.

    Args:
        src: A table with a line for each part, as `batch` and `measure` write them.
        column: The column with the values.
        lower: The lower limit, in the unit of the values.
        upper: The upper limit.
        json: JSON on a terminal too, as into pipes and files.
    """
    from wafer_viewer.measure.gauge.process_capability import process_capability
    from wafer_viewer.store.tables.csv_tables import read_column

    found = process_capability(read_column(src, column), lower=lower, upper=upper)
    if to_program(json):
        print_json({**msgspec.to_builtins(found), "word": found.word})
    else:
        print_capability(f"{src.name}, {column}", found)
    return 0 if found.word == "capable" else 1


def _rr_facts(found: GaugeRR) -> dict[str, Any]:
    """Return the result and the shares derived from it."""
    shares = {
        "share_of_variation": found.share_of_variation if found.total_variation else None,
        "share_of_tolerance": found.share_of_tolerance,
        "distinct_categories": found.distinct_categories,
        "q_mp": found.q_mp,
        "word": found.word,
        "why": found.why,
    }
    return {**msgspec.to_builtins(found), **shares}


def _faces(upper: tuple[float, ...] | None, lower: tuple[float, ...] | None) -> tuple[Region, Region] | None:
    if upper is None and lower is None:
        return None
    if upper is None or lower is None:
        raise MeasureError("One face makes no step: give --upper and --lower, or neither to have them found.")
    return Region.rectangle(*upper), Region.rectangle(*lower)


# ---------------------------------------------------------------------------------------------------------- calibration


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
    from wafer_viewer.session.calibration.calibration_controller import linearity_result
    from wafer_viewer.session.core.calibration_acceptance import CalibratedRigFacts, accept
    from wafer_viewer.session.gauge.gauge_check import in_force, last_check, trusted_checks

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
    from wafer_viewer.session.calibration.calibration_controller import calibration_rows, not_measured
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
    from wafer_viewer.session.core.people import acting_person, require_reason

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
