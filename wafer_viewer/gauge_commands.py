"""The commands that judge the instrument. A signature is the command's flags, its docstring the help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
from tyro.conf import Positional, arg

from wafer_viewer.command_output import print_json
from wafer_viewer.model.repeatability import GaugeRR, Method
from wafer_viewer.model.spec import replace

Studies = Annotated[Positional[tuple[Path, ...]], arg(metavar="STUDY.csv|DATASET ...")]


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
    from wafer_viewer.measure.repeatability import gauge_rr, study_rr
    from wafer_viewer.session.repeat_study import studies_of
    from wafer_viewer.store.study import read_study

    if len(src) == 1 and src[0].suffix.lower() == ".csv":
        print_json(_rr_facts(gauge_rr(read_study(src[0]), method=method, tolerance=tolerance)))
        return
    studies = studies_of(src, job, result)
    with_tolerance = [study if tolerance is None else replace(study, tolerance=tolerance) for study in studies]
    found = [(study, study_rr(study, method)) for study in with_tolerance]
    print_json([{**msgspec.to_builtins(study), "found": _rr_facts(rr)} for study, rr in found])


def _rr_facts(found: GaugeRR) -> dict[str, Any]:
    """What was found, and the shares that follow from it."""
    shares = {
        "share_of_variation": found.share_of_variation if found.total_variation else None,
        "share_of_tolerance": found.share_of_tolerance,
        "distinct_categories": found.distinct_categories,
    }
    return {**msgspec.to_builtins(found), **shares}
