"""Commands of released jobs. The signature of a command defines its flags, its docstring is the help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from tyro.conf import arg

from wafer_viewer.cli.arguments import DatasetFolder, File, PlanFile, Text
from wafer_viewer.cli.output import print_json, print_trial, progress


def release(
    plan_file: PlanFile,
    good: File = None,
    product: Text = None,
    revision: Text = None,
    result: str = "default",
    data: Path = Path("~/wafer-viewer"),
    against: Annotated[tuple[Path, ...], arg(metavar="DATASET|FOLDER ...")] = (),
    dry_run: bool = False,
) -> None:
    """Release a plan as a job that operators run with four actions; prints its file. A revision is never overwritten.

    The plan names corners to align by, and features with their places and limits. Tried against stored datasets before,
    it says which verdicts change, and why; a changed recipe makes their surfaces again, beside the existing ones.

    Args:
        plan_file: The plan, or a released job to make another revision of.
        good: A stitched NAME.wafer of a good sample that settles what is 'auto'; a job without 'auto' needs none.
        product: Name of the product, where the plan has none.
        revision: The revision, where the plan has none.
        result: Name of the reconstruction.
        data: Folder of the datasets; released jobs lie in its folder jobs.
        against: Stored datasets, or folders of them, to try it on before it is released.
        dry_run: Only say what would change; release nothing.
    """
    from wafer_viewer.session.planning.headless import job_to_release, tried
    from wafer_viewer.session.planning.job_releases import write_released

    names, folder = {"product": product, "revision": revision}, data.expanduser()
    job = job_to_release(plan_file, names, good, result, folder)
    if against:
        with progress("Judging stored datasets") as tell:
            trial = tried(job, against, result, tell)
        print_trial(trial)
    if not dry_run:
        print(write_released(folder, job))


def measure_verdict(dataset: DatasetFolder, result: str = "default") -> int:
    """The verdict on a wafer by the features of its job, as JSON; status 0 is pass, 1 any other verdict.

    Args:
        dataset: The dataset, stitched.
        result: Name of the reconstruction.
    """
    from wafer_viewer.session.planning.headless import verdict_kept_in

    verdict = verdict_kept_in(dataset, result)
    print_json(msgspec.to_builtins(verdict))
    return 0 if verdict.word == "pass" else 1
