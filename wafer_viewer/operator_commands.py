"""The commands of released jobs. A signature is the command's flags, its docstring the help."""

from __future__ import annotations

from pathlib import Path

import msgspec

from wafer_viewer.arguments import DatasetFolder, PlanFile, Text
from wafer_viewer.command_output import print_json


def release(
    plan_file: PlanFile,
    good: Path,
    product: Text = None,
    revision: Text = None,
    result: str = "default",
    data: Path = Path("~/wafer-viewer"),
) -> None:
    """Release a plan as a job that operators run with four actions; prints its file. A revision is never overwritten.

    The plan names corners to align by, and features with their regions and limits.

    Args:
        plan_file: The plan.
        good: A stitched NAME.wafer of a good sample, whose settled recipe the job takes.
        product: Name of the product, where the plan has none.
        revision: The revision, where the plan has none.
        result: Name of the reconstruction.
        data: Folder of the datasets; released jobs lie in its folder jobs.
    """
    from wafer_viewer.session.release_command import release_plan

    print(release_plan(plan_file, product, revision, good, result, data.expanduser()))


def measure_verdict(dataset: DatasetFolder, result: str = "default") -> int:
    """The verdict on a wafer by the features of its job, as JSON; status 0 is pass, 1 any other word.

    Args:
        dataset: The dataset, stitched.
        result: Name of the reconstruction.
    """
    from wafer_viewer.session.release_command import verdict_kept_in

    verdict = verdict_kept_in(dataset, result)
    print_json(msgspec.to_builtins(verdict))
    return 0 if verdict.word == "pass" else 1
