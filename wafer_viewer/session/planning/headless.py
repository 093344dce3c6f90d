"""Released jobs on the command line: creation from a plan and a good dataset, alignment for a wafer, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wafer_viewer.model.errors import DatasetError, DiskFullError, PlanError
from wafer_viewer.model.job import Job, Trial, WaferVerdict, changed_settings
from wafer_viewer.model.progress import Progress
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.dataset_library import load_summary
from wafer_viewer.session.planning.job_releases import for_next_wafer, free_place, prepared, read_job, released, revised
from wafer_viewer.session.planning.revision_trial import datasets_of, try_job
from wafer_viewer.session.planning.verdicts import verdict_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.scan_record import RECORD


def job_to_release(plan: Path, names: dict[str, str | None], good: Path | None, result: str, folder: Path) -> Job:
    """Return the job of a plan as it would be released in `folder`/jobs; a good sample's dataset resolves ``auto``.

    names: product and revision, if they differ from those of the plan. Raises PlanError with the missing parts, or if
    that revision is already released; DatasetError if the dataset has no stitched surface.
    """
    job = read_job(plan)
    job = replace(job, released=False, **{key: name for key, name in names.items() if name is not None})
    ready = revised(job) if good is None else _settled(job, Dataset.open(good), result)
    free_place(folder, ready)
    return ready


def tried(job: Job, against: Sequence[Path], result: str, tell: Progress) -> Trial:
    """Return the trial of a job on stored datasets, and on those in folders."""
    return try_job(job, datasets_of(against), result, progress=tell)


def _settled(job: Job, data: Dataset, result: str) -> Job:
    """Return the job with the resolved recipe of a dataset."""
    stored = data.result(result)
    settled, info = stored.mosaic().provenance.recipe, load_summary(stored)
    stitched = info.stitching if info is not None else None
    errors_um = (stitched.stage_error_um, stitched.z_error_um) if stitched is not None else None
    return released(job, data.scan.plan, settled, errors_um)


def job_of_wafer(plan: Path, out: Path, names: dict[str, str | None], corners_um: Sequence[float]) -> Job:
    """Return the job in a file for one wafer, with its names and aligned by its corners.

    corners_um: measured x and y of each corner in order. A dataset that is continued has both already. Raises PlanError
    for corners that give no alignment.
    """
    job = read_job(plan)
    given = {key: name for key, name in names.items() if name is not None}
    if out.exists() and not given and not corners_um and _is_of(out, job):
        return Dataset.open(out).scan.job
    job = replace(job, sample=replace(job.sample, **given))
    return _aligned(job, corners_um) if corners_um else job


def stored_verdict_of(path: Path, result: str) -> WaferVerdict:
    """Return the verdict on the wafer of a dataset; it is stored in the dataset unless another process holds that.

    Raises DiskFullError when there is no space to store it.
    """
    data = Dataset.open(path.absolute())
    try:
        lock = Lock.take(data.path)
    except DiskFullError:
        raise
    except DatasetError:
        return verdict_of(data, data.result(result), keep=False)
    try:
        return verdict_of(data, data.result(result), keep=True)
    finally:
        lock.release()


def _is_of(out: Path, job: Job) -> bool:
    if not (job.released and (out / RECORD).exists()):
        return False
    begun: Any = Dataset.open(out).scan.job
    return not changed_settings(prepared(begun), prepared(for_next_wafer(job)))[0]


def _aligned(job: Job, corners_um: Sequence[float]) -> Job:
    from wafer_viewer.calibrate.wafer_alignment import fit_alignment

    if job.marks is None:
        raise PlanError("The plan names no corners to align by: leave --corners out, or name them in the plan.")
    if len(corners_um) % 2:
        raise PlanError(f"--corners has {len(corners_um)} numbers: give x and y of each corner.")
    marked_um = list(zip(corners_um[::2], corners_um[1::2], strict=True))
    return replace(job, alignment=fit_alignment(job.marks, marked_um, job.sample.notch))
