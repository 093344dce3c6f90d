"""Released jobs at the prompt: made of a plan and a good dataset, named and aligned for a wafer, judged."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wafer_viewer.model.errors import DatasetError, PlanError
from wafer_viewer.model.plan import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.model.verdict import WaferVerdict
from wafer_viewer.session.drafting import read_job
from wafer_viewer.session.judging import verdict_of
from wafer_viewer.session.releases import blank, prepared, released, write_released
from wafer_viewer.session.summary import load_summary
from wafer_viewer.store.dataset import Dataset
from wafer_viewer.store.lock import Lock


def release_plan(plan: Path, product: str | None, revision: str | None, good: Path, result: str, folder: Path) -> Path:
    """Release a plan with the recipe that a dataset of a good sample settled; returns its file in `folder`/jobs.

    Raises PlanError with what is missing, DatasetError where the dataset has no stitched surface.
    """
    job, data = read_job(plan), Dataset.open(good)
    names = {"product": product, "revision": revision}
    job = replace(job, **{key: name for key, name in names.items() if name is not None})
    kept = data.result(result)
    settled, info = kept.mosaic().provenance.recipe, load_summary(kept)
    stitched = info.stitching if info is not None else None
    errors_um = (stitched.stage_error_um, stitched.z_error_um) if stitched is not None else None
    return write_released(folder, released(job, data.scan.plan, settled, errors_um))


def job_of_wafer(plan: Path, out: Path, names: dict[str, str | None], corners_um: Sequence[float]) -> Job:
    """The job in a file for one wafer: named, and aligned by where its corners were seen, x and y of each in order.

    A dataset that is gone on with knows both already. Raises PlanError for corners that make no alignment.
    """
    job = read_job(plan)
    given = {key: name for key, name in names.items() if name is not None}
    if out.exists() and not given and not corners_um and _is_of(out, job):
        return Dataset.open(out).scan.job
    job = replace(job, sample=replace(job.sample, **given))
    return _aligned(job, corners_um) if corners_um else job


def verdict_kept_in(path: Path, result: str) -> WaferVerdict:
    """The verdict on the wafer of a dataset, kept in it where nobody else holds it."""
    data = Dataset.open(path.absolute())
    try:
        lock = Lock.take(data.path)
    except DatasetError:
        return verdict_of(data, data.result(result), keep=False)
    try:
        return verdict_of(data, data.result(result), keep=True)
    finally:
        lock.release()


def _is_of(out: Path, job: Job) -> bool:
    begun: Any = Dataset.open(out).scan.job
    return job.released and prepared(begun) == prepared(blank(job))


def _aligned(job: Job, corners_um: Sequence[float]) -> Job:
    from wafer_viewer.calibrate.alignment import fit_alignment

    if job.marks is None:
        raise PlanError("The plan names no corners to align by: leave --corners out, or name them in the plan.")
    if len(corners_um) % 2:
        raise PlanError(f"--corners has {len(corners_um)} numbers: give x and y of each corner.")
    seen_um = list(zip(corners_um[::2], corners_um[1::2], strict=True))
    return replace(job, alignment=fit_alignment(job.marks, seen_um, job.sample.notch))
