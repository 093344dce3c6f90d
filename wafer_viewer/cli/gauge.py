"""Commands that verify the instrument. The signature of a command defines its flags, its docstring is the help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
from tyro.conf import Positional, arg

from wafer_viewer.cli.arguments import File, Rectangle, Sources, Text
from wafer_viewer.cli.output import audit, print_json
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeRR, GaugeTerms, Method
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

Studies = Annotated[Positional[tuple[Path, ...]], arg(metavar="STUDY.csv|DATASET ...")]
Serials = Annotated[tuple[str, ...], arg(metavar="NUMBER ...")]
DataFolder = Annotated[Positional[Path], arg(metavar="FOLDER")]
Value = Annotated[float | None, arg(metavar="X")]


def measure_gauge(
    src: Sources = (),
    certificate: File = None,
    limit_um: Value = None,
    upper: Rectangle | None = None,
    lower: Rectangle | None = None,
    temperature_c: Value = None,
    tolerance_um: Value = None,
    interval_days: int = 30,
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
        certificate: The blocks' certificate, .toml.
        limit_um: The largest error allowed.
        upper: Two opposite corners of the upper face; both faces are found by default.
        lower: The same of the lower face.
        temperature_c: Of the blocks, known to 0.5 (k = 1).
        tolerance_um: The product's, upper limit less lower: Cg and Cgk are evaluated over all scans so far.
        interval_days: Days until the next check is due.
        sign: Who signs: the check goes to the log and into the results of the last SRC.
        log: The folder of gauge-checks.jsonl; that of the first SRC by default.
        serial: Of the history, the checks with these blocks alone.
        rig: Of the history, those of this rig alone.
        field: A field of the datasets; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.session.gauge.headless import check_sources, history, sign_sources

    terms = GaugeTerms(
        limit_um=limit_um, temperature_c=temperature_c, tolerance_um=tolerance_um, interval_days=interval_days
    )
    if not src:
        if log is None:
            raise MeasureError("There is nothing to check: give scans and --certificate, or --log for the history.")
        summary = history(log, serial, rig, terms.tolerance_um)
        print_json(msgspec.to_builtins(summary))
        limited = summary.chart.limit_um is not None
        return 1 if summary.chart.warnings or (limited and summary.chart.points[-1].verdict != "pass") else 0
    if certificate is None:
        raise MeasureError("There is no check without a certificate: give --certificate FILE.toml.")
    faces = _faces(upper, lower)
    found, capable = check_sources(src, certificate, terms, faces, log, field, result)
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
    from wafer_viewer.session.core.signing_in import acting_person, require_reason
    from wafer_viewer.session.gauge.z_scale_correction import correct, in_force, last_check, offered

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
) -> None:
    """Gauge R&R: how much of the spread of repeated measurements is the instrument's, as JSON (AIAG's MSA).

    Of a table, or of repeat scans: a wafer is a part, the operator its appraiser, a scan a trial; for every feature of
    the job. Deviations are standard deviations in the unit of the values; six of them are told as a share of the
    tolerance.

    Args:
        src: A table with the columns part, appraiser and value, a line for each trial; or datasets, or folders.
        job: The job whose features are studied; of datasets, that of the first by default.
        method: By analysis of variance, or by average and range.
        tolerance: Upper limit less lower, in the unit of the values; of a feature, that of its limits by default.
        result: Name of the reconstruction, of datasets.
    """
    from wafer_viewer.measure.gauge.gauge_rr import gauge_rr, study_rr
    from wafer_viewer.session.gauge.repeat_scans import studies_of
    from wafer_viewer.store.tables.csv_tables import read_study

    if len(src) == 1 and src[0].suffix.lower() == ".csv":
        print_json(_rr_facts(gauge_rr(read_study(src[0]), method=method, tolerance=tolerance)))
        return
    studies = studies_of(src, job, result)
    with_tolerance = [study if tolerance is None else replace(study, tolerance=tolerance) for study in studies]
    found = [(study, study_rr(study, method)) for study in with_tolerance]
    print_json([{**msgspec.to_builtins(study), "found": _rr_facts(rr)} for study, rr in found])


def _rr_facts(found: GaugeRR) -> dict[str, Any]:
    """Return the result and the shares derived from it."""
    shares = {
        "share_of_variation": found.share_of_variation if found.total_variation else None,
        "share_of_tolerance": found.share_of_tolerance,
        "distinct_categories": found.distinct_categories,
    }
    return {**msgspec.to_builtins(found), **shares}


def _faces(upper: tuple[float, ...] | None, lower: tuple[float, ...] | None) -> tuple[Region, Region] | None:
    if upper is None and lower is None:
        return None
    if upper is None or lower is None:
        raise MeasureError("One face makes no step: give --upper and --lower, or neither to have them found.")
    return Region.rectangle(*upper), Region.rectangle(*lower)
