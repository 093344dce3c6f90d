"""Released jobs: prepared once by an engineer and run by operators; one file each, never overwritten."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.errors import DatasetError, PlanError, RoleError, WaferViewerError
from wafer_viewer.model.job import Job
from wafer_viewer.model.roles import AuditEntry
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.session.state.snapshot import JobEntry
from wafer_viewer.store.io.checksums import file_sha256
from wafer_viewer.store.io.guarded_reading import read_content
from wafer_viewer.store.records.signed_log import recorded_actions

FOLDER, ENDING = "jobs", ".toml"
OF_ONE_WAFER = {"name": "", "lot": "", "wafer_id": "", "slot": 0, "operator": ""}
"""Sample fields that belong to the wafer or the day, not to the product, with their blank values."""
NOMINAL_TILT = 1e-4
"""Tilt error of a field relative to the stage, um per um; one scan cannot separate it from the form of the wafer."""
SEARCH_PX = 40
"""Search range for neighbours around the stage position in pixels, unless specified."""


def as_released(job: Job, plan: ScanPlan, settled: Recipe | None, errors_um: tuple[float, float] | None) -> Job:
    """Return the released job of a plan, with the displayed surface's recipe if its own one has ``auto``.

    Raises PlanError with the missing parts.
    """
    if not job.recipe.has_auto:
        return revised(replace(job, strategy=plan.strategy))
    if settled is None:
        raise PlanError("There is no surface whose recipe could be released: scan a good sample with this plan first.")
    return released(job, plan, settled, errors_um)


def released(job: Job, plan: ScanPlan, settled: Recipe, errors_um: tuple[float, float] | None) -> Job:
    """Return the job that an operator can run: without ``auto``, and without the data of a single wafer.

    settled: the recipe of a reconstruction with ``auto`` resolved; errors_um: errors of the stage in the plane and
    along z, from its overlaps. Raises PlanError with the missing parts.
    """
    _require_complete(job)
    recipe = replace(settled, stitching=_stitching(settled.stitching, plan, errors_um))
    if recipe.has_auto:
        raise PlanError(
            "The recipe still holds an 'auto' that no field settled: scan and reconstruct a good sample first."
        )
    return replace(
        job,
        product=job.product.strip(),
        revision=job.revision.strip(),
        sample=replace(job.sample, **OF_ONE_WAFER),
        alignment=None,
        strategy=plan.strategy,
        recipe=recipe,
        released=True,
    )


def revised(job: Job) -> Job:
    """Return a job without ``auto`` as it would be released; no scan is needed for it.

    Raises PlanError with the missing parts.
    """
    _require_complete(job)
    if job.recipe.has_auto or job.strategy == "auto":
        raise PlanError("The job still holds an 'auto': name a dataset of a good sample that settles it, with --good.")
    names = {"product": job.product.strip(), "revision": job.revision.strip()}
    return replace(prepared(job), **names, released=True)


def for_next_wafer(job: Job) -> Job:
    """Return the job for another wafer: without wafer id and alignment."""
    return replace(job, sample=replace(job.sample, wafer_id="", name="", slot=0), alignment=None)


def prepared(job: Job) -> Job:
    """Return the part of a job that the engineer prepared: without wafer names and alignment."""
    return replace(job, sample=replace(job.sample, **OF_ONE_WAFER), alignment=None)


def require_as_released(before: Job | None, after: Job | None) -> None:
    """Raise PlanError if a released job was changed without a new revision."""
    if before is None or after is None or not before.released or not after.released:
        return
    if prepared(before) != prepared(after):
        raise PlanError(
            f"{before.product}, revision {before.revision}, is released and stays as it is: "
            "copy it to a plan that can be changed, and release that as another revision."
        )


def release_problem(folder: Path, job: Job) -> str | None:
    """Return why a job is not as somebody released it in the data folder, by the signed entry of that; None if it is.

    Raises DatasetError when the audit log was altered.
    """
    path = _place(folder, job)
    entry = _releases(folder).get(path.name)
    if entry is None or not path.is_file():
        return f"{job.product or 'The plan'} {job.revision}".strip() + f" was not released in {folder}."
    if entry.sha256 != file_sha256(path):
        return f"{path.name} was edited after {entry.by} released it on {entry.at[:10]}."
    if prepared(read_job(path)) != prepared(job):
        return f"The plan is not {job.product} {job.revision} as {entry.by} released it on {entry.at[:10]}."
    return None


def release_of(folder: Path, job: Job) -> AuditEntry | None:
    """Return the signed entry of the release of a job, None if it is not as somebody released it in the data folder.

    Raises DatasetError when the audit log was altered.
    """
    released = job.released and release_problem(folder, job) is None
    return _releases(folder)[_place(folder, job).name] if released else None


def require_released(folder: Path, job: Job, who: str) -> None:
    """Raise RoleError if an operator may not run a job, because it is not as it was released."""
    why = release_problem(folder, job) if job.released else "This plan is not released."
    if why is not None:
        raise RoleError(f"{why} Operators run released jobs only: have an engineer release it. {who}")


def as_on_disk(folder: Path, path: Path, job: Job) -> Job:
    """Return a job that was read from a file; it is a plan again if the file is not the one that was released."""
    if job.released and path.absolute().parent == (folder / FOLDER).absolute() and _is_edited(path, _releases(folder)):
        return replace(job, released=False)
    return job


def _releases(folder: Path) -> dict[str, AuditEntry]:
    """Return the last entry of a release for each file."""
    return {entry.subject: entry for entry in recorded_actions(folder) if entry.action == "Job released"}


def _is_edited(path: Path, releases: dict[str, AuditEntry]) -> bool:
    """Return whether a file is not the one that was released."""
    entry = releases.get(path.name)
    return entry is not None and entry.sha256 != file_sha256(path)


def write_released(folder: Path, job: Job) -> Path:
    """Write a released job under its product and revision. Raises PlanError if that revision exists."""
    from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors, write_text

    path = free_place(folder, job)
    with os_errors_as_dataset_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, encode(job))
    return path


def free_place(folder: Path, job: Job) -> Path:
    """Return the path of a job after its release. Raises PlanError if that revision exists."""
    path = _place(folder, job)
    if path.exists():
        raise PlanError(
            f"Revision {job.revision} of {job.product} is released already ({path.name}): choose another revision."
        )
    return path


def _place(folder: Path, job: Job) -> Path:
    return folder / FOLDER / f"{_plain(job.product)}-{_plain(job.revision)}{ENDING}"


def list_released(folder: Path) -> tuple[JobEntry, ...]:
    """Return the released jobs of the data folder, by product, the newest revision first.

    Those whose file was edited since are marked; that is not known when the audit log was altered.
    """
    try:
        releases = _releases(folder)
    except DatasetError:  # told when the log is looked at, and when an operator starts a scan
        releases = dict[str, AuditEntry]()
    paths = (folder / FOLDER).glob(f"*{ENDING}")
    entries = [entry for path in paths if (entry := _entry(path, releases)) is not None]
    newest_first = sorted(entries, key=lambda e: e.revision, reverse=True)
    return tuple(sorted(newest_first, key=lambda e: e.product.casefold()))


def _require_complete(job: Job) -> None:
    if not job.product.strip() or not job.revision.strip():
        raise PlanError("The job has no product or no revision: name both, an operator chooses by them.")
    if job.marks is None:
        raise PlanError("The job has no corners to align by: name at least two corners of dies.")
    unplaced = [feature.name for feature in job.features if not feature.has_place]
    if unplaced or not job.features:
        incomplete = f"feature '{unplaced[0]}' has no place" if unplaced else "job has no feature"
        raise PlanError(f"The {incomplete} to be measured at: give it one, or there is no verdict.")


def _stitching(stitching: Stitching, plan: ScanPlan, errors_um: tuple[float, float] | None) -> Stitching:
    """Return the stitching settings with ``auto`` replaced by the measured stage errors."""
    in_plane_um, along_z_um = errors_um or (6 * plan.pixel_um, 1.0)
    found = {
        "search_um": SEARCH_PX * plan.pixel_um,
        "stage_error_um": in_plane_um,
        "z_error_um": along_z_um,
        "tilt_error": NOMINAL_TILT,
    }
    return replace(stitching, **{name: value for name, value in found.items() if getattr(stitching, name) == "auto"})


def _entry(path: Path, releases: dict[str, AuditEntry]) -> JobEntry | None:
    """Return a list entry; None for a file that is no released job."""
    try:
        job = read_job(path)
    except WaferViewerError:
        return None
    edited = _is_edited(path, releases)
    entry = JobEntry(path, job.product, job.revision, len(job.all_fields()), len(job.features), edited)
    return entry if job.released or edited else None


def read_job(path: Path) -> Job:
    """Return the job in a file. Raises PlanError when it cannot be read or is invalid."""
    return decode(read_content(path, PlanError), Job, path.name)


def _plain(name: str) -> str:
    return "-".join("".join(c if c.isalnum() or c in "._" else " " for c in name).split()) or "job"
