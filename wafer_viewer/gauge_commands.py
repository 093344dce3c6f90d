"""The commands that judge the instrument. A signature is the command's flags, its docstring the help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from tyro.conf import Positional, arg

from wafer_viewer.command_output import print_json
from wafer_viewer.model.repeatability import Method

Study = Annotated[Positional[Path], arg(metavar="STUDY.csv")]


def measure_rr(study: Study, method: Method = "anova", tolerance: float | None = None) -> None:
    """Gauge R&R: how much of the spread of repeated measurements is the instrument's, as JSON (AIAG's MSA).

    Deviations are standard deviations in the unit of the values. With a tolerance, six of them as a share of it.

    Args:
        study: A table with the columns part, appraiser and value; a line for each trial.
        method: By analysis of variance, or by average and range.
        tolerance: Upper limit less lower, in the unit of the values.
    """
    from wafer_viewer.measure.repeatability import gauge_rr
    from wafer_viewer.store.study import read_study

    found = gauge_rr(read_study(study), method=method, tolerance=tolerance)
    shares = {
        "share_of_variation": found.share_of_variation if found.total_variation else None,
        "share_of_tolerance": found.share_of_tolerance,
        "distinct_categories": found.distinct_categories,
    }
    print_json({**msgspec.to_builtins(found), **shares})
